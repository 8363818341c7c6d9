"""ROS JointTrajectory: what is written, read back with nothing of ours, and messages that were tampered with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from export_fixtures import GOLDEN, SECOND_ARM, golden_texts, make_plan
from scipy.interpolate import BPoly
from solved import BED, small_plan, write_small

from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.export.external import held_axes
from planner.export.joint_trajectory import (
    differences,
    joint_trajectory,
    plan_knots,
    read_joint_trajectory,
    read_switches,
    switches,
)
from planner.plan import Plan
from planner.problem import load_problem

MESSAGE, EXTRUDER = "two_beads_joint_trajectory.json", "two_beads_extruder.json"
PLANS: dict[str, Callable[[], Plan]] = {
    "table": make_plan,
    "bed": lambda: make_plan(positioner=False),
    "two axes": lambda: make_plan(free=("tilt", "rotation")),
    "solved": small_plan,
}


def files(plan: Plan) -> dict[str, str]:
    return {
        f"{plan.problem.name}_joint_trajectory.json": joint_trajectory(plan),
        f"{plan.problem.name}_extruder.json": switches(plan),
    }


@pytest.mark.parametrize("name", [MESSAGE, EXTRUDER])
def test_golden_file(name: str) -> None:
    assert golden_texts()[name] == (GOLDEN / name).read_text(encoding="utf-8")


def splines(text: str) -> tuple[np.ndarray, list[BPoly]]:
    """Times, and the polynomial of each joint, as a controller makes them of the message's points."""
    points = json.loads(text)["points"]
    times = np.array([p["time_from_start"]["sec"] + 1e-9 * p["time_from_start"]["nanosec"] for p in points])
    states = np.array([[p["positions"], p["velocities"], p["accelerations"]] for p in points])
    return times, [BPoly.from_derivatives(times, states[:, :, j]) for j in range(states.shape[2])]


@pytest.mark.parametrize("which", PLANS)
def test_a_controllers_splines_follow_the_plan(which: str) -> None:
    """At every sample: the tip within the chord tolerance where material is laid, joints within their limits."""
    plan = PLANS[which]()
    t, cell = plan.trajectory, plan.cell
    text = joint_trajectory(plan)
    times, joints = splines(text)
    q = np.column_stack([joint(t.t - t.t[0]) for joint in joints])
    T = cell.T_part_nozzle(q)
    off = np.linalg.norm(T[:, :3, 3] - t.tip, axis=1)
    assert off[t.deposit].max() < 0.021e-3 and off.max() < 0.21e-3
    cosine = np.einsum("ij,ij->i", T[:, :3, 2], t.axis)
    assert np.degrees(np.arccos(np.minimum(cosine, 1.0)).max()) < 0.06
    assert (times[0], times[-1]) == (0.0, pytest.approx(t.t[-1] - t.t[0], abs=1e-9))
    assert len(times) < len(t) / 5  # few points, and yet
    dense = np.linspace(0.0, times[-1], 20 * len(t))
    if which == "solved":
        for order, limit in ((1, cell.limits.velocity), (2, cell.limits.acceleration)):
            reached = np.abs(np.column_stack([joint.derivative(order)(dense) for joint in joints])).max(axis=0)
            assert (reached < 1.05 * limit).all()
    assert differences(plan, files(plan)) == []


@pytest.mark.parametrize("which", ["table", "solved"])
def test_velocities_and_accelerations_are_those_of_the_motion(which: str) -> None:
    """Central differences of the plan's own samples, at the samples that became points."""
    plan = PLANS[which]()
    t = plan.trajectory
    knots = read_joint_trajectory(joint_trajectory(plan)).knots
    k = np.round(knots.time / t.dt).astype(int)[1:-1]
    np.testing.assert_allclose(t.t[k] - t.t[0], knots.time[1:-1], atol=1e-9)
    np.testing.assert_allclose(knots.q[1:-1], t.q[k], atol=6e-8)
    velocity = (t.q[k + 1] - t.q[k - 1]) / (2.0 * t.dt)
    acceleration = (t.q[k + 1] - 2.0 * t.q[k] + t.q[k - 1]) / t.dt**2
    limits = plan.cell.limits
    assert (np.abs(knots.velocity[1:-1] - velocity) / limits.velocity).max() < 0.01
    assert (np.abs(knots.acceleration[1:-1] - acceleration) / limits.acceleration).max() < 0.3
    assert not knots.velocity[[0, -1]].any()


def test_extruders_are_switched_where_material_begins_and_ends() -> None:
    plan = make_plan(materials=("pla", "pva"))
    t = plan.trajectory
    events, held = read_switches(switches(plan))
    on = np.flatnonzero(t.deposit[1:] & ~t.deposit[:-1]) + 1
    off = np.flatnonzero(t.deposit[:-1] & ~t.deposit[1:])
    assert [event.value for event in events] == [True, False] * 2
    assert [event.output for event in events] == ["doExtrude", "doExtrude", "doSupport", "doSupport"]
    assert [event.bead for event in events] == [0, 0, 1, 1]
    expected = np.column_stack([t.t[on], t.t[off]]).ravel() - t.t[0]
    np.testing.assert_allclose([event.time for event in events], expected, atol=1e-9)
    assert held == {"tilt": 0.0}


def test_ros_takes_the_message() -> None:
    """Through ROS 2's own definition of the message into its wire format, and back."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kinds = store.types
    data = json.loads(joint_trajectory(make_plan()))
    duration, point = kinds["builtin_interfaces/msg/Duration"], kinds["trajectory_msgs/msg/JointTrajectoryPoint"]
    header, time = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    points = [
        point(
            **{
                name: np.array(p[name], dtype=np.float64)
                for name in ("positions", "velocities", "accelerations", "effort")
            },
            time_from_start=duration(**p["time_from_start"]),
        )
        for p in data["points"]
    ]
    name = "trajectory_msgs/msg/JointTrajectory"
    head = header(stamp=time(**data["header"]["stamp"]), frame_id=data["header"]["frame_id"])
    message = kinds[name](header=head, joint_names=data["joint_names"], points=points)
    back = store.deserialize_cdr(store.serialize_cdr(message, name), name)
    assert back.joint_names == data["joint_names"] and len(back.points) == len(points) > 50
    for sent, got in zip(data["points"], back.points, strict=True):
        assert got.positions.tolist() == sent["positions"] and got.accelerations.tolist() == sent["accelerations"]
        assert (got.time_from_start.sec, got.time_from_start.nanosec) == tuple(sent["time_from_start"].values())
    # every field of the definition is there
    assert set(data) == {"header", "joint_names", "points"}
    assert set(data["points"][0]) == {field for field in point.__dataclass_fields__ if not field.startswith("__")}


def spoilt(change: Callable[[Any], object], name: str = MESSAGE) -> list[str]:
    """What is found to be wrong with the small plan's files when one was changed."""
    texts = files(make_plan())
    data = json.loads(texts[name])
    change(data)
    return differences(make_plan(), texts | {name: json.dumps(data)})


def add(field: str, k: int, joint: int, amount: float) -> Callable[[Any], object]:
    def change(data: Any) -> None:
        data["points"][k][field][joint] += amount

    return change


@pytest.mark.slow(keep=22)
@pytest.mark.parametrize("k", range(2, 54, 4))
@pytest.mark.parametrize("joint", range(7))
def test_any_point_that_was_moved_is_found(k: int, joint: int) -> None:
    assert spoilt(add("positions", k, joint, 0.002)) != []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda data: None, None),
        (add("positions", 40, 3, 0.002), "angle"),
        (add("velocities", 40, 3, 0.5), "velocity"),
        (add("accelerations", 40, 3, 20.0), "acceleration"),
        (lambda data: data["points"].pop(39), "acceleration"),
        (lambda data: data["points"].pop(), "it takes"),
        (
            lambda data: data["points"][40]["time_from_start"].update(
                nanosec=data["points"][40]["time_from_start"]["nanosec"] + 3_000_000
            ),
            "velocity",
        ),
        (lambda data: data["joint_names"].reverse(), "joints are"),
    ],
)
def test_a_message_that_says_something_else_is_found(change: Callable[[Any], object], named: str | None) -> None:
    found = spoilt(change)
    assert (found == []) if named is None else any(named in difference for difference in found), found


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda data: data["events"].pop(), "3 times"),
        (lambda data: data["events"][1].update(output="doOther"), "not switched as planned"),
        (lambda data: data["events"][1].update(value=True), "not switched as planned"),
        (lambda data: data["events"][2].update(bead=0), "not switched as planned"),
        (lambda data: data["events"][2]["time_from_start"].update(nanosec=1), "is switched at"),
        (lambda data: data["held"].update(tilt=0.1), "held"),
        (lambda data: data["held"].clear(), "held"),
    ],
)
def test_switching_that_says_something_else_is_found(change: Callable[[Any], object], named: str) -> None:
    assert any(named in difference for difference in spoilt(change, EXTRUDER))


def test_held_axes_have_names_that_no_other_joint_has() -> None:
    plan = make_plan(free=SECOND_ARM["free"])
    held = json.loads(switches(plan))["held"]
    assert list(held) == [f"positioner_joint_{k}" for k in range(1, 6)]
    assert held["positioner_joint_2"] == pytest.approx(np.radians(60))
    assert not set(held) & set(plan.cell.joint_names)
    assert differences(plan, files(plan)) == []


def test_held_axes_of_what_carries_the_arm_are_told(tmp_path: Path) -> None:
    base = "  base_mm: [20, -30, 40]\n"
    carried = f"{base}  base: {{robot: gantry_xy, free: [gantry_x], held_mm: {{gantry_y: 250}}}}\n"
    cell = build_cell(load_problem(write_small(tmp_path, *BED, (base, carried))))
    assert [(axis.name, axis.held, axis.slides) for axis in held_axes(cell)] == [("gantry_y", 0.25, True)]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"effort":[]', '"effort":[1.0]', "points.0.effort: must be 0 numbers"),
        ('"positions":[0', '"positions":[1,0', "points.0.positions: must be 7 numbers, not 8"),
        ('"positions":[0.5235988', '"positions":[NaN', "NaN is not a JSON number"),
        ('"positions":[0.5235988', '"positions":[1e999', "points.0.positions: must be finite"),
        ('"positions":[0.5235988', '"positions":[true', "points.0.positions: must be finite"),
        ('"positions":[0.5235988', '"positions":[' + "9" * 5000, "too long"),
        ('"sec":0,"nanosec":84000000', '"sec":0,"nanosec":0', "points.1.time_from_start: must be later"),
        ('"sec":0,"nanosec":84000000', '"sec":0,"nanosec":1000000000', "out of range"),
        ('"sec":0,"nanosec":84000000', '"sec":0.0,"nanosec":1', "whole seconds"),
        ('"frame_id":""', '"frame_id":"","seq":1', "header: must have stamp, frame_id and nothing else"),
        ('"frame_id":""', '"frame_id":3', "header.frame_id: must be a text"),
        ('"joint_1"', '"joint_2"', "joint_names: must be unique names"),
        ('"joint_names"', '"points"', "twice"),
        ('"points":[', '"points":[[', "is not JSON"),
        ('"points":[\n{', '"points":[\n3,{', "points.0: must have"),
    ],
)
def test_reader_refuses_what_is_no_message(old: str, new: str, message: str) -> None:
    text = joint_trajectory(make_plan())
    assert old in text
    with pytest.raises(InputError, match=message):
        read_joint_trajectory(text.replace(old, new, 1))


def test_reader_refuses_endless_nesting() -> None:
    with pytest.raises(InputError, match="nested too deeply"):
        read_joint_trajectory("[" * 200_000)


@pytest.mark.parametrize(
    ("old", "new"),
    [('"value":true', '"value":1'), ('"bead":0', '"bead":0.0'), ('"output":"doExtrude"', '"output":null'), ('"tilt":0.0', '"tilt":"0"')],
)  # fmt: skip
def test_reader_refuses_what_is_no_switching(old: str, new: str) -> None:
    text = switches(make_plan())
    assert old in text
    with pytest.raises(InputError):
        read_switches(text.replace(old, new, 1))


def test_rests_take_few_points() -> None:
    """Two seconds of rest at home for a change of material: points a quarter of a second apart."""
    plan = make_plan(materials=("pla", "pva"))
    time = plan_knots(plan).time
    still = np.abs(np.diff(plan.trajectory.q, axis=0)).max(axis=1) == 0.0
    begin = plan.trajectory.t[int(np.flatnonzero(still)[5])]
    assert ((time > begin) & (time < begin + 1.5)).sum() <= 8
