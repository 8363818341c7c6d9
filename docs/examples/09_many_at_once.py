"""Where should the bed stand? Many problems, some of them without a plan, in one go."""

from planner import load, solve_all

if __name__ == "__main__":  # needed where jobs=2 starts processes afresh
    places = [(x, 0, z) for x in (350, 450, 1500) for z in (250, 350)]
    problems = [load("peer_cap", {"cell.bed_mm": place}) for place in places]
    found = solve_all(problems, strategy="ladder", baseline=False, jobs=1)
    for place, each in zip(places, found, strict=True):
        if each.plan is None:
            print(place, "no plan:", str(each.error)[:80])
        else:
            share, sigma = (each.plan.metrics[name] for name in ("at_speed_fraction", "sigma_min"))
            print(place, "verified" if each.verified else "not verified", f"{share:.1%} at speed, sigma {sigma:.3f}")
    best = max((each for each in found if each.verified), key=lambda each: each.plan.metrics["sigma_min"])
    print("best:", best.plan.problem.cell.bed)
