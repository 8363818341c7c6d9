"""A trial print for an arm: where it may stand, which posture it starts from, and whether its plan is verified."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, Refusal
from planner.cell.robot import Robot
from planner.new.posture import FAR, HIGH, ROUND, reached
from planner.plan import Plan
from planner.planning.check_command import examine
from planner.planning.pipeline import solve
from planner.problem.problem import parse_problem
from planner.robots.face import DEEP, depth
from planner.robots.files import BENDS, Cap, TrialNozzle, cap_for, nozzle_of, print_text, trial_files
from planner.robots.listing import reach

ABOVE = 0.05  # m above the cap, where the print begins and ends
PLACES = 20  # best places to try, one after another
PLANS = 6  # to try with each nozzle; places without a collision-free posture do not count: they cost almost nothing
LONGEST = 240.0  # s after which no further place is tried
HOMES = 4  # postures to try at each place
BACK = -0.15  # height of a place as a fraction of the reach, for arms that work best below their base
HUNG = (-0.3, -0.45, -0.6, -0.75)  # likewise, heights of places beneath an arm that hangs in its URDF


@dataclass(frozen=True)
class Trial:
    """A trial print: its name, its problem file's text, and its verified plan; without a plan, the reason why."""

    name: str
    text: str
    plan: Plan | None
    reason: str


class _Failure(NamedTuple):
    """Why there is no verified print at a place, and whether one was planned there."""

    reason: str
    planned: bool


def trial(robot: Robot, file: Path, outwards: Array, cap: Cap | None = None) -> Trial:
    """Plan a spiral on a cap with a robot whose file exists already; the nozzle is bent as in the problem peer_cap, or
    else straight. outwards: direction in which the last axis leaves the flange, in its frame; cap: in place of the one
    sized for the arm's reach."""
    far = reach(robot) or 0.0
    cap = cap or cap_for(far)
    waypoints, _ = trial_files(file)
    waypoints.write_text(cap.waypoints, encoding="utf-8")
    made = None
    try:
        made = _first_verified(robot, file, waypoints.stem, outwards, cap, far)
    finally:
        if made is None or made.plan is None:
            waypoints.unlink()
    return made


def _first_verified(robot: Robot, file: Path, name: str, outwards: Array, cap: Cap, far: float) -> Trial:
    """As `trial`, once the waypoints are there; far: the arm's reach [m]."""
    reason = f"no place was found where it reaches all of a cap of {cap.radius * 1e3:g} mm"
    deep = depth(robot, outwards)
    deep, ends = deep if deep > DEEP else 0.0, time.monotonic() + LONGEST
    for nozzle in (nozzle_of(outwards, bend, deep) for bend in BENDS):
        planned = 0
        for place in _places(robot, nozzle, cap, far):
            if time.monotonic() > ends:
                break
            tried = _tried(robot, file, name, nozzle, place, cap)
            if isinstance(tried, Trial):
                return tried
            reason, planned = tried.reason, planned + tried.planned
            if planned == PLANS:
                break
    return Trial(name, "", None, reason)


def _tried(robot: Robot, file: Path, name: str, nozzle: TrialNozzle, place: Array, cap: Cap) -> Trial | _Failure:
    """A verified print at a place [m], or why there is none."""
    above, down = _groups(cap)[0]
    reason = "no posture there is free of collisions"
    for posture in reached(robot, nozzle.tip, place + above, down, nozzle.axis).postures[:HOMES]:
        home = (np.round(np.degrees(posture), 1) + 0.0).tolist()
        text = print_text(name, file, f"{name}.txt", nozzle, place, home)
        problem = parse_problem(text, file.parent / f"{name}.yaml")
        mistakes = examine(problem).mistakes
        if mistakes:
            reason = str(mistakes[0])
            continue
        try:
            plan = solve(problem, baseline=False)
        except (Refusal, InputError) as error:
            return _Failure(str(error), True)
        if plan.verified:
            return Trial(name, text, plan, "")
        failed = [check.name for check in plan.checks if not check.ok]
        return _Failure(f"planned, not verified: {', '.join(failed)}", True)
    return _Failure(reason, False)


def _groups(cap: Cap) -> list[tuple[Array, Array]]:
    """Points (k, 3) [m] that the arm has to reach, from the cap's centre, and the nozzle axis there: first a point
    above the cap and its top, then those on its rim."""
    out = [(np.array([[0.0, 0.0, cap.radius + ABOVE], [0.0, 0.0, cap.radius]]), np.array([0.0, 0.0, -1.0]))]
    for turn in np.arange(6) * np.pi / 3.0:
        normal = np.array([np.sin(cap.polar) * np.cos(turn), np.sin(cap.polar) * np.sin(turn), np.cos(cap.polar)])
        out.append((cap.radius * normal[None], -normal))
    return out


def _places(robot: Robot, nozzle: TrialNozzle, cap: Cap, far: float) -> list[Array]:
    """Rounded places (3) [m] for the cap's centre in front of the arm, wherever its URDF puts that: best first, none
    close to another."""
    T_base_stand, rated = robot.T_base_stand, []
    for high in HUNG if T_base_stand[2, 2] < -0.5 else (*HIGH, BACK):
        for share in FAR:
            at = np.round((T_base_stand[:3, 3] + np.array([share, 0.0, high]) * far) / ROUND) * ROUND
            worth = 1.0
            for points, axis in _groups(cap):
                if worth > 0.0:
                    worth = min(worth, reached(robot, nozzle.tip, at + points, axis, nozzle.axis).worth)
            if worth > 0.0:
                rated.append((worth, at))
    rated.sort(key=lambda each: -each[0])
    out: list[Array] = []
    for _, at in rated:
        if len(out) < PLACES and all(np.linalg.norm(at - other) > 0.08 * far for other in out):
            out.append(at)
    return out
