"""What a recording shows of how a controller follows a program: deviation, cut corners, braking, look-ahead; in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import Cell
from planner.feedback.identify_corners import CutCorners, by_zone, corner_shape, passed_corners
from planner.feedback.identify_path import (
    MOST_SHOWN,
    CommandedPath,
    FollowedPath,
    PathDeviation,
    ShownValue,
    deviation_of,
)
from planner.feedback.identify_run import RecordedRun
from planner.feedback.identify_stops import Braking, brakings, fitted_stops, looked_ahead


@dataclass(frozen=True)
class PathFindings:
    """What a recording shows of how a controller follows a program.

    tip           deviation over the whole path;  laid: where material is laid, None if there is none
    joints        deviation of each joint [rad, m]
    corners       by zone;  depth: share of a zone's parabola that is cut; lag: time constant that rounds corners [s]
    brakes        how long before a stop it begins to brake, by speed
    ahead         look-ahead: the number of moves it knows beyond the current one
    """

    tip: PathDeviation
    laid: PathDeviation | None
    joints: tuple[PathDeviation, ...]
    corners: tuple[CutCorners, ...]
    depth: ShownValue
    lag: ShownValue
    brakes: tuple[Braking, ...]
    ahead: ShownValue


def findings(path: CommandedPath, followed: FollowedPath) -> PathFindings:
    """Deviation, corners, braking and look-ahead of a followed path."""
    size = np.linalg.norm(followed.off, axis=1)
    move = np.searchsorted(path.target, followed.segment, side="right") if len(path.target) else followed.segment * 0
    laid = path.laid[np.minimum(move, len(path.laid) - 1)] if path.laid.any() else np.zeros(len(size), dtype=np.bool_)
    corners = passed_corners(path, followed)
    depth, lag = corner_shape(corners, followed.noise)
    stops = fitted_stops(path, followed)
    return PathFindings(
        tip=deviation_of(size, followed.noise, 2),
        laid=deviation_of(size, followed.noise, 2, laid) if laid.any() else None,
        joints=tuple(
            deviation_of(np.abs(each), float(noise), 1)
            for each, noise in zip(followed.joints.T, followed.joint_noise, strict=True)
        ),
        corners=by_zone(corners),
        depth=depth,
        lag=lag,
        brakes=tuple(brakings(stops)),
        ahead=looked_ahead(path, followed, stops),
    )


def path_lines(found: PathFindings, run: RecordedRun, cell: Cell) -> list[str]:
    """What a recording shows of how a program was followed, in words."""
    out = [f"tip off the path: {deviation_words(found.tip, run.lines)}"]
    if found.laid is not None:
        out.append(f"where material is laid: {deviation_words(found.laid, run.lines)}")
    out += joint_lines(found.joints, cell)
    for zone in found.corners:
        scatter = f" ±{1e3 * zone.scatter:.2f}" if zone.count > 1 else ""
        left = f"; the line is left {1e3 * zone.leaves:.2f} mm before" if np.isfinite(zone.leaves) else ""
        out.append(
            f"corners with zones of {1e3 * zone.zone:.3g} mm: {zone.count}, cut by {1e3 * zone.mean:.2f}{scatter} mm, "
            f"at most {1e3 * zone.most:.2f}{left}"
        )
    if not found.corners:
        out.append("corners: not shown, none has a zone and lines on both sides, or the program is not known")
    out.append(f"share of a zone's parabola that is cut: {_estimate_words(found.depth, 1.0, '', 2)}")
    out.append(f"lag that rounds corners: {_estimate_words(found.lag, 1e3, ' ms', 1)}")
    out += [
        f"brakes from {1e3 * each.speed:.0f} mm/s: begins {1e3 * each.time:.0f} ±{1e3 * each.error:.0f} ms and "
        f"{1e3 * each.way:.1f} mm before the stop ({each.count})"
        for each in found.brakes
    ]
    if not found.brakes:
        out.append("braking: not shown, it never stops from a steady speed on lines")
    out.append(f"look-ahead: {_estimate_words(found.ahead, 1.0, ' moves', 1)}")
    return out


def joint_lines(joints: Sequence[PathDeviation], cell: Cell) -> list[str]:
    """How far each joint leaves a path, in words."""
    return [
        f"  {name}: {_joint_words(each, bool(turns))}"
        for name, each, turns in zip(cell.joint_names, joints, cell.limits.turns, strict=True)
    ]


def deviation_words(each: PathDeviation, lines: Array | None = None) -> str:
    """How far a tip leaves a path, in words; lines (s): the file's lines of the samples."""
    noise = f"noise {1e3 * each.error:.3f} mm"
    if not each.shown:
        return f"not shown, below {1e3 * MOST_SHOWN * each.error:.2f} mm ({noise})"
    where = "" if lines is None else f", in line {int(lines[each.at])}"
    return f"mean {1e3 * each.mean:.3f}, most {1e3 * each.most:.3f} mm ({noise}){where}"


def _joint_words(each: PathDeviation, turns: bool) -> str:
    scale, unit = (float(np.degrees(1.0)), "degrees") if turns else (1e3, "mm")
    if not each.shown:
        return f"not shown, below {scale * MOST_SHOWN * each.error:.3f} {unit}"
    return f"mean {scale * each.mean:.3f}, most {scale * each.most:.3f} {unit} (noise {scale * each.error:.4f})"


def _estimate_words(each: ShownValue, scale: float, unit: str, digits: int) -> str:
    if each.told:
        return f"{scale * each.value:.{digits}f} ±{scale * each.error:.{digits}f}{unit}"
    if each.reason == "at least":
        return f"at least {scale * each.value:.0f}{unit}: it never held the robot back"
    return f"not shown: {each.reason}"
