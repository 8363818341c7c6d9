"""Synthetic plans for the tests of the report: stars wound round a cylinder, with dips at their corners."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from planner.plan import Check, Dip, Plan, Remedy, Trajectory
from planner.toolpath.bead import cylinder_shape

RADIUS, HEIGHT, CENTRE = 0.034, 0.100, np.array([0.0314, 0.037])
COMMANDED = 0.040
DT = 0.004
SHAPE = cylinder_shape(RADIUS, HEIGHT, CENTRE)


def make_problem(name: str = "cylinder_stars") -> SimpleNamespace:
    """The fields of a Problem that the report reads (SI units)."""
    return SimpleNamespace(
        name=name,
        file=Path("problems/cylinder_stars.yaml"),
        from_arrays=False,
        cell=SimpleNamespace(positioner=SimpleNamespace(base=None)),
        process=SimpleNamespace(
            interlayer_time=None,
            speed=COMMANDED,
            travel_speed=0.2,
            filament_diameter=1.75e-3,
            section="rectangle",
            extruder=SimpleNamespace(motor="e_axis", lag=0.0),
            materials={},
        ),
    )


def make_plan(
    samples: int = 12_000, *, layers: int = 10, ok: bool = True, name: str = "cylinder_stars", joint: str = "joint_1"
):
    """A plan of about `samples` samples. `ok=False` makes one check fail; names go wherever names are shown."""
    per_layer = samples // layers
    parts = [_layer(k, per_layer) for k in range(layers)]
    bead = np.concatenate([np.where(p["bead"] < 0, -1, p["bead"] + 4 * k) for k, p in enumerate(parts)]).astype(
        np.int32
    )
    cat = {key: np.concatenate([p[key] for p in parts]) for key in ("tip", "axis", "speed", "layer", "s")}
    n = len(bead)
    deposit = bead >= 0
    t = np.arange(n) * DT
    phase = 2 * np.pi * np.arange(n) / per_layer
    names = (joint, "joint_2", "joint_3", "joint_4", "joint_5", "joint_6", "rotation")
    q = np.column_stack([(0.2 + 0.1 * j) * np.sin((1 + j % 3) * phase + j) for j in range(7)])
    q[:, 6] *= 6
    limits = SimpleNamespace(
        q_min=np.radians([-180, -90, -230, -200, -115, -400, -np.inf]),
        q_max=np.radians([180, 110, 50, 200, 115, 400, np.inf]),
        sliding=(),
        turns=np.ones(7, dtype=bool),
        velocity=np.full(7, 3.0),
        acceleration=np.full(7, 20.0),
        jerk=np.full(7, 400.0),
    )
    flow = np.where(deposit, cat["speed"] * 0.3e-6, 0.0)
    ratio = np.abs(np.cos(phase * 3))
    quat = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    trajectory = Trajectory(
        dt=DT, t=t, bead=bead, layer=cat["layer"].astype(np.int32), deposit=deposit, s=cat["s"], q=q, tip=cat["tip"],
        axis=cat["axis"], speed=cat["speed"], flow=flow, extruded=np.cumsum(flow) * DT, feed=np.cumsum(flow) * DT / (np.pi / 4 * 1.75e-3**2),
        quat=quat, branch=np.zeros(n, dtype=np.int8),
    )  # fmt: skip
    series = {
        "sigma": 0.21 + 0.08 * np.cos(phase / 3),
        "wrist_deg": 38 + 17 * np.cos(phase / 3 + 0.4),
        "limit_margin_deg": 25 + 9 * np.sin(phase),
        "velocity_ratio": 0.43 * ratio,
        "acceleration_ratio": 0.96 * ratio,
        "jerk_ratio": (0.99 if ok else 1.31) * ratio**3,
    }
    checks = (
        Check(name="position", worst=0.00031, limit=0.01, unit="mm", ok=True, where="t 12.404 s, bead 3"),
        Check(name="nozzle_axis", worst=0.00012, limit=0.05, unit="deg", ok=True, where="t 31.08 s, bead 9"),
        Check(name="joint_ranges", worst=16.0, limit=2.0, unit="deg", ok=True, where="joint_5 at t 3.2 s"),
        Check(name="joint_speed", worst=0.43, limit=1.0, unit="ratio", ok=True, where="rotation at t 18.5 s"),
        Check(name="joint_acceleration", worst=0.96, limit=1.0, unit="ratio", ok=True, where="joint_6 at t 20.1 s"),
        Check(
            name="joint_jerk", worst=0.99 if ok else 1.31, limit=1.0, unit="ratio", ok=ok, where="joint_4 at t 7.2 s"
        ),
        Check(name="singularity", worst=0.13, limit=0.05, unit="", ok=True, where="bead 14, 22.1 mm along it"),
    )
    v = cat["speed"][deposit]
    metrics = {
        "waypoints": 10000, "beads": 4 * layers, "layers": layers, "deposited_length_mm": float(v.sum() * DT * 1e3),
        "bound_deposition_time_s": 0.98 * float(deposit.sum() * DT),
        "deposition_time_s": float(deposit.sum() * DT), "ideal_deposition_time_s": float(v.sum() * DT / COMMANDED),
        "print_time_s": float(n * DT), "at_speed_fraction": float(v[v > 0.98 * COMMANDED].sum() / v.sum()),
        "speed_min_mm_s": float(v.min() * 1e3), "speed_max_mm_s": float(v.max() * 1e3), "sigma_min": 0.13,
        "sigma_p01": 0.14, "wrist_margin_deg": 21.0, "joint_limit_margin_deg": 16.0, "velocity_ratio_max": 0.43,
        "acceleration_ratio_max": 0.96, "jerk_ratio_max": 0.99 if ok else 1.31, "position_error_max_mm": 0.00031,
        "axis_error_max_deg": 0.00012, "path_deviation_max_mm": 0.183, "branch_changes_in_deposition": 0,
        "extruded_mm": float(flow.sum() * DT * 1e9 / (np.pi / 4 * 1.75**2)), "extruded_volume_mm3": float(flow.sum() * DT * 1e9),
    }  # fmt: skip
    published = metrics | {
        "at_speed_fraction": 0.81, "speed_min_mm_s": 3.1, "deposition_time_s": 1.31 * metrics["deposition_time_s"],
        "sigma_min": 0.021, "wrist_margin_deg": 3.2, "jerk_ratio_max": 4.7, "acceleration_ratio_max": 2.2,
    }  # fmt: skip
    robot = SimpleNamespace(name="ABB IRB 140-6/0.8", assumed=("acceleration_rad_s2", "jerk_rad_s3"))
    table = SimpleNamespace(name="ABB IRBP A250", joint_names=("tilt", "rotation"), assumed=("acceleration_rad_s2",))
    return Plan(
        problem=make_problem(name),
        cell=SimpleNamespace(joint_names=names, limits=limits, arm_robot=robot, holder_robot=table, spherical=True),
        toolpath=SimpleNamespace(
            beads=make_beads(4 * layers), layers=layers, shape=SHAPE, notes=(), splits=(), left_out=()
        ),
        strategy="ladder",
        trajectory=trajectory,
        checks=checks,
        metrics=metrics,
        series=series,
        timing_s={"load": 0.11, "toolpath": 0.35, "resolve": 4.2, "timing": 1.7, "verify": 0.9, "total": 7.3},
        versions={"beadwise": "0.1.0", "numpy": "2.4.6", "pinocchio": "4.1.0"},
        baseline={"as_published": published},
        settings={"resolve": {"roll_step_deg": 5.0, "table_step_deg": 2.0}, "dt_s": DT},
    )


def with_dips(plan: Plan, *, every: int = 1, joint: str = "joint_4", over: float = 0.0) -> Plan:
    """The plan with its dips told, a dip at each `every`-th corner of the stars, and those that no joint asks for."""
    traj = plan.trajectory
    v = np.where(traj.deposit, traj.speed, COMMANDED)
    low = np.flatnonzero((v[1:-1] < 0.9 * COMMANDED) & (v[1:-1] <= v[:-2]) & (v[1:-1] < v[2:]))[::every] + 1
    speed = Remedy("speed", (("process.speed_mm_s", 18.0),), True)
    limits = Remedy("limits", ((f"cell.limits.{joint}.jerk_rad_s3", 1800.0), ("cell.limits.joint_6.jerk_rad_s3", 1600.0),
                               ("cell.limits.rotation.jerk_rad_s3", 400.0)), True)  # fmt: skip
    tolerance = Remedy("corner_tolerance", (("process.corner_tolerance_mm", 0.4),), False)
    dips = tuple(
        Dip(
            bead=int(traj.bead[i]),
            layer=int(traj.layer[i]),
            from_s=float(traj.s[i] - 5e-4),
            to_s=float(traj.s[i] + 5e-4),
            at_s=float(traj.s[i]),
            t=float(traj.t[i]),
            speed=float(v[i]),
            lost=0.01 + 0.001 * (k % 7),
            joint="" if k % 9 == 8 else joint,
            limit="start" if k % 9 == 8 else "jerk",
            over_extruded=over,
            remedies=() if k % 9 == 8 else (speed, limits, tolerance),
        )
        for k, i in enumerate(low)
    )
    return dataclasses.replace(plan, dips=dips)


def make_beads(count: int = 6, waypoints: int = 200) -> tuple[SimpleNamespace, ...]:
    """Rings round the cylinder, one above the other."""
    a = np.linspace(0, 2 * np.pi, waypoints)
    normals = np.column_stack([np.cos(a), np.sin(a), np.zeros(waypoints)])
    beads = []
    for k in range(count):
        points = np.column_stack([CENTRE + RADIUS * normals[:, :2], np.full(waypoints, 0.02 + 0.002 * k)])
        beads.append(
            SimpleNamespace(
                name=f"ring {k}",
                layer=0,
                round=False,
                points=points,
                normals=normals,
                s=a * RADIUS,
                commanded=lambda usual: usual,
            )
        )
    return tuple(beads)


def write_folder(plan, folder: Path) -> None:
    """trajectory.csv and plan.json as the output contract has them, with the columns that a picture needs and more."""
    traj = plan.trajectory
    columns = {
        "t_s": traj.t, "bead": traj.bead, "layer": traj.layer, "deposit": traj.deposit, "s_mm": traj.s * 1e3,
        "x_mm": traj.tip[:, 0] * 1e3, "y_mm": traj.tip[:, 1] * 1e3, "z_mm": traj.tip[:, 2] * 1e3,
        "ax": traj.axis[:, 0], "ay": traj.axis[:, 1], "az": traj.axis[:, 2], "speed_mm_s": traj.speed * 1e3,
        "flow_mm3_s": traj.flow * 1e9, "e_mm": traj.extruded, "joint_1": traj.q[:, 0],
    }  # fmt: skip
    table = np.column_stack([np.asarray(v, dtype=float) for v in columns.values()])
    folder.mkdir(parents=True, exist_ok=True)
    np.savetxt(folder / "trajectory.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    summary = {
        "problem": plan.problem.name,
        "strategy": plan.strategy,
        "verified": plan.verified,
        "metrics": plan.metrics,
        "dips": [{"t_s": dip.t, "lost_s": dip.lost, "limit": dip.limit} for dip in plan.dips],
    }
    (folder / "plan.json").write_text(json.dumps(summary))


def _layer(k: int, samples: int) -> dict[str, np.ndarray]:
    """Three five-pointed stars and a ring, with travel between them."""
    radius = RADIUS + 0.0005 * (k + 1)
    share = samples // 4
    out: dict[str, list[np.ndarray]] = {key: [] for key in ("tip", "axis", "speed", "layer", "bead", "s")}
    for b in range(4):
        n = share if b < 3 else samples - 3 * share
        printed = int(n * 0.85)
        u = np.linspace(0, 1, printed)
        if b < 3:
            corner = np.arange(11)
            r = np.where(corner % 2 == 0, 0.022, 0.010) * (1 - 0.012 * k)
            a = np.pi / 2 + corner * np.pi / 5
            x = np.interp(u * 10, corner, r * np.cos(a)) + (b - 1) * 0.046
            y = np.interp(u * 10, corner, r * np.sin(a)) + 0.05
            to_corner = np.abs(u * 10 - np.round(u * 10))
            speed = COMMANDED * (1 - 0.55 * np.exp(-((to_corner / 0.025) ** 2)))
        else:
            x, y = (u - 0.5) * 0.15, 0.082 + 0.004 * np.sin(u * 6 * np.pi)
            speed = np.full(printed, COMMANDED)
        travel = n - printed
        x = np.concatenate([x, np.linspace(x[-1], 0.0, travel)])
        y = np.concatenate([y, np.full(travel, y[-1])])
        lift = np.concatenate([np.zeros(printed), 0.005 * np.sin(np.linspace(0, np.pi, travel))])
        angle = x / RADIUS + 0.6
        normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])
        flat = CENTRE + (radius + lift)[:, None] * normal[:, :2]
        out["tip"].append(np.column_stack([flat, y]))
        out["axis"].append(-normal)
        out["speed"].append(np.concatenate([speed, 0.2 * np.sin(np.linspace(0, np.pi, travel))]))
        out["bead"].append(np.concatenate([np.full(printed, b), np.full(travel, -1)]))
        out["layer"].append(np.full(n, k))
        out["s"].append(np.concatenate([np.cumsum(speed) * DT, np.zeros(travel)]))
    return {key: np.concatenate(values) for key, values in out.items()}
