"""Small synthetic plans for the exporters: real cells, real inverse kinematics, a timing that is simple to write down."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.export import fanuc, inform, kawasaki, krl, melfa, urscript, val3
from planner.export.arcs import segments
from planner.export.axes.gcode import axes_gcode, file_name
from planner.export.extruder import gcode
from planner.export.fit import from_matrix, lerp, slerp
from planner.export.joint_trajectory import joint_trajectory, switches
from planner.export.plan_json import plan_json
from planner.export.program import RobotProgram, pieces_of
from planner.export.rapid.writer import pgf, rapid, rapid_files
from planner.export.tables import write_table
from planner.motion.extrusion import feed_of_materials
from planner.plan import Check, Event, Plan, Trajectory
from planner.problem.cell import CellSpec
from planner.problem.process import ProcessSpec
from planner.problem.settings import BoardSpec, MachineSpec, ProgramSpec

DT = 0.004
SPEED = 0.04
CENTRE, RADIUS = np.array([0.0314, 0.037]), 0.034
RUN_IN = 0.003
BEAD_AREA = 0.6e-3 * 0.5e-3
FILAMENT = 1.75e-3
CHANGE = {"wait_s": 2, "purge_mm": 5}
MATERIALS = {
    "pla": {"tool": 1, "nozzle_c": 195},
    "pva": {"tool": 0, "nozzle_c": 190, "extruder_signal": "doSupport", "filament_diameter_mm": 2.85},
}
HOMES = {
    "irb140": (30, 20, 30, 90, -80, 60),
    "ur5e": (150, -110, 110, 0, 70, 20),
    "kr6_r900": (30, 20, 30, 90, -80, 60),
}
KUKA = Path(__file__).parent / "kuka" / "kr6_r900.yaml"  # a file of one's own, as the planner ships no KR
NUMBERED = tuple(f"joint_{k}" for k in range(1, 7))
JOINTS = {
    "ur5e": tuple(
        f"{name}_joint" for name in ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    )
}
# an arm that holds the part where the positioner does, its last joint in place of the table's
SECOND_ARM = {
    "robot": "irb1200_09",
    "base_mm": (1459.65, 9.87, -210.32),
    "turn_deg": 180,
    "free": ("joint_6",),
    "held_deg": {"joint_2": 60, "joint_3": -40, "joint_5": -110},
    "part_rpy_deg": (0, 0, 180),
}
TABLE_TURN = 0.6  # of the bead's turning done by the table; the arm does the rest


def problem(
    positioner: bool = True,
    free: tuple[str, ...] = ("rotation",),
    materials: dict[str, Any] | None = None,
    process: dict[str, Any] | None = None,
    arm: str = "irb140",
    **program: Any,
) -> Any:
    """What the exporters read of a problem, and what a cell is built from."""
    bead = {"width_mm": 0.6, "height_mm": 0.5}
    station = {"robot": "irbp_a250", "origin_mm": (633.5, 9.87, 380), "free": free}
    holder = {"positioner": station} if positioner else {"bed_mm": (450, -50, 380)}
    limits = _limits((*JOINTS.get(arm, NUMBERED), *(free if positioner else ())))
    if free == SECOND_ARM["free"]:
        holder = {"positioner": SECOND_ARM}
        limits = _limits((*NUMBERED, "positioner_joint_6"))
    nozzle = {"tip_mm": (-44.51, 9.9, 113.95), "diameter_mm": 0.6}
    return SimpleNamespace(
        name="two_beads",
        file=Path("two_beads.yaml"),
        sources=SimpleNamespace(sha256=""),
        from_arrays=False,
        as_run=None,
        cell=CellSpec(arm=arm, nozzle=nozzle, home_deg=HOMES[arm], limits=limits, **holder).model_copy(
            update={"arm": KUKA} if arm == "kr6_r900" else {}
        ),
        process=ProcessSpec(
            **{"bead": bead, "materials": materials or {}, "change": CHANGE} | (process or {}),
            speed_mm_s=40,
            travel_speed_mm_s=200,
        ),
        program=ProgramSpec(**program),
    )


def _limits(axes: tuple[str, ...]) -> dict[str, Any]:
    """Accelerations that suffice for the sudden dip within the beads."""
    return {name: {"acceleration_rad_s2": 100} for name in axes}


def _ramp(n: int) -> Array:
    """Smooth way from 0 to 1 at n + 1 instants, at rest at both ends in speed and acceleration."""
    u = np.linspace(0.0, 1.0, n + 1)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def _way(length: float, dip: bool) -> tuple[Array, Array]:
    """Arc length from the run-in's start, and speed, at every instant of a bead with run-in and run-out."""
    s = np.linspace(0.0, length + 2 * RUN_IN, 20001)
    ends = np.minimum(s, s[-1] - s)
    # run-in and run-out: speed grows with the root of the way, as at constant acceleration
    v = SPEED * np.sqrt(np.clip(ends / (0.9 * RUN_IN), 1e-6, 1.0))
    if dip:
        v = v * (1.0 - 0.7 * np.exp(-(((s - 0.5 * s[-1]) / 0.6e-3) ** 2)))
    t = np.concatenate([[0.0], np.cumsum(np.diff(s) * 2.0 / (v[1:] + v[:-1]))])
    instants = np.arange(0.0, t[-1], DT)
    return np.append(np.interp(instants, t, s), s[-1]), np.append(np.interp(instants, t, v), 0.0)


def _bead_pose(distance: Array, length: float, z: float, turn: float) -> tuple[Array, Array]:
    """Tip and normal (k, 3) at the distance from a bead's start: round the cylinder, with a wave in height."""
    phi = np.pi + turn + (distance - 0.5 * length) / RADIUS
    normal = np.column_stack([np.cos(phi), np.sin(phi), 0.0 * phi])
    tip = np.column_stack([CENTRE + RADIUS * normal[:, :2], z + 0.002 * np.sin(distance / 0.004)])
    return tip, normal


def _postures(cell: Cell, tip: Array, normal: Array, previous: Array | None) -> Array:
    """Joints (k, n) that hold the nozzle against the normal, continuous from `previous`."""
    nf = len(cell.holder)
    azimuth = np.unwrap(np.arctan2(normal[:, 1], normal[:, 0]))
    table = -TABLE_TURN * (azimuth - np.pi)[:, None] if nf else np.empty((len(tip), 0))
    if nf == 2:  # before the turning, tilting: to and fro
        table = np.column_stack([0.1 * np.sin(4.0 * azimuth), table])
    T_part_nozzle = np.tile(np.eye(4), (len(tip), 1, 1))
    z = -normal
    x = np.cross(np.array([0.0, 0.0, 1.0]), z)
    T_part_nozzle[:, :3, 0], T_part_nozzle[:, :3, 1], T_part_nozzle[:, :3, 2] = x, np.cross(z, x), z
    T_part_nozzle[:, :3, 3] = tip
    T_base_flange = (
        np.linalg.inv(cell.T_world_base)
        @ cell.holder.poses(table)
        @ T_part_nozzle
        @ np.linalg.inv(cell.T_flange_nozzle)
    )
    solutions, ok = cell.inverse.solve(T_base_flange)
    q = np.empty((len(tip), 6))
    last = cell.home[:6] if previous is None else previous[:6]
    for k in range(len(tip)):
        near = solutions[k] + 2 * np.pi * np.round((last - solutions[k]) / (2 * np.pi))
        cost = np.where(ok[k], np.abs(near - last).max(axis=1), np.inf)
        assert np.isfinite(cost.min()), "the fixture's bead is out of reach"
        q[k] = last = near[np.argmin(cost)]
    return np.column_stack([q, table])


@cache
def make_plan(
    positioner: bool = True,
    beads: int = 2,
    length: float = 0.020,
    dip: bool = True,
    free: tuple[str, ...] = ("rotation",),
    materials: tuple[str, ...] = (),
    detour: bool = True,
    arm: str = "irb140",
) -> Plan:
    """A plan of `beads` beads: home, at rest before each run-in, run-out to rest, back home.

    With materials, each bead is of the next one; the robot rests at home for every change.
    """
    spec = problem(positioner, free, MATERIALS if materials else None, arm=arm)
    cell = build_cell(spec)
    parts: list[tuple[Array, Array, int]] = []  # joints, arc length along the bead or NaN, bead
    at = cell.home
    events: list[Event] = []
    if materials:
        events = [Event(kind, -1, 0.0, 0.0, 0.0, materials[0]) for kind in ("heat", "select")]
    for k in range(beads):
        way, _ = _way(length, dip)
        tip, normal = _bead_pose(way - RUN_IN, length, 0.03 + 0.0005 * (k // 2 % 20), 0.3 * (k % 2))
        q = _postures(cell, tip, normal, at)
        if not parts:
            parts.append((at[None], np.full(1, np.nan), -1))
        if materials and k:
            rest, material = round(spec.process.change.time / DT), materials[k % len(materials)]
            parts += [_travel(at, cell.home, detour), (np.tile(cell.home, (rest, 1)), np.full(rest, np.nan), -1)]
            start = (sum(len(part[0]) for part in parts) - 1 - rest) * DT
            change = spec.process.change
            events.append(Event("change", k, start, change.wait, 0.0, material))
            events.append(Event("purge", k, start + change.wait, change.time - change.wait, change.purge, material))
            at = cell.home
        parts.append(_travel(at, q[0], detour))
        parts.append((q[1:], way[1:] - RUN_IN, k))
        at = q[-1]
    parts.append(_travel(at, cell.home, detour))

    # rounded, so that another processor's last digits do not show in the golden files
    q = np.round(np.concatenate([part[0] for part in parts]), 9)
    s = np.concatenate([part[1] for part in parts])
    label = np.concatenate([np.full(len(part[0]), part[2]) for part in parts])
    deposit = (s >= 0.0) & (s <= length)
    T = cell.T_part_nozzle(q)
    tip = np.ascontiguousarray(T[:, :3, 3])
    speed = np.linalg.norm(np.gradient(tip, DT, axis=0), axis=1)
    flow = np.where(deposit, speed * BEAD_AREA, 0.0)
    laid = np.clip(np.nan_to_num(s), 0.0, length)
    extruded = np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(laid), 0.0))]) * BEAD_AREA
    bead = np.where(deposit, label, -1).astype(np.int32)
    t = np.arange(len(q)) * DT
    own = [materials[k % len(materials)] if materials else "" for k in range(beads)]
    begun = np.maximum.accumulate(np.maximum(label, 0)).astype(np.int32)
    fed = extruded / (np.pi * FILAMENT**2 / 4.0)
    if materials:
        fed = feed_of_materials(spec.process, own, begun, t, bead, extruded, flow, events)
    trajectory = Trajectory(
        dt=DT,
        t=t,
        bead=bead,
        layer=np.maximum(0, label // 2).astype(np.int32),
        deposit=deposit,
        s=np.where(deposit, s, 0.0),
        q=q,
        tip=tip,
        quat=from_matrix(T[:, :3, :3]),
        axis=np.ascontiguousarray(T[:, :3, 2]),
        branch=cell.inverse.branches(q[:, :6]),
        speed=speed,
        flow=flow,
        extruded=extruded,
        feed=fed,
        events=tuple(events),
    )
    deposited = 1e3 * beads * length
    return Plan(
        problem=spec,
        cell=cell,
        toolpath=SimpleNamespace(  # type: ignore[arg-type]
            beads=tuple(
                SimpleNamespace(
                    material=material,
                    length=length,
                    points=np.zeros((round(length * 1e3), 3)),
                    commanded=lambda usual: usual,
                )
                for material in own
            ),
            layers=(beads + 1) // 2,
            notes=(),
            splits=(),
        ),
        strategy="ladder",
        trajectory=trajectory,
        checks=(Check("position_error", 0.0021, 0.05, "mm", True, "bead 0"), Check("reach", 0.0, 0.0, "mm", True, "")),
        metrics={
            "deposited_length_mm": deposited,
            "print_time_s": float(trajectory.t[-1]),
            "extruded_mm": deposited * BEAD_AREA / (np.pi * FILAMENT**2 / 4.0),
            "sigma_min": float("nan"),
        },
        series={},
        timing_s={"load": 0.5, "total": 1.25},
        versions={"planner": "1.0", "numpy": "2.4"},
        baseline={"fixed": {"at_speed_fraction": float("inf")}},
        settings={"roll_step_deg": np.float64(5.0), "svg": Path("logo.svg"), "count": np.int64(3)},
    )


def _travel(start: Array, end: Array, detour: bool) -> tuple[Array, Array, int]:
    """Joints from rest to rest, without the first instant, with a detour that no straight joint motion makes."""
    n = 150
    u = _ramp(n)[1:, None]
    aside = np.zeros(len(start))
    aside[1] = -0.12 if detour else 0.0
    q = start + u * (end - start) + 16.0 * (u * (1.0 - u)) ** 2 * aside
    return q, np.full(n, np.nan), -1


HEAT, CUT = 4.0, 3.0  # s of rest at home, and on the bead


@cache
def socket_plan() -> Plan:
    """One short bead of fibre in style `socket`: waits until all is hot, and rests on the bead while the fibre is cut."""
    plan = make_plan(positioner=False, beads=1, length=0.012, dip=False, detour=False)
    start = {"nozzle_c": 200, "bed_c": 60, "heat_wait_s": HEAT, "heat": "wait"}
    fibre = {"cut_length_mm": 2, "least_laid_mm": 2, "cut_wait_s": CUT}
    spec = problem(False, process={"start": start, "fibre": fibre, "bead": {"width_mm": 0.6}}, style="socket")
    spec.name = "one_bead"
    t = plan.trajectory
    cut = int(np.flatnonzero(t.s > 0.008)[0])
    rows = np.concatenate(
        [np.zeros(round(HEAT / DT)), np.arange(cut), np.full(round(CUT / DT), cut), np.arange(cut, len(t))]
    )
    held = {k: v[rows.astype(int)] for k, v in vars(t).items() if isinstance(v, np.ndarray)}
    held["t"] = np.arange(len(rows)) * DT
    held["feed"] = np.minimum(held["feed"], t.feed[cut])
    held["speed"] = np.append(np.linalg.norm(np.diff(held["tip"], axis=0), axis=1) / DT, 0.0)
    events = (Event("heat", -1, 0.0, HEAT, 0.0), Event("cut", 0, HEAT + cut * DT, CUT, 0.0))
    return replace(plan, problem=spec, trajectory=replace(t, **held, events=events))


@cache
def two_arms_plan(**program: Any) -> Plan:
    """One bead on a part that a second arm turns while it is laid."""
    plan = make_plan(beads=1, length=0.012, dip=False, free=SECOND_ARM["free"])
    spec = problem(free=SECOND_ARM["free"], **program)
    spec.name = "two_arms"
    return replace(plan, problem=spec)


def demand_plan(**program: Any) -> Plan:
    """One short bead with a dip on a fixed bed, in style `demand`."""
    plan = make_plan(positioner=False, beads=1, length=0.012, detour=False)
    spec = problem(False, style="demand", **program)
    spec.name = "asked_bead"
    return replace(plan, problem=spec)


def with_board(plan: Plan, **board: Any) -> Plan:
    """The plan for an extruder's board with these keys."""
    program = plan.problem.program.model_copy(update={"board": BoardSpec(**board)})
    if isinstance(plan.problem, SimpleNamespace):
        return replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]
    return replace(plan, problem=plan.problem.model_copy(update={"program": program}))


def in_modules(plan: Plan, moves: int) -> Plan:
    """The plan with a program in modules of so many moves, fewer than a problem may ask for."""
    return written_with(plan, module_moves=moves)


GOLDEN = Path(__file__).parent / "golden"


def sliced(plan: Plan, rows: slice) -> Plan:
    """The same plan with only some of its samples: for tables, where any samples do."""
    values = vars(plan.trajectory).items()
    return replace(
        plan, trajectory=replace(plan.trajectory, **{k: v[rows] for k, v in values if isinstance(v, np.ndarray)})
    )


def golden_texts() -> dict[str, str]:
    """File name in tests/golden → what the exporters write today."""
    plan, mixed = make_plan(), make_plan(materials=("pla", "pva"))
    table = io.StringIO()
    write_table(sliced(plan, slice(180, 220)), table)
    short = make_plan(beads=1, length=0.002, positioner=False)
    return {
        **krl.write(make_plan(beads=1, length=0.010, arm="kr6_r900")),
        **urscript.write(make_plan(beads=1, length=0.010, positioner=False, arm="ur5e")),
        "two_beads_joint_trajectory.json": joint_trajectory(short),
        "two_beads_extruder.json": switches(plan),
        "TwoBeads.mod": rapid(plan),
        "TwoBeads.pgf": pgf("TwoBeads"),
        "TwoMaterials.mod": rapid(mixed),
        "two_materials.gcode": gcode(mixed),
        "extrusion.gcode": gcode(plan),
        **{k: text for k, text in rapid_files(socket_plan()).items() if not k.endswith(".pgf")},
        "AskedBead.mod": rapid(demand_plan()),
        **{k: text for k, text in rapid_files(two_arms_plan(style="socket")).items() if not k.endswith("lines.csv")},
        "plan.json": plan_json(plan),
        "trajectory.csv": table.getvalue(),
    }


def arm_texts() -> dict[str, str]:
    """File name in tests/golden → what controllers are told that move an arm alone."""
    plan = make_plan(beads=1, length=0.010, positioner=False, arm="kr6_r900")
    return {
        name: text for language in (fanuc, inform, val3, kawasaki, melfa) for name, text in language.write(plan).items()
    }


def axes_texts() -> dict[str, str]:
    """File name in tests/golden → what multi-axis machines are told today."""
    plan = make_plan(beads=1, length=0.008, dip=False)
    tilt = {"letter": "A", "direction": (1, 0, 0), "centre_mm": (0, 0, 20), "range_deg": (-120, 120)}
    turn = {"letter": "C", "direction": (0, 0, 1), "range_deg": (-360, 360)}
    trunnion = MachineSpec(flavour="reprap", type="table_table", rotary=(tilt, turn), part_mm=(-30, -30, 50))
    heads = ({"letter": "C", "direction": (0, 0, 1)}, {"letter": "B", "direction": (0, 1, 0), "centre_mm": (0, 0, 150)})
    fork = MachineSpec(flavour="linuxcnc", type="head_head", rotary=heads, tcp=True)
    found = {}
    for machine in (trunnion, fork):
        program = plan.problem.program.model_copy(update={"machine": machine})
        its = replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]
        found[file_name(its)] = axes_gcode(its)
    return found


def written_with(plan: Plan, **program: Any) -> Plan:
    """The plan with other settings of the program, which the motion does not know."""
    spec = SimpleNamespace(**vars(plan.problem))
    spec.program = spec.program.model_copy(update=program)
    return replace(plan, problem=spec)  # type: ignore[arg-type]


def executed_beads(program: RobotProgram, step: float = 0.5e-3) -> list[tuple[Array, ...]]:
    """Position (k, 3) [m], orientation (k, 4) and external axes (k, 6), at most `step` [m] apart, of each stretch with the extruder on."""
    out = []
    for piece in (piece for on, piece in pieces_of(program) if on):
        ways = segments(piece.position[:-1], piece.via, piece.position[1:], piece.circular)
        parts = np.maximum(1, np.ceil(ways.length / step)).astype(np.intp)
        a = np.append(np.repeat(np.arange(len(parts)), parts), len(parts) - 1)
        u = np.append((np.arange(len(a) - 1) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[a[:-1]], 1.0)
        quat = slerp(piece.quat[a], piece.quat[a + 1], u)
        out.append((ways.take(a).at(u), quat, lerp(piece.external, a, a + 1, u)))
    return out


if __name__ == "__main__":  # after a change that is meant: write the golden files anew, and read the difference
    for name, text in (golden_texts() | arm_texts() | axes_texts()).items():
        (GOLDEN / name).write_text(text, encoding="utf-8", newline="\n")


def resting_in_a_bead(plan: Plan) -> Plan:
    """The plan with half a second of rest in its first bead, for a cut: nothing is fed behind it."""
    t = plan.trajectory
    k = int(np.flatnonzero(t.deposit)[40])
    rows = np.concatenate([np.arange(k), np.full(126, k), np.arange(k, len(t))])
    held = {name: value[rows] for name, value in vars(t).items() if isinstance(value, np.ndarray)}
    drawn = np.clip(held["feed"], t.feed[k], t.feed[np.flatnonzero(t.bead == 0)[-1] + 1]) - t.feed[k]
    held["feed"] = held["feed"] - drawn
    cut = (Event("cut", 0, k * t.dt, 0.5, 0.0),)
    return replace(plan, trajectory=replace(t, **held | {"t": np.arange(len(rows)) * t.dt, "events": cut}))
