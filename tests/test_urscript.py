"""URScript: golden file, a reading with nothing of ours, and programs that were tampered with."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from export_fixtures import GOLDEN, golden_texts, make_plan, resting_in_a_bead
from scipy.spatial.transform import Rotation
from solved import BED, POSITIONER, solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.shipped import ROBOTS
from planner.cell.cell import build_cell
from planner.cell.robot import Robot, chain_of, read_robot
from planner.export import urscript as language
from planner.export.languages import LANGUAGES, chosen
from planner.export.support import unsupported_in_urscript
from planner.export.urscript import (
    differences,
    quaternions,
    read_urscript,
    rotation_vectors,
    world_controller,
    write,
)
from planner.plan import Plan
from planner.problem import load_problem

NAME = "TwoBeads.script"
MOVE = re.compile(
    r"(move[pcj])\((?:pose_trans\(part, p\[[^]]*\]\), )?(?:pose_trans\(part, p)?\[([^]]*)\]\)?, a=([\d.]+), v=([\d.]+), r=([\d.]+)(?:, mode=0)?\)"
)
# The maker's tables: d1, a2, a3, d4, d5, d6 [m]
DH = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
}


@cache
def arc(**changes: object) -> Plan:
    """Beads round a cylinder by a UR5e."""
    return make_plan(positioner=False, arm="ur5e", **changes)  # type: ignore[arg-type]


def urscript(plan: Plan) -> str:
    """The program of a print that is no more than one."""
    (text,) = write(plan).values()
    return text


def controller(key: str, q: Array) -> Array:
    """Flange in the controller's base frame, by the DH table."""
    d1, a2, a3, d4, d5, d6 = DH[key]
    T = np.eye(4)
    for theta, d, a, alpha in zip(
        q, (d1, 0, 0, d4, d5, d6), (0, a2, a3, 0, 0, 0), (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0), strict=True
    ):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
    return T


def frame(text: str) -> Array:
    x, y, z, *vector = (float(value) for value in text.split(","))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), (x, y, z)
    return T


def moves_of(text: str) -> list[SimpleNamespace]:
    """The moves in the order in which they run: the start stands last in the text."""
    found = [
        SimpleNamespace(word=word, values=values, a=float(a), v=float(v), r=float(r))
        for word, values, a, v, r in MOVE.findall(text)
    ]
    return [found[-1], *found[:-1]]


# ---- what is written ----------------------------------------------------------------------------------------------


def test_golden_file() -> None:
    assert golden_texts()[NAME] == (GOLDEN / NAME).read_text(encoding="utf-8")


@pytest.mark.parametrize("key", DH)
def test_the_controllers_base_is_the_makers(key: str) -> None:
    """Whatever way a URDF's base is turned, poses are those that the maker's table gives for the same joints."""
    robot = read_robot(ROBOTS / f"{key}.yaml")
    T_world_base = np.eye(4)
    T_world_base[:3, 3] = 0.1, -0.2, 0.3
    chain = chain_of(robot, T_world_base, np.eye(4), robot.joint_names, {})
    T = world_controller(SimpleNamespace(arm=chain, T_world_base=T_world_base, arm_robot=robot))  # type: ignore[arg-type]
    for q in np.random.default_rng(2).uniform(-3.0, 3.0, (10, 6)):
        np.testing.assert_allclose(T @ controller(key, q), chain.poses(q[None])[0], atol=1e-9)


def on_a_ceiling(folder: Path, roll: float = np.pi / 2) -> Robot:
    """A UR5e whose URDF begins with the room that it hangs in; roll: by how much axis 2 is turned against axis 1 [rad]."""
    text = (ROBOTS / "ur5e.urdf").read_text(encoding="utf-8")
    hung = '<joint name="hung" type="fixed"><parent link="room"/><child link="base_link"/>'
    hung += f'<origin xyz="0.2 -0.3 2.5" rpy="{np.pi} 0 0.5"/></joint>'
    text = text.replace("</robot>", f'<link name="room"/>{hung}</robot>')
    text = text.replace('rpy="1.5707963267948966 0 0"/><axis', f'rpy="{roll} 0 0"/><axis', 1)
    (folder / "ur5e.urdf").write_text(text, encoding="utf-8")
    (folder / "ur5e.yaml").write_text((ROBOTS / "ur5e.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    return read_robot(folder / "ur5e.yaml")


def test_what_a_urdf_has_beneath_the_base_is_not_the_controllers(tmp_path: Path) -> None:
    robot = on_a_ceiling(tmp_path)
    chain = chain_of(robot, np.eye(4), np.eye(4), robot.joint_names, {})
    T = world_controller(SimpleNamespace(arm=chain, T_world_base=np.eye(4), arm_robot=robot))  # type: ignore[arg-type]
    for q in np.random.default_rng(2).uniform(-3.0, 3.0, (10, 6)):
        np.testing.assert_allclose(T @ controller("ur5e", q), chain.poses(q[None])[0], atol=1e-9)


def test_axes_of_a_measured_arm_do_not_tilt_the_controllers_base(tmp_path: Path) -> None:
    made = []
    for roll in (np.pi / 2, np.pi / 2 + 2e-3):
        robot = on_a_ceiling(tmp_path, roll)
        chain = chain_of(robot, np.eye(4), np.eye(4), robot.joint_names, {})
        made.append(
            world_controller(SimpleNamespace(arm=chain, T_world_base=np.eye(4), arm_robot=robot))  # type: ignore[arg-type]
        )
    np.testing.assert_allclose(made[1], made[0], atol=1e-12)


def test_targets_are_where_the_plan_has_the_nozzle() -> None:
    """The maker's table, set_tcp and the part's pose alone put each target where the plan's joints have it."""
    plan, text = arc(), urscript(arc())
    tool, part = (frame(re.search(rf"{word}p\[(.*?)\]", text)[1]) for word in (r"set_tcp\(", "part = "))  # type: ignore[index]
    planned = np.array([np.linalg.inv(part) @ controller("ur5e", q) @ tool for q in plan.trajectory.q])
    lines = 0
    for move in moves_of(text):
        if move.word == "movej":
            q = np.array([float(value) for value in move.values.split(",")])
            assert np.abs(plan.trajectory.q - q).max(axis=1).min() < 1e-6
            continue
        T = frame(move.values)
        off = np.linalg.norm(planned[:, :3, 3] - T[:3, 3], axis=1)
        k = int(np.argmin(off))
        assert off[k] < plan.problem.program.chord
        assert Rotation.from_matrix(planned[k, :3, :3].T @ T[:3, :3]).magnitude() < np.radians(0.1)
        lines += 1
    assert lines > 10


def test_blends_share_no_line_and_keep_to_the_tolerance() -> None:
    spec = SimpleNamespace(**vars(arc().problem))
    spec.program = arc().problem.program.model_copy(update={"arcs": False})
    plan = replace(arc(), problem=spec)  # type: ignore[arg-type]
    moves = moves_of(urscript(plan))
    beads = [list(group) for line, group in itertools.groupby(moves, lambda m: m.word == "movep") if line]
    assert len(beads) == 2
    for bead in beads:
        p = np.array([frame(move.values)[:3, 3] for move in bead])
        r = np.array([move.r for move in bead])
        length = np.linalg.norm(np.diff(p, axis=0), axis=1)
        assert r[-1] == 0.0 and (r[:-1] > 0.0).all()  # it stops at the end of the run-out only
        assert (r[:-1] + r[1:] <= length + 2e-6).all()
        a, b = p[1:-1] - p[:-2], p[2:] - p[1:-1]
        bend = np.arccos(np.einsum("ij,ij->i", a, b) / length[:-1] / length[1:])
        inside = r[1:-1] / np.tan(bend / 2) * (1 / np.cos(bend / 2) - 1)  # of an arc that touches both lines there
        assert inside.max() <= plan.problem.program.chord + 1e-6
        # and they are no smaller than they must be, but where an output is switched
        free = r[1:-1] > 0.041e-3
        assert free.sum() >= len(free) - 2
        assert np.median((r[1:-1] / np.minimum(length[:-1], length[1:]))[free]) == pytest.approx(0.5, abs=0.02)


def test_outputs_are_switched_in_motion_and_off_at_start_and_end() -> None:
    text = urscript(arc())
    said = re.findall(r"^( *)set_standard_digital_out\((\d), (\w+)\)$", text, re.MULTILINE)
    assert [(len(indent), value) for indent, _, value in said] == [
        *((4, value) for value in ("True", "False") * 2),
        *((2, "False"),) * 2,
    ]
    for at in re.finditer(r"r=([\d.]+)\)\n    set_standard", text):
        assert float(at[1]) == 0.00004


def test_materials_have_outputs_one_after_the_other() -> None:
    plan = arc(materials=("pla", "pva"))
    text = urscript(plan)
    assert re.findall(r"^    set_standard_digital_out\((.*)\)$", text, re.MULTILINE) == [
        *("1, True", "1, False", "2, True", "2, False")
    ]
    assert text.count("sleep(2.0") == 1  # for the change
    assert differences(plan, {NAME: text}) == []


@pytest.mark.parametrize("changes", [{}, {"beads": 1, "length": 0.004}, {"beads": 3, "dip": False}])
def test_the_program_repeats_the_plan(changes: dict[str, object]) -> None:
    plan = arc(**changes)
    assert differences(plan, {NAME: urscript(plan)}) == []


def test_lines_that_the_arm_cannot_keep_up_with_are_found() -> None:
    """The program is played, not only compared: joints that turn slowly take longer than the plan has it."""
    plan = arc()
    limits = replace(plan.cell.limits, velocity=0.03 * plan.cell.limits.velocity)
    slow = replace(plan, cell=replace(plan.cell, limits=limits))
    found = differences(slow, {NAME: urscript(plan)})
    assert len(found) == 1 and found[0].startswith("time of deposition is "), found


def test_rests_in_a_bead_are_kept() -> None:
    """A cut fibre: the arm stops in the bead, and waits."""
    resting = resting_in_a_bead(arc(dip=False))
    text = urscript(resting)
    assert re.search(
        r"move[pc].*r=0.*\)\n    set_standard_digital_out\(1, False\)\n    # cut, bead 0\n    sleep\(0.500\)", text
    )
    assert differences(resting, {NAME: text}) == []
    assert differences(resting, {NAME: text.replace("sleep(0.500)", "sleep(0.400)")}) != []


def test_a_longer_print_is_programs_that_follow_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(language, "MOST_MOVES", 45)
    plan = arc(beads=4)
    files = write(plan)
    names = [f"TwoBeads_{k}.script" for k in range(1, len(files) + 1)]
    assert list(files) == names and len(names) > 2
    assert f"Part 1 of {len(names)}, TwoBeads_1 to TwoBeads_{len(names)}: run each when" in files[names[0]]
    for name, text in files.items():
        assert text.count("\n    move") <= 45 and f"\ndef {name[:-7]}():" in text
    whole = differences(plan, files)
    assert whole == []
    later = files[names[1]]
    start = re.search(r"^  movej\(\[(-?\d\.\d)", later, re.MULTILINE)
    assert start
    for changed, message in (
        (later.replace(start[0], start[0][:-1] + str((int(start[0][-1]) + 1) % 10)), "does not begin where"),
        (re.sub(r"part = p\[-?0", "part = p[1", later), "another tool or part"),
    ):
        assert changed != later
        with pytest.raises(InputError, match=message):
            differences(plan, files | {names[1]: changed})
    without = files | {
        names[1]: later.replace("set_standard_digital_out(1, True)", "set_standard_digital_out(2, True)")
    }
    assert any("output" in each for each in differences(plan, without))
    with pytest.raises(InputError, match="does not begin where"):
        differences(plan, files | {names[1]: files[names[2]], names[2]: files[names[1]]})


def test_a_bead_that_is_longer_than_a_program_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(language, "MOST_MOVES", 20)
    files = write(arc())
    assert len(files) == 3
    assert re.search(r"# Note: \d+ moves without a place to stop", files["TwoBeads_1.script"])
    assert differences(arc(), files) == []


def test_blends_that_are_too_small_for_a_steady_speed_are_told() -> None:
    text = urscript(arc())
    told = re.search(r"# Note: (\d+) of (\d+) blends in beads are smaller than 1 mm, the smallest (\d\.\d+) mm:", text)
    assert told
    radii = [float(r) for r in re.findall(r"move[pc].* r=(0\.\d+)", text)]
    small = [r for r in radii if 0.00004 < r < 0.001]
    assert 0 < int(told[1]) <= len(small) and float(told[3]) in [round(1e3 * r, 3) for r in small]


@pytest.mark.slow
def test_a_solved_print_on_a_turned_base(tmp_path: Path) -> None:
    """A UR5, whose URDF's base is turned against the controller's, before a leaning nozzle."""
    ur = (
        ("arm: irb140", "arm: ur5\n  base_mm: [20, -30, 40]"),
        ("home_deg: [30, 20, 30, 90, -80, 60]", "home_deg: [180, -90, 90, 0, 90, 0]"),
        (POSITIONER, "  bed_mm: [-450, -50, 300]\n"),
        BED[1],
    )
    plan = solve_alone(load_problem(write_small(tmp_path, *ur), ("layers.source.width_mm=12",)))
    assert [check.name for check in plan.checks if not check.ok] == []
    assert differences(plan, {"Small.script": urscript(plan)}) == []


def test_lines_are_within_bounds() -> None:
    text = urscript(replace(arc(), strategy="ladder ü" + "x" * 300))
    assert text.isascii() and all(len(line) <= 230 for line in text.split("\n"))


# ---- what cannot be said ------------------------------------------------------------------------------------------


def test_a_part_that_is_moved_cannot_be_said(tmp_path: Path) -> None:
    problem = load_problem(
        write_small(
            tmp_path,
            ("arm: irb140", "arm: ur5e"),
            ("home_deg: [30, 20, 30, 90, -80, 60]", "home_deg: [0, -90, 90, 0, 90, 0]"),
        )
    )
    found = chosen(SimpleNamespace(problem=problem, cell=build_cell(problem)))
    assert found.names == ("extruder",)
    assert found.note == "no URScript program: it moves the arm alone, and here ABB IRBP A250 moves the part"


def test_other_arms_cannot_be_told() -> None:
    plan = make_plan(positioner=False)
    assert "ABB IRB 140-6/0.8 is not a Universal Robots arm" in str(unsupported_in_urscript(plan))
    with pytest.raises(ValueError, match="not a Universal Robots arm"):
        LANGUAGES["urscript"].write(plan)


def test_outputs_that_the_control_box_has_not() -> None:
    plan = arc(materials=("pla", "pva"))
    problem = SimpleNamespace(**vars(plan.problem))
    problem.program = plan.problem.program.model_copy(update={"extruder_output": 7})
    setup = SimpleNamespace(problem=problem, cell=plan.cell)
    assert unsupported_in_urscript(setup) == "an extruder has the output 8, and the last one is 7"


# ---- what is read back --------------------------------------------------------------------------------------------

TARGET = r"movec.*, pose_trans\(part, p\[(.*?)\]"
LINE, JOINT = r"(?:movep\(|, )pose_trans\(part, p\[(.*?)\]\), a", r"movej\(\[(.*?)\]"


def shifted(column: int, amount: float) -> Callable[[re.Match[str]], str]:
    def change(match: re.Match[str]) -> str:
        values = match[1].split(", ")
        values[column] = f"{float(values[column]) + amount:.6f}"
        return match[0].replace(match[1], ", ".join(values))

    return change


def said(old: str, new: str) -> Callable[[re.Match[str]], str]:
    return lambda match: match[0].replace(old, new)


def tampered(pattern: str, change: Callable[[re.Match[str]], str], which: int) -> list[str]:
    text = urscript(arc())
    matches = list(re.finditer(pattern, text))
    match = matches[which % len(matches)]
    changed = text[: match.start()] + change(match) + text[match.end() :]
    assert changed != text
    return differences(arc(), {NAME: changed})


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("which", range(0, 42, 3))
def test_any_target_of_an_arc_moved_by_a_quarter_of_a_millimetre_is_found(which: int) -> None:
    assert any("path" in difference for difference in tampered(TARGET, shifted(0, 0.25e-3), which))


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("which", range(0, 42, 3))
def test_any_target_moved_by_two_millimetres_is_found(which: int) -> None:
    """On the way into a bead, where nothing is laid, paths are not as narrow."""
    found = tampered(LINE, shifted(0, 2.1e-3), which)
    assert any("path" in difference or "travel" in difference for difference in found)


@pytest.mark.slow(keep=("0-0", "3-26", "5-65"))
@pytest.mark.parametrize("which", range(0, 90, 13))
@pytest.mark.parametrize("joint", range(6))
def test_any_joint_of_travel_that_was_moved_is_found(which: int, joint: int) -> None:
    assert any("joints differ" in difference for difference in tampered(JOINT, shifted(joint, 1e-3), which))


@pytest.mark.slow(keep=6)
@pytest.mark.parametrize(
    ("pattern", "change", "which", "named"),
    [
        (TARGET, shifted(4, 0.01), 2, "axis"),
        (JOINT, shifted(5, 2 * np.pi), 12, "joints"),
        (r"set_tcp\(p\[(.*?)\]", shifted(2, 1e-4), 0, "frames"),
        (r"part = p\[(.*?)\]", shifted(0, 1e-4), 0, "frames"),
        (r"part = p\[(.*?)\]", shifted(5, 0.01), 0, "axis"),
        (r"movep.*, v=(\d\.\d+)", shifted(0, 0.004), 9, "speed"),
        (r"movej.*, v=(\d\.\d+)", shifted(0, 0.004), 9, "speeds of joint moves"),
        (r"movep.*, a=(\d+\.\d)", shifted(0, 1.0), 9, "acceleration of a tip"),
        (r"movej.*, a=(\d+\.\d)", shifted(0, 1.0), 9, "acceleration of a joint"),
        (r"movep.*, r=(\d\.\d+)", lambda m: m[0].replace(f"r={m[1]}", "r=0"), 9, "stops"),
        (r"movep.*, r=(\d\.\d+)", shifted(0, 1e-4), 9, "middle of a line"),
        (r"movep.*, r=(\d\.\d+)(?=\)\n    set_)", shifted(0, 1e-4), 0, "early"),
        (r"    set_standard.*True\)\n", said("True", "False"), 0, "path"),
        (r"    set_standard.*True\)\n", said("(1", "(2"), 0, "output"),
        (r"    set_standard.*False\)\n", lambda m: "", 0, "path"),
        (r" *movep.*\n", lambda m: "", 5, "not of the planned kinds"),
        (r"movec\(pose_trans\(part, p\[(.*?)\]", shifted(1, 0.5e-3), 2, "path"),
        (r"  bead_0002\(\)\n", lambda m: "", 0, "path"),
    ],
)
def test_a_program_that_says_something_else_is_found(
    pattern: str, change: Callable[[re.Match[str]], str], which: int, named: str
) -> None:
    found = tampered(pattern, change, which)
    assert any(named in difference for difference in found), found


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("movep(", "servoj(", "unknown statement"),
        ("v=0.0447", "v=nan", "unknown statement"),
        ("v=0.04472", "v=0.00000", "must be positive"),
        ("bead_0002()\n", "bead_0009()\n", "bead_0009 is not a function"),
        ("def bead_0002", "def bead_0001", "twice"),
        ("  def bead_0001", "  def inner():\n  def bead_0001", "inside another function"),
        ("  global part", "  set_tcp(p[0, 0, 0, 0, 0, 0])\n  global part", "twice"),
        ("  finish()", "  TwoBeads()", "TwoBeads is not a function"),
        ("\nend\n", "\n", "no complete program"),
        ("\nend\n", "\nend\nend\n", "outside the program"),
        ("set_standard_digital_out(1", "set_standard_digital_out(8", "unknown statement"),
    ],
)
def test_reader_refuses_what_it_does_not_know(old: str, new: str, message: str) -> None:
    text = urscript(arc())
    assert old in text
    with pytest.raises(InputError, match=message):
        read_urscript(text.replace(old, new, 1), arc().cell.T_part_nozzle)


def test_rotation_vectors_against_scipy() -> None:
    random = Rotation.random(300, rng=np.random.default_rng(3))
    small = Rotation.from_rotvec(np.random.default_rng(3).normal(size=(50, 3)) * 10.0 ** -np.arange(50)[:, None])
    both = Rotation.concatenate([random, small, Rotation.from_rotvec(np.pi * np.eye(3)), Rotation.identity()])
    vectors = rotation_vectors(-both.as_quat())
    assert (Rotation.from_rotvec(vectors).inv() * both).magnitude().max() < 1e-9
    assert np.linalg.norm(vectors, axis=1).max() <= np.pi + 1e-12
    assert (Rotation.from_quat(quaternions(vectors)).inv() * both).magnitude().max() < 1e-9
