"""Random cases: a cell, a part in it and a path on the part, as a file of waypoints and a problem file.

A case is identified by its kind and number (turntable_17) and is the same on every machine: other kinds, and the number
of cases, do not change it. Ranges are chosen so that most parts can be reached, and some cannot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import Generator

from benchmarks.random_paths import HALF_SIZES, random_beads, random_helix

FAR = 0.1  # share of parts that stand so far off that few can be reached
SPEEDS = (5.0, 80.0)  # mm/s
NOISY, NOISE_DEG = 0.4, (0.1, 1.0)  # share of paths with measured normals, and the standard deviation of these
SMOOTHED, SMOOTHED_BY = 0.85, 4.0  # share of those that are smoothed, by so many standard deviations at most
LOGO_NOZZLE = {"tip_mm": [-44.51, 9.9, 113.95], "axis": [0, 0, 1]}
PEER_NOZZLE = {"tip_mm": [0, 0, 100], "axis": [1, 0, 1]}
CHEN_NOZZLE = {"tip_mm": [151.585, -88.7572, 189.022], "axis": [0.603793, -0.374009, 0.703954]}

HEAD = """\
# {title}
# Lengths are millimetres, angles degrees, as the names of the keys say.
name: {name}
"""


@dataclass(frozen=True)
class Case:
    """A case: its waypoints and its problem, as they stand in files."""

    kind: str
    number: int
    waypoints: str
    problem: str

    @property
    def name(self) -> str:
        """What it is known by."""
        return f"{self.kind}_{self.number}"

    def write(self, folder: Path) -> Path:
        """Write both files into a folder; returns the problem file."""
        (folder / f"{self.name}.txt").write_text(self.waypoints, encoding="utf-8")
        path = folder / f"{self.name}.yaml"
        path.write_text(self.problem, encoding="utf-8")
        return path


@dataclass(frozen=True)
class Arm:
    """An arm: postures to start in, turned aside by joint 1; where on a bed (low, high) [mm] a part may stand; how far
    a part may reach to either side [mm]; nozzles that it is known with."""

    home: tuple[float, ...]
    bed: tuple[tuple[float, float, float], tuple[float, float, float]]
    largest: float
    nozzles: tuple[dict[str, Any], ...] = ()


ARMS = {
    "irb140": Arm((0, 0, 0, 0, 45, 0), ((380, -220, 80), (600, 220, 330)), 50, (LOGO_NOZZLE, PEER_NOZZLE)),
    "irb2600": Arm((0, 0, 0, 0, 60, 0), ((800, -400, 150), (1250, 400, 600)), HALF_SIZES[1], (CHEN_NOZZLE,)),
    "irb1200_09": Arm((0, -20, 0, 0, 110, 0), ((420, -250, 80), (680, 250, 350)), 50),
    "ur10e": Arm((0, -90, 90, -90, -90, 0), ((450, -300, 50), (850, 300, 350)), HALF_SIZES[1]),
    "iiwa": Arm((0, 30, 0, -90, 0, 60, 0), ((420, -250, 50), (620, 250, 350)), 45),
    "panda": Arm((0, -45, 0, -135, 0, 90, 45), ((350, -200, 30), (550, 200, 250)), 40),
    "xarm7": Arm((0, -20, 0, 60, 0, 80, 0), ((320, -200, 30), (500, 200, 250)), 40),
}
# where parts may stand before an arm that hangs from a ceiling, in its own frame (low, high) [mm]
BELOW = {
    "irb140": ((350, -200, 350), (600, 200, 700)),
    "irb2600": ((600, -400, 500), (1150, 400, 1200)),
    "ur10e": ((400, -300, 400), (800, 300, 850)),
}
# an arm on a wall has z level and x downwards
BESIDE = {
    "irb140": ((350, -200, 450), (650, 200, 800)),
    "irb2600": ((600, -400, 700), (1150, 400, 1300)),
    "ur10e": ((400, -300, 400), (800, 300, 800)),
}
# arms that ride on a track, whose top is so high [mm]
RIDERS, TRACK_HEIGHT = {"irb140": 0.25, "irb2600": 0.4, "ur10e": 0.2, "iiwa": 0.15}, 300.0
# the plate of the positioner in front of each arm [mm], and by how much it may stand elsewhere
PLATES = {
    "irb140": ((633.5, 9.87, 320.0), 50.0),
    "irb2600": ((1101.77, -8.99, 605.88), 100.0),
    "iiwa": ((600.0, 0.0, 200.0), 50.0),
    "panda": ((550.0, 0.0, 150.0), 40.0),
    "xarm7": ((500.0, 0.0, 150.0), 40.0),
}


@dataclass(frozen=True)
class Stand:
    """What a kind draws for its cell: the section `cell` of the problem, the part's lowest point (3) in its frame [mm],
    how large it may be [mm], and whether it can be turned around."""

    cell: dict[str, Any]
    foot: tuple[float, float, float]
    largest: float
    around: bool


def _arm(rng: Generator, name: str) -> dict[str, Any]:
    """Keys of an arm, its nozzle and its start posture."""
    arm = ARMS[name]
    aside = rng.choice([-1.0, 1.0]) * rng.uniform(50.0, 90.0)
    if arm.nozzles and rng.random() < 0.5:
        nozzle = dict(arm.nozzles[int(rng.integers(len(arm.nozzles)))])
    else:
        lean, towards = np.radians(rng.uniform(0.0, 50.0)), rng.uniform(0.0, 2.0 * np.pi)
        axis = [np.sin(lean) * np.cos(towards), np.sin(lean) * np.sin(towards), np.cos(lean)]
        tip = [rng.uniform(-50.0, 50.0), rng.uniform(-50.0, 50.0), rng.uniform(100.0, 200.0)]
        nozzle = {"tip_mm": _rounded(tip, 2), "axis": _rounded(axis, 4)}
    home = [round(aside + arm.home[0], 1), *arm.home[1:]]
    return {"arm": name, "nozzle": nozzle | {"diameter_mm": 0.6}, "home_deg": home}


def _limits(rng: Generator, name: str, table: bool) -> dict[str, Any]:
    """Limits that a user may have of their own, in some of the cases."""
    limits: dict[str, Any] = {}
    if name in ("irb140", "irb2600") and rng.random() < 0.3:
        most = int(rng.choice([180, 270, 400]))
        limits |= {"joint_4": {"range_deg": [-most, most]}, "joint_5": {"range_deg": [-120, 120]}}
    if table and rng.random() < 0.4:
        most = int(rng.choice([200, 360, 3600]))
        limits["rotation"] = {"range_deg": [-most, most]}
    return {"limits": limits} if limits else {}


def _foot(rng: Generator, high: float) -> tuple[float, float, float]:
    """A place of the part in its frame [mm]: on the table's axis in half of the cases, and a little above."""
    x, y = (0.0, 0.0) if rng.random() < 0.5 else rng.uniform(-40.0, 40.0, 2)
    return float(x), float(y), rng.uniform(8.0, high)


def _bed(rng: Generator, name: str) -> Stand:
    low, high = (np.array(corner) for corner in ARMS[name].bed)
    at = rng.uniform(low, high)
    if rng.random() < FAR:
        at[0] = high[0] * rng.uniform(1.1, 1.6)
    cell: dict[str, Any] = {**_arm(rng, name), "bed_mm": _rounded(at, 1)}
    if rng.random() < 0.3:
        cell["bed_rpy_deg"] = _rounded([*rng.uniform(-30.0, 30.0, 2), rng.uniform(-180.0, 180.0)], 1)
    elif rng.random() < 0.5:
        box = {"box_mm": [300, 300, 20], "centre_mm": _rounded(at - [0.0, 0.0, 10.0], 1)}
        cell["fixtures"] = {"bed": box}
    return Stand({**cell, **_limits(rng, name, False)}, _foot(rng, 60.0), ARMS[name].largest, False)


def bed(rng: Generator) -> Stand:
    """A part on a fixed bed."""
    return _bed(rng, str(rng.choice(["irb140", "irb2600", "irb1200_09", "ur10e"], p=[0.4, 0.3, 0.2, 0.1])))


def _table(rng: Generator, name: str, free: list[str]) -> Stand:
    origin, elsewhere = PLATES[name]
    at = np.array(origin) + rng.uniform(-elsewhere, elsewhere, 3)
    if rng.random() < FAR:
        at[0] *= rng.uniform(1.2, 1.6)
    positioner: dict[str, Any] = {"robot": "irbp_a250", "origin_mm": _rounded(at, 1), "free": free}
    if "tilt" not in free and rng.random() < 0.2:
        positioner["held_deg"] = {"tilt": round(rng.uniform(-45.0, 45.0), 1)}
    cell = {**_arm(rng, name), "positioner": positioner, **_limits(rng, name, True)}
    return Stand(cell, _foot(rng, 90.0), ARMS[name].largest, True)


def _either(rng: Generator) -> str:
    return str(rng.choice(["irb140", "irb2600"]))


def turntable(rng: Generator) -> Stand:
    """One axis that turns the part."""
    return _table(rng, _either(rng), ["rotation"])


def two_axes(rng: Generator) -> Stand:
    """Two axes that turn and tilt the part."""
    return _table(rng, _either(rng), ["tilt", "rotation"])


def second_arm(rng: Generator) -> Stand:
    """Another arm that holds the part, some of its joints free."""
    free = [["joint_6"], ["joint_6"], ["joint_5", "joint_6"], ["joint_1", "joint_6"]][int(rng.integers(4))]
    angles = {"joint_2": 60, "joint_3": -40, "joint_5": -110 + round(rng.uniform(-20.0, 20.0), 1)}
    positioner: dict[str, Any] = {
        "robot": "irb1200_09",
        "base_mm": _rounded([1320.0 + rng.uniform(-80.0, 60.0), rng.uniform(-80.0, 80.0), 0.0], 1),
        "turn_deg": 180,
        "free": free,
        "held_deg": {name: angle for name, angle in angles.items() if name not in free},
    }
    at_home = {name: angle for name, angle in angles.items() if name in free}
    if at_home:
        positioner["home_deg"] = at_home
    return Stand({**_arm(rng, "irb1200_09"), "positioner": positioner}, _foot(rng, 50.0), 50.0, True)


def rail(rng: Generator) -> Stand:
    """An arm on a track of 3 m that is free, beside which a part stands that may be longer than the arm reaches."""
    name = str(rng.choice(list(RIDERS), p=list(RIDERS.values())))
    low, high = (np.array(corner) for corner in ARMS[name].bed)
    forward, aside, up = rng.uniform(low, high)
    if rng.random() < FAR:
        forward = high[0] * rng.uniform(1.1, 1.6)
    along = float(rng.uniform(300.0, 2700.0))
    at = np.array([along, forward, up + TRACK_HEIGHT])
    cell: dict[str, Any] = {**_arm(rng, name), "bed_mm": _rounded(at, 1)}
    first = cell["home_deg"][0]  # aside of x; the part stands along y
    cell["home_deg"] = [round(float(first - np.copysign(90.0, first)), 1), *ARMS[name].home[1:]]
    rests = float(np.clip(along + rng.choice([0.0, 5.0]) * aside, 50.0, 2950.0))
    cell["base"] = {"robot": "track_3m", "free": ["rail"], "home_mm": {"rail": round(rests, 1)}}
    if rng.random() < 0.3:
        cell["fixtures"] = {"bed": {"box_mm": [800, 300, 20], "centre_mm": _rounded(at - [0.0, 0.0, 10.0], 1)}}
    limits = _limits(rng, name, False)
    if rng.random() < 0.3:
        slow = {"speed_mm_s": float(rng.choice([100, 300])), "acceleration_mm_s2": float(rng.choice([500, 1000]))}
        limits = {"limits": {**limits.get("limits", {}), "rail": slow}}
    largest = ARMS[name].largest if rng.random() < 0.4 else 350.0
    return Stand({**cell, **limits}, _foot(rng, 60.0), largest, False)


def hung(rng: Generator) -> Stand:
    """An arm that hangs from a ceiling or stands out from a wall, over a bed or a turntable."""
    name, ceiling = str(rng.choice(list(BELOW))), rng.random() < 0.6
    low, high = (np.array(corner, dtype=float) for corner in (BELOW if ceiling else BESIDE)[name])
    x, y, z = rng.uniform(low, high)
    if rng.random() < FAR:
        z = high[2] * rng.uniform(1.1, 1.6)
    foot = float(rng.uniform(1200.0, 1800.0))
    cell = _arm(rng, name)
    bent = ARMS[name].home[4] if name == "ur10e" else -45.0 if ceiling else 20.0
    cell["home_deg"] = [*cell["home_deg"][:4], bent, cell["home_deg"][5]]
    if ceiling:
        cell |= {"base_mm": [0, 0, round(foot, 1)], "base_rpy_deg": [180, 0, 0]}
        at = np.array([x, y, foot - z])
    else:
        cell |= {"base_mm": [0, 0, round(foot, 1)], "base_rpy_deg": [0, 90, 0]}
        at = np.array([z, y, foot - x])
    if rng.random() < 0.5:
        return Stand({**cell, "bed_mm": _rounded(at, 1), **_limits(rng, name, False)}, _foot(rng, 60.0), 50.0, False)
    cell["positioner"] = {"robot": "irbp_a250", "origin_mm": _rounded(at, 1), "free": ["rotation"]}
    return Stand({**cell, **_limits(rng, name, True)}, _foot(rng, 90.0), 50.0, True)


def seven_axes(rng: Generator) -> Stand:
    """An arm of seven joints, with a bed or a turntable."""
    name = str(rng.choice(["iiwa", "panda", "xarm7"]))
    return _bed(rng, name) if rng.random() < 0.7 else _table(rng, name, ["rotation"])


# A kind is what draws its cell, whether a helix is printed, and whether all three cones hold.
KINDS: dict[str, tuple[Callable[[Generator], Stand], bool, bool]] = {
    "bed": (bed, False, False),
    "turntable": (turntable, False, False),
    "two_axes": (two_axes, False, False),
    "cones": (two_axes, False, True),
    "second_arm": (second_arm, False, False),
    "seven_axes": (seven_axes, False, False),
    "helix_turntable": (turntable, True, False),
    "helix_two_axes": (two_axes, True, False),
    "rail": (rail, False, False),
    "hung": (hung, False, False),
}


def make_case(kind: str, number: int) -> Case:
    """The case of a kind with a number from 0."""
    stand_of, helix, coned = KINDS[kind]
    rng = np.random.default_rng([crc32(kind.encode()), number])
    stand = stand_of(rng)
    width = round(rng.uniform(0.6, 1.6), 2)
    height = round(width * rng.uniform(0.4, 0.8), 2)
    if helix:
        path = random_helix(rng, width)
    else:
        path = random_beads(rng, stand.largest, stand.around, width, height)
    source: dict[str, Any] = {"waypoints": f"{kind}_{number}.txt"}
    if rng.random() < NOISY:
        noise = rng.uniform(*NOISE_DEG)
        path = path.noisy(np.radians(noise), rng)
        if rng.random() < SMOOTHED:
            source["smooth_normals_deg"] = round(SMOOTHED_BY * noise, 1)
    name = f"{kind}_{number}"
    sections = {
        "cell": stand.cell,
        "layers": {"source": source},
        "process": _process(rng, width, height, coned),
    }
    title = f"A random case of kind {kind}; written by: python -m benchmarks.random_cases {name} --write ."
    text = HEAD.format(title=title, name=name)
    for key, section in sections.items():
        text += f"\n{key}:\n" + "".join(f"  {field}: {flow(value)}\n" for field, value in section.items())
    return Case(kind, number, path.text(np.array(stand.foot)), text)


def _process(rng: Generator, width: float, height: float, coned: bool) -> dict[str, Any]:
    process: dict[str, Any] = {
        "speed_mm_s": round(float(np.exp(rng.uniform(*np.log(SPEEDS)))), 1),
        "travel_speed_mm_s": 200,
        "bead": {"width_mm": width, "height_mm": height},
    }
    if rng.random() < 0.5:
        process["corner_tolerance_mm"] = round(rng.uniform(0.1, 0.5), 2)
    cones = {}
    if rng.random() < (0.75 if coned else 0.2):
        cones["nozzle_normal_deg"] = round(rng.uniform(3.0, 20.0), 1)
    if coned or rng.random() < 0.1:
        cones["nozzle_gravity_deg"] = round(rng.uniform(15.0, 70.0), 1)
    if coned:
        cones["layer_gravity_deg"] = round(rng.uniform(6.0, 50.0), 1)
    return process | ({"cones": cones} if cones else {})


def _rounded(values: Any, digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]


def flow(value: Any) -> str:
    """A value as it stands on one line of YAML; names need no quotes here."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(each) for each in value) + "]"
    return str(value)
