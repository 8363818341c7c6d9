"""Checks of the motion that a program asks for, where runs have shown that the robot executes something else.

The plan is verified as the motion that the robot executes. The motion that its program asks for differs from the plan
slightly: it must differ exactly as the file of corrections says, and be safe even for a robot that followed it exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.collision.print_body import PrintBody, print_body, standing
from planner.plan import Check, Trajectory
from planner.problem import Problem
from planner.toolpath.bead import Toolpath
from planner.verify.checks import EVERYWHERE, Findings, Judged, check_most, samples_of
from planner.verify.collision import keep_apart, sweep_cell
from planner.verify.executed import executed_motion
from planner.verify.nozzle import beyond
from planner.verify.verdict import joint_limits, rotations

WITHIN = 2e-5  # m: the tip against the file of corrections; the same tolerance as against the path
TURNED = np.radians(0.05)  # rad: the nozzle's orientation against the plan's
ASKED = "asked "  # prefix of the names of all checks here
# Checks of the plan that the asked motion must pass as well; accelerations are left to the controller.
ALSO = {
    "joint range": "asked joint range",
    "rail range": "asked rail range",
    "joint velocity": "asked joint velocity",
    "nozzle clear of part and print": "asked nozzle clear of part and print",
    "arm clear of part and print": "asked arm clear of part and print",
    "robots clear of each other and of fixtures": "asked robots clear of each other and of fixtures",
}
_SAME = (
    "dt", "t", "bead", "layer", "deposit", "s", "speed", "flow", "extruded", "feed", "events", "first_bead", "quat", "axis",
    "branch",
)  # fmt: skip
_FIELDS = ("bead", "s_mm", "dx_mm", "dy_mm", "dz_mm")


def as_run(
    problem: Problem,
    cell: Cell,
    toolpath: Toolpath,
    trajectory: Trajectory,
    asked: Trajectory | None,
    body: PrintBody | None = None,
) -> Findings:
    """Checks and metrics of the motion that programs ask for; none where it is the plan itself.

    body: as for `verify`. Raises InputError for a file of corrections that cannot be read.
    """
    spec = problem.as_run
    if spec is None and asked is None:
        return Findings()
    if spec is None or asked is None or len(asked) != len(trajectory):
        return Findings((Check("asked as learned", 1.0, 0.0, "motions that are not", False, EVERYWHERE),))
    body = body or print_body(toolpath, standing(cell))
    shift = learned_shifts(spec.corrections, trajectory)
    most = float(np.linalg.norm(shift, axis=1).max(initial=0.0))
    # the executed motion keeps the required distances; the asked one may come nearer by as much as it is displaced
    keep = problem.collision
    nearer = keep.model_copy(update={"nozzle": max(keep.nozzle - most, 0.0), "arm": max(keep.arm - most, 0.0)})
    eased = problem.model_copy(update={"collision": nearer, "as_run": None})
    with ThreadPoolExecutor() as pool:
        apart = pool.submit(sweep_cell, eased, cell, toolpath, asked, body)
        judged = Judged(eased, cell, toolpath, asked, executed_motion(cell, asked), body)
        # the rule for the tip is checked on the plan alone: the nozzle never reaches the asked position of the tip
        near = beyond(judged)
        off = np.linalg.norm(judged.motion.tip - trajectory.tip, axis=1)
        checks = [
            _as_learned(judged, trajectory, shift),
            check_most(asked, "asked off the plan", off * 1e3, spec.most * 1e3, "mm"),
            *_also(joint_limits(judged).checks),
            *_also(keep_apart(judged, (near, near), apart.result())[0].checks),
        ]
    return Findings(tuple(checks), {"asked_off_max_mm": float(off.max()) * 1e3})


def learned_shifts(path: Path, t: Trajectory) -> Array:
    """Displacement (n, 3) [m] of the tip by a file of corrections where material is laid; 0 elsewhere.

    Raises InputError for a file that cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig") as stream:
            head, *lines = (line for line in stream if line.strip() and not line.startswith("#"))
        names = [name.strip() for name in head.split(",")]
        columns = [names.index(name) for name in _FIELDS]
        table = np.zeros((0, len(_FIELDS)))
        if lines:
            table = np.loadtxt(lines, delimiter=",", usecols=columns, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError("is no file of corrections", file=path, hint="beadwise learn writes them") from error
    out, table = np.zeros((len(t), 3)), table[np.argsort(table[:, 0], kind="stable")]
    for bead, samples in enumerate(samples_of(t, int(t.bead.max(initial=-1)) + 1)):
        own = samples[t.deposit[samples]]
        rows = table[slice(*(np.searchsorted(table[:, 0], bead, side) for side in ("left", "right")))]
        if len(rows):
            k = np.clip(np.searchsorted(rows[:, 1], t.s[own] * 1e3), 1, max(len(rows) - 1, 1))
            a, b = rows[k - 1], rows[np.minimum(k, len(rows) - 1)]
            gap = np.where(b[:, 1] > a[:, 1], b[:, 1] - a[:, 1], 1.0)
            share = np.clip((t.s[own] * 1e3 - a[:, 1]) / gap, 0.0, 1.0)[:, None]
            out[own] = (a[:, 2:] + share * (b[:, 2:] - a[:, 2:])) * 1e-3
    return out


def _as_learned(judged: Judged, planned: Trajectory, shift: Array) -> Check:
    """On beads the asked tip is the plan's, displaced as the file says; orientation and all else are as planned. The
    tip and orientation that programs are written from are those of the asked joints."""
    asked = judged.trajectory
    other = [name for name in _SAME if not np.array_equal(getattr(asked, name), getattr(planned, name))]
    off = np.linalg.norm(judged.motion.tip - planned.tip - shift, axis=1)
    cosine = 0.5 * (np.einsum("nij,nij->n", judged.motion.rotation, rotations(planned.quat)) - 1.0)
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))
    said = np.linalg.norm(judged.motion.tip - asked.tip, axis=1)
    worst = np.maximum(np.where(planned.deposit, np.maximum(off, said), said) / WITHIN, turned / TURNED)
    found = check_most(asked, "asked as learned", worst, 1.0, "of what may differ")
    return replace(found, ok=False, where=f"other {', '.join(other)}") if other else found


def _also(checks: Iterable[Check]) -> Iterator[Check]:
    for check in checks:
        if check.name in ALSO:
            yield replace(check, name=ALSO[check.name])
