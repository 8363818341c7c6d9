"""The player's model of a controller against recordings of real and simulated ABB arms: time, speeds, deviation.

python -m benchmarks.controller DATA

DATA holds files of the public repository hehonglu123/Motion-Primitive-Planning, as retyped tables (docs/controller_model.md
says which). DATA/corners/real and DATA/corners/simulated hold folders of hehonglu123/ABB_Primitive_Study.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.interpolate import make_lsq_spline
from scipy.signal import lfilter, medfilt, savgol_filter

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED, InputError
from planner.base.geometry import arc_lengths
from planner.cell.cell import Cell, build_cell
from planner.export.fit import from_matrix
from planner.export.player.model import ABB, MotionModel
from planner.export.player.path import MOST_TICKS, corner_depth
from planner.export.player.path import TICK as PATH_TICK
from planner.export.player.play import play
from planner.export.player.played import Played
from planner.export.program import RobotProgram
from planner.export.rapid.writer import quadrants
from planner.problem import load_problem

# The tool of all recordings, from recorded joints and the tips that belong to them: exact to 2 um.
TOOL = "[75,0,493.30127]"
FREE = 1e4  # rad/s, m/s: speed data of the recordings leave all but the tip open
WINDOW = 0.05  # s in which a speed is measured: stamps are off by 4 ms
TICK = 0.002  # s
ROWS = 3  # of a recording, the middle one of which counts
SIMULATED = 4.032 / 4.0  # RobotStudio stamps a tick of the controller, 4.032 ms, as 4 ms
AT_REST = 1e-3  # m from an end of the run, where time begins and ends: the arm creeps to the very place
KNOTS = 0.05  # m of path over which recorded joints are smoothed
BEGUN = 15  # targets after which curves are compared: what is recorded of the first one begins in motion
CURVES = (
    ("curve 1, v400 z10", "cmd.csv", ("run0_b.csv", "run0_c.csv"), 0.4, 10e-3, 2),
    ("curve 2, v1100 z10", "c2cmd.csv", ("c2run0.csv",), 1.1, 10e-3, 0),
)
FITTED = "simulated/movel_30_car"  # of the corners
VMAX = 5.0  # m/s: what vmax stands for; no arm of this size reaches it
CUT = 0.5e-3  # m: a corner that is cut by less is compared in millimetres alone
AROUND = 0.06  # m of a corner within which its least speed is looked for
COLUMNS = ("run", "robot", "", "time, s", "", "mean, mm/s", "", "least, mm/s", "", "deviation, mm: mean most")
GROUPS = ("", "robot", "speed", "runs", "time", "mean speed", "least speed", "greatest deviation")


@dataclass(frozen=True)
class Recording:
    """A run: what was commanded and what the arm did.

    t, tip    (k) [s], (k, 3) [m] of the tip
    ends      places at which the comparison begins and ends [m], and how near the tip must come to them; 0: as near as it does
    corner    the place around which the least speed is looked for; None for all between the ends
    """

    name: str
    robot: str
    fitted: bool
    program: RobotProgram
    t: Array
    tip: Array
    ends: tuple[Array, Array]
    near: tuple[float, float]
    corner: Array | None = None


@dataclass(frozen=True)
class Measured:
    """Time [s], mean and least speed [m/s] between two places; mean and greatest distance from the lines [m]."""

    time: float
    mean: float
    least: float
    off: float
    most: float


def cell_of_recordings() -> Cell:
    """An IRB 6640-180/2.55 with the recordings' tool."""
    changes = ("arm=irb6640", f"nozzle.tip_mm={TOOL}", "home_deg=[0,0,0,0,30,0]", "bed_mm=[0,0,0]")
    return build_cell(load_problem("planar_gcode", [f"cell.{change}" for change in changes]))


def program_of(
    cell: Cell, q: Array, position: Array, speed: float, zone: float, fine: Sequence[int] = ()
) -> RobotProgram:
    """Lines through tip positions (m + 1, 3), turned as in postures q (m + 1, 6), from the first of them, where it rests."""
    m = len(q) - 1
    stops = np.isin(np.arange(m), [*fine, m - 1])
    T = cell.T_part_nozzle(np.ascontiguousarray(q))
    identity = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    return RobotProgram(
        module="Recorded",
        tool=np.concatenate([cell.T_flange_nozzle[:3, 3], from_matrix(cell.T_flange_nozzle[None, :3, :3])[0]]),
        uframe=identity,
        oframe=identity,
        station="",
        start=np.concatenate([q[0], np.full(6, np.nan)]),
        linear=np.ones(m, dtype=bool),
        fine=stops,
        position=position[1:],
        quat=from_matrix(T[1:, :3, :3]),
        conf=np.column_stack([quadrants(q[1:]), cell.inverse.branches(q[1:])]).astype(np.intp),
        external=np.full((m, 6), np.nan),
        zone=np.where(stops, 0.0, zone),
        speed=np.tile([speed, FREE, FREE, FREE], (m, 1)),
        wait=np.zeros(m),
        triggers={},
    )


# ----------------------------------------------------------------------------------------------------
# Measures, the same of what was recorded and what is predicted.


def stretch(t: Array, tip: Array, recording: Recording) -> tuple[float, float]:
    """When the tip is at both ends of the comparison [s]."""
    (a, b), (near_a, near_b) = recording.ends, recording.near
    to_a, to_b = np.linalg.norm(tip - a, axis=1), np.linalg.norm(tip - b, axis=1)
    begin = int(np.argmin(to_a)) if near_a == 0.0 else int(np.flatnonzero(to_a <= max(near_a, to_a.min()))[-1])
    if near_b == 0.0:
        return float(t[begin]), float(t[begin + int(np.argmin(to_b[begin:]))])
    return float(t[begin]), float(t[begin + int(np.flatnonzero(to_b[begin:] <= max(near_b, to_b[begin:].min()))[0])])


def measured(t: Array, tip: Array, recording: Recording, middle: int = ROWS) -> Measured:
    """Figures of a motion between the ends of a recording; of its distances, the middle of so many rows counts."""
    grid = np.arange(t[0], t[-1], TICK)
    even = np.column_stack([np.interp(grid, t, tip[:, k]) for k in range(3)])
    begin, end = stretch(grid, even, recording)
    way = arc_lengths(even)
    inside = (grid >= begin) & (grid <= end)
    window = min(int(WINDOW / TICK) | 1, (int(inside.sum()) - 1) | 1)
    speed = savgol_filter(way, window, 1, deriv=1, delta=TICK)
    if recording.corner is not None:
        looked = inside & (np.linalg.norm(even - recording.corner, axis=1) < AROUND)
    else:  # without what speeds up from rest and slows down to it
        fast = np.flatnonzero(inside & (speed >= 0.95 * np.percentile(speed[inside], 90)))
        looked = np.zeros(len(speed), dtype=bool)
        looked[fast[0] : fast[-1] + 1] = True
    least = float(speed[looked].min())
    position = np.vstack([recording.ends[0][None], recording.program.position])
    # joints of one row may come from two ticks, which takes single rows aside
    rows = medfilt(distances(tip, position), middle)
    off = np.interp(grid, t, rows)[inside & looked if recording.corner is not None else inside]
    mean = float((way[inside][-1] - way[inside][0]) / (end - begin))
    return Measured(end - begin, mean, least, float(off.mean()), float(off.max()))


def distances(points: Array, corners: Array) -> Array:
    """Distance (k) of points (k, 3) from the polyline through corners (m, 3)."""
    a, d = corners[:-1], np.diff(corners, axis=0)
    keep = np.linalg.norm(d, axis=1) > 0.0
    a, d = a[keep], d[keep]
    out = np.full(len(points), np.inf)
    for start, way in zip(a, d, strict=True):
        u = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
        np.minimum(out, np.linalg.norm(points - start - u[:, None] * way, axis=1), out=out)
    return out


@dataclass(frozen=True)
class PlayedDeviation:
    """Distance of the played tip from the programmed path.

    at       (m) at the target of each move [m]; 0 where the robot rests
    t, off   (k) instants [s], and how far the arm lags aside there, zones left out [m]
    """

    at: Array
    t: Array
    off: Array


def played_deviation(program: RobotProgram, played: Played, model: MotionModel) -> PlayedDeviation:
    """How far the tip leaves the programmed path, to the side: in its own frame, since recordings tell no more. Forecasts
    follow the joints instead, see `executed_run`.

    Within a zone the path is that of `corner_depth`. The arm follows with a lag, as through a filter that weighs what was
    commanded dt before and after by exp(-|dt| / lag): a corner is rounded by speed, lag and half of the change of
    direction; a curve is cut by the square of the lag times its acceleration across.
    """
    depth = model.depth * corner_depth(program, played)
    tick = max(PATH_TICK, played.duration / MOST_TICKS)
    t = np.arange(0.0, played.duration + tick, tick)
    position = played.at(t).position
    off = np.zeros(len(t))
    if model.lag > 0.0 and len(t) > 2:
        keep = np.exp(-tick / model.lag)
        way = position - position[0]
        late, _ = lfilter([1.0 - keep], [1.0, -keep], way, axis=0, zi=keep * way[:1])
        back = late[::-1] - late[-1]
        early, _ = lfilter([1.0 - keep], [1.0, -keep], back, axis=0, zi=keep * back[:1])
        moved = early[::-1] + late[-1] - way
        along = np.gradient(position, tick, axis=0)
        size = np.linalg.norm(along, axis=1, keepdims=True)
        along = along / np.where(size > 0.0, size, 1.0)
        off = np.linalg.norm(moved - (moved * along).sum(axis=1, keepdims=True) * along, axis=1)
    lagging = np.interp(played.arrive, t, off)
    return PlayedDeviation(np.where(program.fine, 0.0, np.hypot(depth, lagging)), t, off)


def predicted(cell: Cell, recording: Recording, model: MotionModel) -> Measured:
    """The same figures of the program as the player plays it."""
    played = play(recording.program, cell, model)
    t = np.arange(-0.05, played.duration + 0.05, TICK)
    tip = played.at(t).position
    figures = measured(t, tip, recording, 1)
    begin, end = stretch(t, tip, recording)
    off = played_deviation(recording.program, played, model)
    inside = (off.t >= begin) & (off.t <= end)
    if recording.corner is not None:
        inside &= np.linalg.norm(played.at(off.t).position - recording.corner, axis=1) < AROUND
    passed = (played.arrive >= begin) & (played.arrive <= end)
    most = max(off.at[passed].max(initial=0.0), off.off[inside].max(initial=0.0))
    return Measured(figures.time, figures.mean, figures.least, float(off.off[inside].mean()), float(most))


# ----------------------------------------------------------------------------------------------------
# Recordings.


def table(path: Path) -> Array:
    """Numbers of a file with commas; rows that are not whole are left out, and so are those with the stamp of another."""
    rows = np.atleast_2d(np.genfromtxt(path, delimiter=",", invalid_raise=False))
    rows = rows[np.isfinite(rows).all(axis=1)]
    if rows.size == 0:
        raise InputError("it has no numbers", file=str(path))
    return rows


def recorded(cell: Cell, *paths: Path, simulated: bool = False) -> tuple[Array, Array, Array]:
    """Time (k) [s], joints (k, 6) and tips (k, 3) of a run in one or more files."""
    rows = np.vstack([table(path) for path in paths])
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 1e-6])]
    q = np.radians(rows[:, 2:8])
    t = rows[:, 0] * (SIMULATED if simulated else 1.0)
    return t, q, cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]


def smooth_postures(q: Array, tip: Array, places: Array) -> tuple[Array, Array]:
    """Postures (m, 6) and tips' metres of path (k), on smooth curves through what was recorded, at metres of path (m).

    Joints of one row may come from two ticks of the controller, so they are smoothed over KNOTS of path.
    """
    way = arc_lengths(tip)
    goes = np.concatenate([[True], np.diff(way) > 0.05 * np.median(np.diff(way))])
    way, q = way[goes], q[goes]
    inner = np.arange(way[0] + KNOTS, way[-1] - KNOTS, KNOTS)
    counts = np.histogram(way, np.concatenate([[way[0]], inner, [way[-1]]]))[0]
    inner = inner[(counts[1:] > 1) & (counts[:-1] > 1)]
    knots = np.concatenate([[way[0]] * 4, inner, [way[-1]] * 4])
    spline = make_lsq_spline(way, q, knots)
    out: Array = spline(np.clip(places, way[0], way[-1]))
    return out, way


def curves(cell: Cell, data: Path) -> Iterator[Recording]:
    """The real runs along curves 1 and 2.

    The stored commands are of a later iteration than the runs: they leave what was recorded by up to 5 mm. So the targets
    are at the recorded places where the tip passes nearest to the stored ones, in the recorded orientation there.
    """
    for name, command, files, speed, zone, first in CURVES:
        if not (data / command).is_file():
            continue
        t, q, tip = recorded(cell, *(data / file for file in files))
        stored = 1e-3 * table(data / command)[first:]
        way = arc_lengths(tip)
        dense = np.linspace(0.0, way[-1], 20 * len(way))
        at = np.column_stack([np.interp(dense, way, tip[:, k]) for k in range(3)])
        passed = np.array([dense[int(np.argmin(np.linalg.norm(at - place, axis=1)))] for place in stored])
        passed = np.unique(passed[(passed > 5e-3) & (passed < way[-1] - 5e-3)])
        posture, _ = smooth_postures(q, tip, np.concatenate([[0.0], passed, [way[-1]]]))
        position = cell.T_part_nozzle(np.ascontiguousarray(posture))[:, :3, 3]
        program = program_of(cell, posture, position, speed, zone)
        ends = (position[BEGUN], position[-1])
        yield Recording(name, "real", "curve 1" in name, program, t, tip, ends, (0.0, AT_REST))


def corners(cell: Cell, data: Path) -> Iterator[Recording]:
    """Two lines with one corner at many speeds and zones: folders of ABB_Primitive_Study."""
    for folder in sorted((data / "corners").glob("*/*")):
        js = table(folder / "Curve_js.csv")
        q = js[[0, len(js) // 2, -1]]
        position = cell.T_part_nozzle(np.ascontiguousarray(q))[:, :3, 3]
        robot, fitted = folder.parent.name, f"{folder.parent.name}/{folder.name}" == FITTED
        for path in sorted(folder.glob("curve_exe_v*_*.csv")):
            _, _, speed, zone = path.stem.split("_")
            v = VMAX if speed == "vmax" else 1e-3 * float(speed[1:])
            radius = 0.0 if zone == "fine" else 1e-3 * float(zone[1:])
            t, _, tip = recorded(cell, path, simulated=robot == "simulated")
            program = program_of(cell, q, position, v, radius, (0,) if zone == "fine" else ())
            yield Recording(
                f"{folder.name}, {speed} {zone}",
                robot,
                fitted,
                program,
                t,
                tip,
                (position[0], position[-1]),
                (AT_REST,) * 2,
                position[1],
            )


# ----------------------------------------------------------------------------------------------------
# The tables.


@dataclass(frozen=True)
class Compared:
    """A run as it was recorded and as it is predicted."""

    recording: Recording
    was: Measured
    told: Measured

    @property
    def errors(self) -> tuple[float, float, float]:
        """Of time, mean and least speed, by their own size; the last one is NaN where the robot was to rest between."""
        was, told = self.was, self.told
        least = float("nan") if self.recording.program.fine[:-1].any() else told.least / was.least - 1.0
        return told.time / was.time - 1.0, told.mean / was.mean - 1.0, least


def run_row(each: Compared) -> list[str]:
    """Cells of one run."""
    was, told = each.was, each.told
    time, mean, least = each.errors
    return [
        each.recording.name,
        each.recording.robot,
        "fitted" if each.recording.fitted else "held out",
        f"{was.time:.3f} / {told.time:.3f}",
        f"{100 * time:+.1f} %",
        f"{1e3 * was.mean:.0f} / {1e3 * told.mean:.0f}",
        f"{100 * mean:+.1f} %",
        f"{1e3 * was.least:.0f} / {1e3 * told.least:.0f}",
        "rests" if np.isnan(least) else f"{100 * least:+.0f} %",
        f"{1e3 * was.off:.2f} {1e3 * was.most:.2f} / {1e3 * told.off:.2f} {1e3 * told.most:.2f}",
    ]


def group_rows(found: Sequence[Compared]) -> Iterator[list[str]]:
    """Cells of all runs of a robot and a speed, fitted and held out ones apart: usual and worst errors."""
    groups: dict[tuple[bool, str, float], list[Compared]] = {}
    for each in found:
        key = (not each.recording.fitted, each.recording.robot, float(each.recording.program.speed[0, 0]))
        groups.setdefault(key, []).append(each)
    for (held_out, robot, speed), runs in sorted(groups.items()):
        errors = 100 * np.abs([each.errors for each in runs])
        off = 1e3 * np.abs([each.told.most - each.was.most for each in runs])
        cut = [abs(each.told.most / each.was.most - 1.0) for each in runs if each.was.most > CUT]
        kept = errors[~np.isnan(errors[:, 2]), 2]
        yield [
            "held out" if held_out else "fitted",
            robot,
            "vmax" if speed == VMAX else f"v{1e3 * speed:.0f}",
            str(len(runs)),
            f"{np.median(errors[:, 0]):.1f}, {errors[:, 0].max():.1f} %",
            f"{np.median(errors[:, 1]):.1f}, {errors[:, 1].max():.1f} %",
            f"{np.median(kept):.0f}, {kept.max():.0f} %" if len(kept) else "",
            f"{np.median(off):.2f}, {off.max():.2f} mm" + (f" ({100 * np.median(cut):.0f} % of cuts)" if cut else ""),
        ]


def compared(data: Path, model: MotionModel = ABB) -> list[Compared]:
    """All recordings of a folder against what is predicted of them. InputError for a folder without any."""
    cell = cell_of_recordings()
    found = [*curves(cell, data), *corners(cell, data)]
    if not found:
        raise InputError("there are no recordings in this folder", file=str(data))
    return [Compared(each, measured(each.t, each.tip, each), predicted(cell, each, model)) for each in found]


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.controller", description=__doc__)
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--all", action="store_true", help="a row for each run")
    options = parser.parse_args(arguments)
    found = compared(options.data)
    if options.all:
        runs = Table(*COLUMNS, title="Recorded / predicted", title_justify="left")
        for each in found:
            runs.add_row(*run_row(each))
        Console(width=180).print(runs)
    groups = Table(*GROUPS, title="Errors of the prediction: median and worst", title_justify="left")
    for row in group_rows(found):
        groups.add_row(*row)
    Console(width=180).print(groups)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
