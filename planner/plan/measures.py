"""Metrics, columns and checks of a plan, defined once: unit, meaning, and how each is found.

The verifier computes metrics and checks from the joints of the trajectory (`planner.verify`), the planner computes the
bound on the deposition time. Every name in a plan is defined here, and no others are (tests/test_measures.py).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measure:
    """A metric, a check (see CHECKS) or a column: unit, what it is, how it is found, and which plans have it.

    unit  empty for a dimensionless number
    only  condition under which a plan has it; empty for all plans
    """

    unit: str
    text: str
    how: str
    only: str = ""


ONLY_LEAN = "process.cones.nozzle_normal_deg is not 0"
ONLY_ON_PARTS = "a drawing, a pattern or curves are laid on a part, or STEP faces are covered"
ONLY_REREAD = "the source is a drawing, a pattern, curves, waypoints or G-code"
ONLY_SURFACES = "the source is neither waypoints nor G-code"
ONLY_BODIES = "a wing, a core, a mesh or STEP faces are printed"
ONLY_FILLED = "a wing, a mesh or STEP faces are printed"
ONLY_WAYPOINTS = "a file of waypoints is printed, and smoothing or a cone may turn the nozzle from its normals"
ONLY_FIBRE = "fibre is laid"
ONLY_SWITCHED = "process.extruder.motor is on_off"
ONLY_MOTOR = "process.extruder.motor is not on_off"
ONLY_SCANNED = "as_printed is given"
ONLY_LEARNED = "as_run is given"
ONLY_STACKED = "something is laid on what the same print laid before"
ONLY_PLANNED = "the plan was not changed after it was verified"
ONLY_BOUNDED = (
    f"{ONLY_PLANNED}, process.cones.nozzle_normal_deg is 0, the print has at most 20,000 waypoints, and apart from roll at most three "
    "joints are free (positioner, rail, an arm of seven axes)"
)

METRICS: dict[str, Measure] = {
    "beads": Measure("", "beads that are laid", "counted; of a resumed print from its first bead on"),
    "layers": Measure("", "layers that they belong to", "counted"),
    "waypoints": Measure("", "points that describe the beads", "counted"),
    "deposited_length_mm": Measure("mm", "length of all beads", "sum of their arc lengths, without run-in and run-out"),
    "print_time_s": Measure("s", "time of the whole print", "time of the last sample: travel, waits and cuts included"),
    "interlayer_time_min_s": Measure(
        "s",
        "least age of the material that anything is laid on",
        "executed tips: time since the nearest place of an earlier layer was laid, one bead's height down the normal and at "
        "most three quarters of a bead's width to the side; bridges and struts lie on nothing",
        ONLY_STACKED,
    ),
    "interlayer_time_median_s": Measure(
        "s", "median age of the material that anything is laid on", "along the beads that lie on others", ONLY_STACKED
    ),
    "interlayer_time_max_s": Measure(
        "s", "greatest age of the material that anything is laid on", "likewise", ONLY_STACKED
    ),
    "bead_crossings": Measure(
        "places",
        "where beads of a layer cross",
        "counted: see beads cross nowhere",
        "layers cover faces, or process.crossings is given",
    ),
    "deposition_time_s": Measure(
        "s",
        "time in which material is laid, without the rests at cuts of fibre",
        "samples that deposit and move, times their spacing",
    ),
    "ideal_deposition_time_s": Measure(
        "s", "that time if the speed never dipped", "length of the beads over the commanded speed"
    ),
    "bound_deposition_time_s": Measure(
        "s",
        "least time to follow these joint paths within the limits of joint speed and acceleration alone",
        "the fastest speed profile up to the commanded speed, without jerk limits, computed by the planner",
        ONLY_PLANNED,
    ),
    "bound_any_path_s": Measure(
        "s",
        "least time that any plan needs to lay this material",
        "at each place the greatest speed that joint speed and acceleration allow for any rotation, chosen joints and "
        "branch, however fast these change; found by the planner on a grid, of hard places up to a number",
        ONLY_BOUNDED,
    ),
    "bound_gap_fraction": Measure(
        "",
        "share by which deposition takes longer than that",
        "deposition_time_s over bound_any_path_s, less 1",
        ONLY_BOUNDED,
    ),
    "at_speed_fraction": Measure(
        "",
        "share of the length that is printed at the commanded speed, within 2 %",
        "length of the samples between 0.98 and 1.02 of the speed, over the length of all that deposit",
    ),
    "speed_min_mm_s": Measure(
        "mm/s",
        "slowest speed of the tip along the part while material is laid",
        "from the tip's places a sample before and after, or the recorded speed where that is less",
    ),
    "speed_max_mm_s": Measure(
        "mm/s",
        "fastest speed of the tip along the part while material is laid",
        "likewise, the recorded speed where that is greater",
    ),
    "sigma_min": Measure(
        "",
        "distance from singularities: least singular value of the arm's Jacobian while material is laid",
        "of the geometric Jacobian of the nozzle's tip, lengths in metres and angles in radians",
    ),
    "sigma_p01": Measure(
        "", "the same, without the worst hundredth of the samples", "1 % quantile over the samples that deposit"
    ),
    "wrist_margin_deg": Measure(
        "deg",
        "least angle of joint 5 from where joints 4 and 6 are in line",
        "from its angle, while material is laid; half a turn from there they are in line again",
        "the arm has six joints, and is singular where joints 4 and 6 are in line",
    ),
    "joint_limit_margin_deg": Measure(
        "deg", "least distance of a joint that turns from an end of its range", "over all samples, travel included"
    ),
    "rail_margin_mm": Measure(
        "mm",
        "least distance of a joint that slides from an end of its range",
        "over all samples, travel included",
        "a joint slides",
    ),
    "velocity_ratio_max": Measure(
        "",
        "greatest joint speed, as a share of that joint's limit",
        "central differences of the samples, at rest before the first and after the last",
    ),
    "acceleration_ratio_max": Measure("", "greatest joint acceleration, as a share of its limit", "second differences"),
    "jerk_ratio_max": Measure(
        "", "greatest joint jerk, as a share of its limit", "third differences, over four samples"
    ),
    "position_error_max_mm": Measure(
        "mm",
        "how far the tip is off its bead at most",
        "tip by forward kinematics, from the spline through the bead's points at that length",
    ),
    "axis_error_max_deg": Measure(
        "deg",
        "how far the nozzle's axis is off the surface normal, or leaves its cone about it",
        "axis by forward kinematics, normal of the input surface there",
    ),
    "file_normal_max_deg": Measure(
        "deg",
        "how far the nozzle's axis is off the normals in the file of waypoints",
        "axis by forward kinematics where the tip passes each waypoint, against its normal in the file, read again",
        ONLY_WAYPOINTS,
    ),
    "tilt_max_deg": Measure(
        "deg",
        "how far the nozzle leans from the surface normal at most",
        "the same angle, without subtracting the cone",
        ONLY_LEAN,
    ),
    "tilt_bead_error_max_mm": Measure(
        "mm",
        "how much the lean leaves a bead's edges too high or too low",
        "half the bead's width times the sine of the lean",
        ONLY_LEAN,
    ),
    "path_deviation_max_mm": Measure(
        "mm",
        "greatest distance between the print and the drawn path",
        "tip to the input polyline, and the input's points to the rounded path; the greater of the two",
    ),
    "branch_changes_in_deposition": Measure(
        "",
        "how often the arm changes its branch while material is laid",
        "changes of sign of the Jacobian's determinant, and of sin(joint 5) of six joints",
    ),
    "tip_clearance_min_mm": Measure(
        "mm",
        "least height of the nozzle's tip above the part as printed so far",
        "signed distance of the tip from the part's surface",
    ),
    "nozzle_clearance_min_mm": Measure(
        "mm",
        "least distance of nozzle and print head from part and print, beyond the zone at the tip",
        "bodies of the head, moved by forward kinematics, against points of part and print; capped at 50, and at most "
        "a tenth above the true distance",
    ),
    "nozzle_pressed_max_mm": Measure(
        "mm",
        "how deep the nozzle presses into beads printed before, at most",
        "the nozzle's outline against balls along the executed tip's way; 0 where it only touches them",
    ),
    "print_off_max_mm": Measure(
        "mm",
        "how far the top of the scanned layer is from where it was drawn, at most",
        "the height map, smoothed again by other code",
        ONLY_SCANNED,
    ),
    "print_left_off_max_mm": Measure(
        "mm",
        "how far the top of the last layer is from where it was drawn, at most",
        "print_off_max_mm less what each layer above the scanned one makes up for",
        ONLY_SCANNED,
    ),
    "asked_off_max_mm": Measure(
        "mm",
        "how far off the plan programs command the tip, at most, so that the robot executes the plan",
        "poses of the asked joints against the executed ones, by Pinocchio",
        ONLY_LEARNED,
    ),
    "over_print_error_max_mm": Measure(
        "mm",
        "greatest difference between the nozzle's height over the scanned top and the height of the bead laid there",
        "the executed tip against the measured places of the map around it, unsmoothed",
        "as_printed is given, and the layer above the scanned one is laid",
    ),
    "arm_clearance_min_mm": Measure(
        "mm",
        "least distance of the robots' links, and of fixtures where the part moves, from part and print",
        "convex bodies against the same points; capped at 50",
    ),
    "robot_clearance_min_mm": Measure(
        "mm", "least distance of robots, head and fixtures from each other", "convex bodies by coal; capped at 50"
    ),
    "clearance_min_mm": Measure("mm", "the least of the clearances of nozzle, arm and robots", "their minimum"),
    "flow_error_max": Measure(
        "",
        "how far the material in a millimetre of a bead is off what it holds, at most",
        "what leaves the nozzle, lag included, over each millimetre, as a share; not in the lag zone, nor, with on_off, in a "
        "bead's first and last 2 mm, or four widths of a bead narrower than 0.5 mm",
    ),
    "even_flow_fraction": Measure(
        "",
        "share of all millimetres of beads, their ends included, whose material is within process.extruder.flow_tolerance",
        "as flow_error_max, with a millimetre beginning at every quarter of one",
        ONLY_SWITCHED,
    ),
    "extruded_volume_mm3": Measure("mm3", "material that is laid", "as recorded at the last sample"),
    "steering_radius_min_mm": Measure(
        "mm",
        "least radius to which a fibre is bent within the surface, capped at 10,000",
        "one over the geodesic curvature of the executed tip's path, from the surface's normals and the parabolas in arc "
        "length that fit it best over four tow widths; run-in and run-out lay nothing",
        ONLY_FIBRE,
    ),
    "extruded_mm": Measure(
        "mm", "filament that the motor has pushed at the end", "primes and purges included, retracts subtracted"
    ),
    "over_extruded_mm3": Measure(
        "mm3",
        "excess material, where speed dips and the motor does not slow down",
        "flow beyond what the bead holds, summed",
        ONLY_SWITCHED,
    ),
    "lag_zone_mm": Measure(
        "mm",
        "length not judged by flow_error_max, where pressure rises or falls",
        "length within the lag, plus two samples, of where flow begins or ends",
        "process.extruder.lag_s is not 0",
    ),
}

COLUMNS: dict[str, Measure] = {
    "t_s": Measure("s", "time since the start", "the samples are evenly spaced"),
    "bead": Measure("", "index of the bead, from 0; -1 in travel", "run-in and run-out count as travel"),
    "layer": Measure(
        "", "index of its layer, from 0", "that of the bead, also in its run-out; in other travel that of the next bead"
    ),
    "deposit": Measure("", "1 where material is laid", "0 elsewhere"),
    "s_mm": Measure("mm", "arc length along the bead", "0 in travel"),
    "x_mm": Measure("mm", "nozzle tip in the part frame, x", "forward kinematics of the joints"),
    "y_mm": Measure("mm", "nozzle tip in the part frame, y", "likewise"),
    "z_mm": Measure("mm", "nozzle tip in the part frame, z", "likewise"),
    "ax": Measure("", "nozzle axis in the part frame, x: a unit vector from the nozzle into the part", "likewise"),
    "ay": Measure("", "nozzle axis in the part frame, y", "likewise"),
    "az": Measure("", "nozzle axis in the part frame, z", "likewise"),
    "speed_mm_s": Measure(
        "mm/s",
        "speed of the tip along the part",
        "mean over the sample; in travel by the tip's places a sample before and after",
    ),
    "flow_mm3_s": Measure("mm3/s", "material that is laid", "mean over the sample"),
    "e_mm": Measure(
        "mm", "filament that the motor has pushed since the start", "ahead of what is laid by the extruder's lag"
    ),
}


ONLY_DIFFERENT = "a program that was read back differs from it: no program is written then"
ONLY_CHANGED = "the plan was changed after it was verified, and is verified anew"
# The verifier's checks: unit of the worst value, what holds, and how it is found.
CHECKS: dict[str, Measure] = {
    "all numbers finite": Measure("that are not", "no number of the trajectory is infinite or undefined", "counted"),
    "beads of the toolpath": Measure(
        "that are not", "every sample belongs to a bead of the toolpath, or to travel", "counted"
    ),
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
    "recorded layers and lengths": Measure(
        "",
        "samples on a bead name its layer, those in travel that of an adjacent bead and no length along it",
        "counted",
    ),
    "nozzles changed at home": Measure(
        "deg",
        "the arm is at home where another nozzle comes into use",
        "joints of the samples at which another material is selected; in mm where a rail is farthest off",
        "cell.nozzles are several",
    ),
    "starts and ends at home": Measure(
        "deg",
        "the arm starts at home and comes back there",
        "joints of the first and the last sample; in mm where a rail is farthest off",
    ),
    "joint range": Measure(
        "deg", "every joint that turns stays within its range", "distance from the nearer end, over all samples"
    ),
    "rail range": Measure(
        "mm",
        "every joint that slides stays within its range",
        "distance from the nearer end, over all samples",
        "a joint slides",
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
        "the print stays near the drawn path",
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
        "see speed_max_mm_s; a slower speed is a dip, not a failure",
    ),
    "recorded speed": Measure(
        "mm/s", "the speed that programs are written from is that of the tip", "from the tip's places"
    ),
    "speed in travel": Measure(
        "mm/s", "travel keeps to its speed", "of the tip; the limit is process.travel_speed_mm_s"
    ),
    "material keeps pace": Measure(
        "of what one sample lays down",
        "at every sample, as much material has flowed as the beads hold up to there",
        "the record of what has flowed against the volume of the bead's section along its length, and against the sum of flow; "
        "with process.extruder.motor on_off against that sum alone",
    ),
    "extrusion balance": Measure(
        "of a bead's volume",
        "each bead has as much material as it holds, and none flows elsewhere",
        "sum of flow over each bead",
        ONLY_MOTOR,
    ),
    "flow per millimetre": Measure(
        "of what a millimetre holds",
        "every millimetre of a bead has the material that it holds, within 0.5 %; with process.extruder.motor on_off within "
        "process.extruder.flow_tolerance",
        "see flow_error_max",
    ),
    "filament fed": Measure(
        "of what one sample lays down",
        "the motor pushes what is laid, ahead by the extruder's lag, in addition to primes, retracts and purges",
        "filament times its section against the volume laid",
    ),
    "primes, retracts and cuts as asked": Measure(
        "that are not",
        "each prime, retract and cut of fibre, and heating and purge at the start, is as the problem asks, with rests at the start "
        "and at cuts; apart from purges in pauses and changes, nothing else moves filament",
        "events that are missing or differ in amount, duration or place, counted, and rests by joints and filament; times "
        "within two samples",
    ),
    "fibre as long as its bead": Measure(
        "of a bead's length",
        "as much fibre is fed for a bead as the bead is long",
        "filament from the end of one bead to that of the next",
        "process.fibre is given",
    ),
    "steering radius of the fibre": Measure(
        "mm",
        "the fibre is bent within the surface no more tightly than its material allows",
        "see steering_radius_min_mm; the limit is process.fibre.least_radius_mm",
        "process.fibre.least_radius_mm is given",
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
        "robot and extruder rest at home for each change, and purge there",
        "time without motion, the arm's joints at home; the limit is two samples",
        "process.materials are several",
    ),
    "beads of the material asked for": Measure(
        "beads that are not",
        "each bead is of the material that the layers name, or that a wing's support or a mesh's infill names",
        "beads of the toolpath, a support's and an infill's known by their names; without lines around the first layer",
        "process.materials are several, the layers or a part of them name one, and layers.source.tool_materials is not given",
    ),
    "time of a layer": Measure(
        "s",
        "from the start of one layer to the start of the next, at least the least time of a layer passes",
        "the limit is two samples less",
        "process.layer_time is given",
    ),
    "beads cross nowhere": Measure(
        "places",
        "no bead crosses another one of its layer, or itself, on the surface",
        "executed tips, seen along the normals of the printed surface; a bead that ends on another one does not cross it",
        "layers cover faces, or process.crossings: refused",
    ),
    "interlayer time at least": Measure(
        "s",
        "nothing is laid on material younger than process.interlayer_time requires",
        "see interlayer_time_min_s; the limit is one sample less",
        "process.interlayer_time.least_s is given",
    ),
    "interlayer time at most": Measure(
        "s",
        "nothing is laid on material older than process.interlayer_time allows",
        "see interlayer_time_max_s; the limit is one sample more",
        "process.interlayer_time.most_s is given",
    ),
    "pauses before layers": Measure(
        "s missing",
        "the robot rests at home for each pause, and purges what the pause asks for",
        "time without motion; the limit is two samples",
        "process.pauses are given",
    ),
    "order of beads": Measure(
        "too late",
        "in each layer beads come in the order of the names that process.order lists",
        "beads that follow others which should come later",
        "process.order is given",
    ),
    "lines around the first layer": Measure(
        "mm",
        "the lines of process.skirt go all around the first layer, level with it, each as far from it as asked",
        "distance of the tip from where a line is to be",
        "process.skirt is given",
    ),
    "begins above the scanned layer": Measure(
        "beads that do not",
        "layers that a scan found printed are not printed again",
        "layers of the beads from the first one on",
        ONLY_SCANNED,
    ),
    "nozzle over the print": Measure(
        "mm off the bead's height",
        "on the first layer above the scanned one, the nozzle is as high above the print as its bead is to be",
        "see over_print_error_max_mm; also, measured places lie around a tenth of the layer",
        "as_printed is given, and the layer above the scanned one is laid",
    ),
    "asked as learned": Measure(
        "of what may differ",
        "programs command the plan, displaced as the file of corrections says and not otherwise",
        "the file read again; the asked joints' tip by Pinocchio within 0.02 mm on beads, and everywhere within as much of the tip "
        "that programs are written from; the nozzle within 0.05 degrees of the plan's; times, beads, flow, orientations and branches "
        "the same",
        ONLY_LEARNED,
    ),
    "asked off the plan": Measure(
        "mm",
        "programs command nothing farther from the plan than as_run.most_mm",
        "the asked joints' tip against the executed one",
        ONLY_LEARNED,
    ),
    "asked joint range": Measure(
        "deg",
        "every joint stays within its range if the robot does exactly what is commanded",
        "see joint range",
        ONLY_LEARNED,
    ),
    "asked rail range": Measure(
        "mm",
        "every joint that slides stays within its range if the robot does exactly what is commanded",
        "see rail range",
        "as_run is given, and a joint slides",
    ),
    "asked joint velocity": Measure(
        "of limit",
        "every joint stays within its speed limit if the robot does exactly what is commanded; its controller plans accelerations",
        "see joint velocity",
        ONLY_LEARNED,
    ),
    "asked nozzle clear of part and print": Measure(
        "mm",
        "beyond the tip's zone, nozzle and head keep the required distance, less asked_off_max_mm, if the robot does exactly what is commanded",
        "see nozzle clear of part and print",
        ONLY_LEARNED,
    ),
    "asked arm clear of part and print": Measure(
        "mm",
        "the arm keeps the required distance, less asked_off_max_mm, if the robot does exactly what is commanded",
        "see arm clear of part and print",
        ONLY_LEARNED,
    ),
    "asked robots clear of each other and of fixtures": Measure(
        "mm",
        "robots and fixtures keep the required distance, less asked_off_max_mm, if the robot does exactly what is commanded",
        "see robots clear of each other and of fixtures",
        ONLY_LEARNED,
    ),
    "axis near the file's normals": Measure(
        "deg",
        "smoothing turns the nozzle from the normals of a file of waypoints no further than allowed",
        "see file_normal_max_deg; the limit is layers.source.smooth_normals_deg, 3 by default, plus the lean that "
        "the nozzle may have; where a corner is rounded, plus the difference of the normals there",
        ONLY_WAYPOINTS,
    ),
    "beads as wide and high as asked": Measure(
        "mm",
        "beads have the width and the height that the problem asks for",
        "the toolpath's against process.bead; of layers along z the width alone",
        ONLY_ON_PARTS,
    ),
    "layers on the part": Measure(
        "mm",
        "each layer lies where it should: at its number of layer heights above the part or inside a wing's side, or on its way "
        "through a body",
        "executed tip against formulas of the part, a wing's sections, triangles of STEP faces or a file's facets, each read "
        "anew; for facets the limit is 0.05 plus what notes say of a smooth surface",
        ONLY_SURFACES,
    ),
    "nozzle normal to the part": Measure(
        "deg",
        "the nozzle's axis is that of the layer's normal, or within its cone",
        "executed axis against the normals of the same; for facets, normals over some millimetres, and a limit wider by 1 degree "
        "and the difference of normals over shorter and longer distances",
        ONLY_SURFACES,
    ),
    "beads within the part": Measure(
        "mm",
        "beads lie within the outline of their layer, or above the faces that are covered",
        "how far beads reach beyond it; for cores, how much less room there is than a layer needs; the limit is at most half a "
        "bead's width, for STEP faces process.corner_tolerance_mm",
        ONLY_BODIES,
    ),
    "layers filled": Measure(
        "of its area",
        "no place of a layer is left out: its walls are there, and its lines are no farther apart than they should be",
        "share of the places at least half a bead within the outline that no executed tip comes near, in the worst layer, or "
        "in all layers if notes say that some is left out; the limit is 0.005, plus what notes say",
        ONLY_FILLED,
    ),
    "layers as dense as asked": Measure(
        "of what is asked",
        "beads hold as much of a body as walls and infill ask for",
        "executed length times the beads' width against the area of all layers; the limit is 0.05 below 0.95, or below what notes "
        "say that beads hold",
        "a mesh is filled with layers",
    ),
    "print on the drawn path": Measure(
        "mm",
        "nothing is printed that is not in the problem's file",
        "executed tip, in the plane of the drawing, against the drawing, pattern or curves as the verifier reads them again; for "
        "waypoints and G-code, in space; the limit is process.corner_tolerance_mm plus the chord error allowed",
        ONLY_REREAD,
    ),
    "drawn path left out": Measure(
        "of its length",
        "everything in the problem's file is printed, on each layer",
        "share of the file's paths that no executed tip comes near, in the worst layer; the limit is "
        "0.001 plus the share that notes say is left out, at most layers.source.leave_out_share; not checked, which the check "
        "says, for G-code whose comments name no features, and for files of points if the print is resumed",
        ONLY_REREAD,
    ),
    "obstacles where the print is": Measure(
        "mm",
        "the obstacles that bodies are kept clear of are where beads are laid, and where the part is",
        "distance of executed tips from the nearest points of their beads and of the part, beyond what lies between",
    ),
    "nozzle tip outside the part": Measure(
        "mm", "the tip never enters the part as printed so far", "see tip_clearance_min_mm"
    ),
    "nozzle clear of part and print": Measure(
        "mm",
        "nozzle and print head keep their distance from part and print; near the tip, where they must touch, the required distance shrinks",
        "see nozzle_clearance_min_mm; the limit is collision.nozzle_mm. Where it fails near the tip: the true distance, "
        "negative inside, and the one required there; part and fixtures may be entered by half a bead's height at most",
    ),
    "print pressed by the nozzle": Measure(
        "of a bead's height",
        "the nozzle presses into beads printed before no deeper than allowed",
        "see nozzle_pressed_max_mm, by the height of the bead",
    ),
    "arm clear of part and print": Measure(
        "mm",
        "the robots' links, and where the part moves fixtures, keep their distance from part and print",
        "see arm_clearance_min_mm; the limit is collision.arm_mm",
    ),
    "robots clear of each other and of fixtures": Measure(
        "mm",
        "robots, head and fixtures keep their distance from each other",
        "see robot_clearance_min_mm; the limit is collision.arm_mm, of the head collision.nozzle_mm",
    ),
    "programs repeat the plan": Measure(
        "programs that do not",
        "programs that are read back do what the plan does",
        "see docs/programs.md, what is read back",
        ONLY_DIFFERENT,
    ),
    "as it was planned": Measure(
        "parts",
        "problem, cell and toolpath are those that the plan was made for",
        "by their digests",
        ONLY_CHANGED,
    ),
}
