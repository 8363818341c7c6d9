"""The verifier's checks, word by word: unit of the worst value, what holds, and how it is found."""

from __future__ import annotations

from planner.measures.metrics import ONLY_MOTOR, ONLY_SWITCHED, Measure

CHECKS: dict[str, Measure] = {
    "all numbers finite": Measure("that are not", "no number of the trajectory is infinite or undefined", "counted"),
    "recorded poses": Measure(
        "mm",
        "tip and orientation that programs are written from are those of the joints",
        "forward kinematics of the URDF by Pinocchio",
    ),
    "recorded branch": Measure(
        "",
        "the configuration that programs name is that of the joints",
        "from the joints",
        "the arm has a spherical wrist",
    ),
    "recorded times and beads": Measure(
        "", "samples are evenly spaced, and deposit where they belong to a bead", "counted"
    ),
    "joint range": Measure(
        "deg", "every joint stays within its range", "distance from the nearer end, over all samples"
    ),
    "joint velocity": Measure(
        "of limit", "every joint stays within its speed limit", "central differences of the samples"
    ),
    "joint acceleration": Measure("of limit", "every joint stays within its acceleration limit", "second differences"),
    "joint jerk": Measure(
        "of limit", "every joint stays within its jerk limit", "third differences, over four samples"
    ),
    "continuity": Measure(
        "of a sample's travel at full speed",
        "no joint jumps from one sample to the next",
        "its step over what its greatest speed allows",
    ),
    "tip on the path": Measure("mm", "the tip is on its bead", "see position_error_max_mm"),
    "axis on the normal": Measure(
        "deg", "the nozzle is normal to the surface, or within its cone about the normal", "see axis_error_max_deg"
    ),
    "nozzle to gravity": Measure(
        "deg",
        "the nozzle keeps within its cone about straight down",
        "its axis by forward kinematics, while material is laid",
        "process.cones.nozzle_gravity_deg is not 180",
    ),
    "layer to gravity": Measure(
        "deg",
        "the layer keeps within its cone about straight up",
        "the surface normal, as the table holds the part",
        "process.cones.layer_gravity_deg is not 180",
    ),
    "path within corner tolerance": Measure(
        "mm",
        "what is printed stays near the drawn path",
        "tip to the input polyline; the limit is process.corner_tolerance_mm",
    ),
    "input path reached everywhere": Measure(
        "mm", "the drawn path is printed everywhere", "its points to the rounded path; the same limit"
    ),
    "every bead complete": Measure(
        "mm between samples",
        "every bead is laid once, in order, from its start to its end, forwards",
        "greatest gap between samples along it",
    ),
    "singularity margin": Measure(
        "",
        "the arm keeps away from singularities while material is laid",
        "see sigma_min; the limit is resolve.min_sigma",
    ),
    "branch changes in deposition": Measure(
        "", "the arm does not change its branch while material is laid", "see branch_changes_in_deposition"
    ),
    "speed in deposition": Measure(
        "mm/s",
        "the tip is nowhere faster than commanded, within 2 %",
        "see speed_max_mm_s; slower is a dip, and no failure",
    ),
    "recorded speed": Measure(
        "mm/s", "the speed that programs are written from is that of the tip", "from the tip's places"
    ),
    "speed in travel": Measure(
        "mm/s", "travel keeps to its speed", "of the tip; the limit is process.travel_speed_mm_s"
    ),
    "material keeps pace": Measure(
        "of what one sample lays down",
        "at every sample as much material has flowed as the beads hold up to there",
        "volume of the bead's section along its length",
    ),
    "extrusion balance": Measure(
        "of a bead's volume",
        "each bead has as much material as it holds, and none flows elsewhere",
        "sum of flow over each bead",
        ONLY_MOTOR,
    ),
    "flow per millimetre": Measure(
        "of what a millimetre holds",
        "every millimetre of a bead has the material that it holds",
        "see flow_error_max",
        ONLY_MOTOR,
    ),
    "filament fed": Measure(
        "of what one sample lays down",
        "the motor pushes what is laid, ahead by the extruder's lag, beside primes, retracts and purges",
        "filament times its section against the volume laid",
    ),
    "fibre as long as its bead": Measure(
        "of a bead's length",
        "as much fibre is fed for a bead as the bead is long",
        "filament from the end of one bead to that of the next",
        "process.fibre is given",
    ),
    "motor runs while a bead is laid": Measure(
        "of its rate",
        "a motor that is only on or off runs exactly while a bead is laid",
        "flow against the commanded speed's rate",
        ONLY_SWITCHED,
    ),
    "material fed by its own tool": Measure(
        "samples and events",
        "each bead is fed by the tool of its material",
        "tool selected at each sample and event",
        "process.materials are several",
    ),
    "rest for a change of material": Measure(
        "s missing",
        "robot and extruder rest for each change, and purge",
        "time without motion; the limit is two samples",
        "process.materials are several",
    ),
    "nozzle tip outside the part": Measure(
        "mm", "the tip never enters the part as far as it is printed", "see tip_clearance_min_mm"
    ),
    "nozzle clear of part and print": Measure(
        "mm",
        "nozzle and print head keep their distance from part and print; near the tip, where they must touch, less and less",
        "see nozzle_clearance_min_mm; the limit is collision.nozzle_mm",
    ),
    "arm clear of part and print": Measure(
        "mm",
        "the robots' links keep their distance from part and print",
        "see arm_clearance_min_mm; the limit is collision.arm_mm",
    ),
    "robots clear of each other and of fixtures": Measure(
        "mm",
        "robots, head and fixtures keep their distance from each other",
        "see robot_clearance_min_mm; the limit is collision.arm_mm, of the head collision.nozzle_mm",
    ),
}
