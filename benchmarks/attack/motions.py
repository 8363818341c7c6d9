"""Plans that are spoilt after their verification, and motions before it: each fails a check, or is shown to be harmless.

python -m benchmarks.attack --only motions plans

motions   rows of one column, or whole movements that agree with themselves: poses and speeds follow the spoilt joints
plans     the same, and limits, tool, path and process, in a plan that carries its seal
What fails no check is measured against the true motion with the few lines of `effect`.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack.cases import ESCAPED, FOUND, HARMLESS, REFUSED, Case, Kind, Outcome
from benchmarks.attack.prints import ON_POSITIONER, solved
from planner.base.arrays import Array, Flags, true_runs
from planner.base.errors import InputError
from planner.base.nearest import distance_to_polyline
from planner.export.fit import angle, continuous, from_matrix
from planner.plan import Plan, Trajectory
from planner.planning.files import as_it_is
from planner.verify.verdict import verify

# What is least changed of a column, of the order of what checks allow: rad, m, m/s, m^3/s, m^3, s.
LEAST = {
    "q": 1e-4, "tip": 1e-5, "axis": 1e-4, "quat": 1e-4, "speed": 3e-3, "flow": 1e-9, "s": 1e-4, "t": 1e-6, "extruded": 1e-9,
    "feed": 1e-4,
}  # fmt: skip
LABELS = ("bead", "layer", "deposit", "branch")
# By how much what fails no check may differ: m, rad, share of volume and of joint limits, m/s, s.
OFF, RECORDED, TURNED, SHARE, SPEED, TIME = 0.03e-3, 0.01e-3, np.radians(0.1), 0.01, 1.5e-3, 1e-4

Change = Callable[[Plan, random.Random], tuple[str, Plan]]  # what exactly, and the spoilt plan


# ---- changes ------------------------------------------------------------------------------------------------------------


def _with(plan: Plan, **values: Any) -> Plan:
    return replace(plan, trajectory=replace(plan.trajectory, **values))


def _rows(plan: Plan, by: random.Random) -> slice:
    n = by.choice([1, 3, 30, 300])
    first = by.randrange(len(plan.trajectory) - n)
    return slice(first, first + n)


def column(name: str, plan: Plan, by: random.Random, finest: float = 0.0) -> tuple[str, Plan]:
    """Rows of a column plus something, from 10^finest of what checks allow on."""
    values, rows = getattr(plan.trajectory, name).copy(), _rows(plan, by)
    step = LEAST[name] * 10.0 ** by.uniform(finest, 3.0) * by.choice([-1.0, 1.0])
    values[(rows, by.randrange(values.shape[1])) if values.ndim == 2 else rows] += step
    return f"{step:+.3g} in {rows.stop - rows.start} rows", _with(plan, **{name: values})


def label(name: str, plan: Plan, by: random.Random) -> tuple[str, Plan]:
    values, rows = getattr(plan.trajectory, name).copy(), _rows(plan, by)
    values[rows] = ~values[rows] if name == "deposit" else values[rows] + by.choice([-2, -1, 1, 2, 99])
    return f"{rows.stop - rows.start} rows", _with(plan, **{name: values})


def time_step(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    factor = by.choice([0.9, 1.01, 2.0])
    return f"x {factor}", _with(plan, dt=plan.trajectory.dt * factor)


def first_bead(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    first = by.choice([-1, 1, 7])
    return str(first), _with(plan, first_bead=first)


def no_number(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    name = by.choice([*LEAST])
    values, value = getattr(plan.trajectory, name).copy(), by.choice([np.nan, np.inf, -np.inf, 1e300])
    values[_rows(plan, by)] = value
    return f"{value} in {name}", _with(plan, **{name: values})


def limits(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    name, own = by.choice(["velocity", "acceleration", "jerk"]), plan.cell.limits
    wider = replace(own, **{name: getattr(own, name) * by.uniform(1.01, 3.0)})
    return name, replace(plan, cell=replace(plan.cell, limits=wider))


def tool(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    T = plan.cell.T_flange_nozzle.copy()
    T[by.randrange(3), 3] += by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-4.0, -1.0)
    return "", replace(plan, cell=replace(plan.cell, T_flange_nozzle=T))


def path(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    beads = list(plan.toolpath.beads)
    k, step = by.randrange(len(beads)), 10.0 ** by.uniform(-4.0, -1.0)
    beads[k] = replace(beads[k], points=beads[k].points + step)
    return f"bead {k} {step:.3g} m", replace(plan, toolpath=replace(plan.toolpath, beads=tuple(beads)))


def beads_lost(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    beads = list(plan.toolpath.beads)
    del beads[by.randrange(len(beads))]
    return "", replace(plan, toolpath=replace(plan.toolpath, beads=tuple(beads)))


def process(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    own = plan.problem.process
    faster = own.model_copy(update={"travel_speed": own.travel_speed * by.uniform(1.01, 3.0)})
    return "travel speed", replace(plan, problem=plan.problem.model_copy(update={"process": faster}))


# Movements that agree with themselves: what a wrong planner might have made, with poses and speeds that follow the joints.


def again(plan: Plan, q: Array, **more: Any) -> Plan:
    """The plan with other joints, and with what follows from them."""
    t, T = plan.trajectory, plan.cell.T_part_nozzle(np.ascontiguousarray(q))
    tip = np.ascontiguousarray(T[:, :3, 3])
    speed = np.linalg.norm(np.gradient(tip, t.dt, axis=0), axis=1)
    poses = {"tip": tip, "quat": continuous(from_matrix(T[:, :3, :3])), "axis": np.ascontiguousarray(T[:, :3, 2])}
    branch = plan.cell.inverse.branches(np.ascontiguousarray(q[:, plan.cell.own])).astype(t.branch.dtype)
    return _with(plan, **({"q": q, "speed": speed, "branch": branch, **poses} | more))


def bump(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A joint that swings out and comes back."""
    q, n = plan.trajectory.q.copy(), by.choice([20, 60, 200])
    first, k, size = by.randrange(len(q) - n), by.randrange(q.shape[1]), 10.0 ** by.uniform(-5.0, -0.5)
    q[first : first + n, k] += size * np.sin(np.linspace(0.0, np.pi, n)) ** 4
    return f"joint {k + 1} {size:.3g} rad over {n} rows", again(plan, q)


def offset(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A joint that is off all the time, as a wrong zero makes it."""
    q, k, size = plan.trajectory.q.copy(), by.randrange(plan.trajectory.q.shape[1]), 10.0 ** by.uniform(-6.0, -1.0)
    q[:, k] += size
    return f"joint {k + 1} {size:.3g} rad", again(plan, q)


def noise(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Joints that tremble."""
    size = 10.0 ** by.uniform(-8.0, -3.0)
    return f"{size:.3g} rad", again(
        plan, plan.trajectory.q + size * _numbers(by).standard_normal(plan.trajectory.q.shape)
    )


def whole_turn(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A joint a whole turn further, from somewhere on."""
    q, k = plan.trajectory.q.copy(), by.randrange(plan.trajectory.q.shape[1])
    q[by.randrange(len(q)) :, k] += by.choice([-1.0, 1.0]) * 2.0 * np.pi
    return f"joint {k + 1}", again(plan, q)


def straight(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Travel straight in joints from bead to bead, whatever is in the way."""
    t, q = plan.trajectory, plan.trajectory.q.copy()
    first, last = by.choice(_spans(~t.deposit))
    u = np.linspace(0.0, 1.0, last - first)[:, None]
    q[first:last] = q[first] + (3.0 * u**2 - 2.0 * u**3) * (q[last - 1] - q[first])
    return f"rows {first} to {last}", again(plan, q)


def held(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """The robot stands still for some rows, and is where it should be after them."""
    q, n = plan.trajectory.q.copy(), by.choice([2, 5, 20])
    first = by.randrange(len(q) - n)
    q[first : first + n] = q[first]
    return f"{n} rows", again(plan, q)


def backwards(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A bead from its end to its beginning."""
    t, q = plan.trajectory, plan.trajectory.q.copy()
    first, last = by.choice(_spans(t.deposit))
    q[first:last] = q[first:last][::-1]
    return f"rows {first} to {last}", again(plan, q)


def left_out(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Some rows are not there, in any column."""
    t, n = plan.trajectory, by.choice([1, 5, 50, 400])
    first = by.randrange(len(t) - n)
    return f"{n} rows", _chosen(plan, np.delete(np.arange(len(t)), slice(first, first + n)))


def twice(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Some rows are there twice."""
    t, n = plan.trajectory, by.choice([1, 5, 50])
    first = by.randrange(len(t) - n)
    rows = np.arange(len(t))
    return f"{n} rows", _chosen(plan, np.concatenate([rows[: first + n], rows[first:]]))


def faster(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """All of it in another time."""
    t, factor = plan.trajectory, by.choice([0.5, 0.9, 0.98, 1.02, 1.1, 2.0])
    changed = {"dt": t.dt * factor, "t": t.t * factor, "speed": t.speed / factor, "flow": t.flow / factor}
    return f"x {factor}", _with(plan, **changed)


def more_material(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A bead, or all, with more or less material, in every column that tells of it."""
    t, factor = plan.trajectory, 1.0 + by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-6.0, 0.0)
    bead = by.choice([None, *range(len(plan.toolpath.beads))])
    own = t.deposit if bead is None else t.bead == bead
    step = np.diff(t.extruded, prepend=0.0) * np.where(own, factor, 1.0)
    extruded = np.cumsum(step)
    per_volume = t.feed[-1] / t.extruded[-1]
    changed = {
        "flow": t.flow * np.where(own, factor, 1.0),
        "extruded": extruded,
        "feed": t.feed + per_volume * (extruded - t.extruded),
    }
    return f"x {factor:.4g} in {'all' if bead is None else f'bead {bead}'}", _with(plan, **changed)


def late_material(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Material some rows later or earlier than it should."""
    t, n = plan.trajectory, by.choice([-20, -3, -1, 1, 3, 20])
    changed = {name: np.roll(getattr(t, name), n) for name in ("flow", "deposit", "extruded", "feed")}
    changed["extruded"], changed["feed"] = np.maximum.accumulate(t.extruded), changed["feed"]
    return f"{n} rows", _with(plan, **changed)


def other_bead(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """Two beads in each other's place."""
    t, values = plan.trajectory, plan.trajectory.bead.copy()
    a, b = by.sample(range(len(plan.toolpath.beads)), 2)
    values[t.bead == a], values[t.bead == b] = b, a
    return f"{a} and {b}", _with(plan, bead=values)


def not_laid(plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A bead, or its end, that is travelled and not laid."""
    t = plan.trajectory
    first, last = by.choice(_spans(t.deposit))
    first = by.choice([first, last - by.choice([1, 2, 10])])
    own = np.zeros(len(t), dtype=bool)
    own[first:last] = True
    step = np.where(own, 0.0, np.diff(t.extruded, prepend=0.0))
    values = {
        "deposit": t.deposit & ~own, "bead": np.where(own, -1, t.bead).astype(t.bead.dtype), "flow": np.where(own, 0.0, t.flow),
        "s": np.where(own, 0.0, t.s), "extruded": np.cumsum(step),
        "feed": np.cumsum(np.where(own, 0.0, np.diff(t.feed, prepend=0.0))),
    }  # fmt: skip
    return f"{last - first} rows", _with(plan, **values)


def _numbers(by: random.Random) -> np.random.Generator:
    return np.random.default_rng(by.getrandbits(64))


def _spans(flags: Flags) -> list[tuple[int, int]]:
    return [(a, b) for a, b in true_runs(flags).tolist() if b - a > 12]


def _chosen(plan: Plan, rows: Any) -> Plan:
    t = plan.trajectory
    columns = {f.name: getattr(t, f.name)[rows] for f in fields(t) if isinstance(getattr(t, f.name), np.ndarray)}
    return _with(plan, **(columns | {"t": np.arange(len(rows)) * t.dt}))


COLUMNS: dict[str, Change] = {name: partial(column, name) for name in LEAST}
FINE: dict[str, Change] = {f"{name}, finely": partial(column, name, finest=-3.0) for name in LEAST}
OTHERS: dict[str, Change] = {
    **{name: partial(label, name) for name in LABELS}, "time step": time_step, "first bead": first_bead, "no number": no_number,
}  # fmt: skip
INPUTS: dict[str, Change] = {"limits": limits, "tool": tool, "path": path, "beads lost": beads_lost, "process": process}
MOVEMENTS: dict[str, Change] = {
    "bump": bump, "offset": offset, "noise": noise, "whole turn": whole_turn, "straight": straight, "held": held,
    "backwards": backwards, "left out": left_out, "twice": twice, "faster": faster, "more material": more_material,
    "late material": late_material, "other bead": other_bead, "not laid": not_laid,
}  # fmt: skip
OF_PLANS = COLUMNS | OTHERS | INPUTS
OF_MOTIONS = COLUMNS | FINE | OTHERS | MOVEMENTS | {f"{name} again": change for name, change in MOVEMENTS.items()}


# ---- what becomes of them -----------------------------------------------------------------------------------------------


def spoilt(changes: dict[str, Change], plan: Plan, by: random.Random) -> tuple[str, Plan]:
    """A plan with a change at random, and what it is."""
    name = by.choice([*changes])
    detail, changed = changes[name](plan, by)
    return f"{name}: {detail}", changed


def attack_plan(plan: Plan, by: random.Random) -> Outcome:
    """Whether a spoilt plan would be written with its programs."""
    what, changed = spoilt(OF_PLANS, plan, by)
    try:
        judged = as_it_is(changed)
    except InputError as error:
        return Outcome(what, REFUSED, str(error))
    told = ", ".join(check.name for check in judged.checks if not check.ok)
    return Outcome(what, ESCAPED if judged.verified else FOUND, told)


def attack_motion(plan: Plan, by: random.Random) -> Outcome:
    """Whether a spoilt motion is verified, and does what it should not."""
    what, changed = spoilt(OF_MOTIONS, plan, by)
    try:
        report = verify(plan.problem, plan.cell, plan.toolpath, changed.trajectory)
    except InputError as error:
        return Outcome(what, REFUSED, str(error))
    if told := ", ".join(check.name for check in report.checks if not check.ok):
        return Outcome(what, FOUND, told)
    told = ", ".join(effect(plan, changed.trajectory))
    return Outcome(what, ESCAPED if told else HARMLESS, told)


@dataclass(frozen=True)
class _Bead:
    """Tips (k, 3) [m] at which a bead is laid, and its volume [m^3]."""

    tip: Array
    volume: float


def _beads(plan: Plan, t: Trajectory, tip: Array) -> list[_Bead]:
    laid = np.diff(t.extruded, prepend=0.0)
    return [_Bead(tip[t.bead == k], float(laid[t.bead == k].sum())) for k in range(len(plan.toolpath.beads))]


def effect(plan: Plan, t: Trajectory) -> list[str]:
    """What a motion that fails no check does otherwise than the true one, beyond tolerance, in words."""
    true, T = plan.trajectory, plan.cell.T_part_nozzle(np.ascontiguousarray(t.q))
    tip, told = T[:, :3, 3], []
    axis_off = float(np.arccos(np.clip(np.einsum("ij,ij->i", T[:, :3, 2], t.axis), -1.0, 1.0)).max())
    quat_off = float(angle(from_matrix(T[:, :3, :3]), t.quat).max())
    recorded = float(np.linalg.norm(tip - t.tip, axis=1).max())
    if recorded > RECORDED or max(axis_off, quat_off) > TURNED:
        told.append(f"recorded poses {1e3 * recorded:.3g} mm, {np.degrees(max(axis_off, quat_off)):.3g} deg off")
    for k, (a, b) in enumerate(zip(_beads(plan, true, true.tip), _beads(plan, t, tip), strict=True)):
        if len(b.tip) < 2:
            told.append(f"bead {k} is not laid")
            continue
        off = max(float(distance_to_polyline(x.tip, y.tip).max()) for x, y in ((a, b), (b, a)))
        # its ends are where samples fall
        if off > OFF + plan.problem.process.speed * true.dt:
            told.append(f"bead {k} is {1e3 * off:.3g} mm off")
        if abs(b.volume / a.volume - 1.0) > SHARE:
            told.append(f"bead {k} has {b.volume / a.volume:.3f} of its volume")
    rate = np.abs(np.diff(t.q, axis=0)).max(axis=0) / t.dt / plan.cell.limits.velocity
    if rate.max() > 1.0 + SHARE:
        told.append(f"joints at {rate.max():.3g} of their speed")
    speed = np.abs(np.linalg.norm(np.gradient(tip, t.dt, axis=0), axis=1) - t.speed).max()
    if speed > SPEED + 0.05 * true.speed.max():  # of another difference quotient where speed changes quickly
        told.append(f"speed {1e3 * speed:.3g} mm/s off")
    if np.abs(t.t - np.arange(len(t)) * t.dt).max() > TIME:
        told.append("times are not those of the samples")
    return told


def _prepared(attack: Callable[[Plan, random.Random], Outcome], folder: Path) -> Case:
    return partial(attack, solved(folder, **ON_POSITIONER))


KINDS = {
    "motions": Kind("motions before their verification", 1000, partial(_prepared, attack_motion)),
    "plans": Kind("plans after it", 500, partial(_prepared, attack_plan)),
}
