"""One problem at several speeds and tilts of the nozzle: changes by keyword and by dictionary."""

from planner import load, solve

print("speed   lean   at speed   deposition   least sigma")
for speed in (40, 80):
    for lean in (0, 5):
        problem = load(
            "peer_cap",
            {"process.cones": {"nozzle_normal_deg": lean}},  # in the file's units: degrees
            process__speed_mm_s=speed,
        )
        found = solve(problem, baseline=False).metrics
        share, sigma = found["at_speed_fraction"], found["sigma_min"]
        print(f"{speed:2} mm/s  {lean} deg  {share:7.1%}  {found['deposition_time_s']:8.2f} s  {sigma:10.3f}")
