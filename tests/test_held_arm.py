"""A second arm that merely holds the part: one arm's program, with the other's bodies kept clear of."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from export_fixtures import make_plan
from scipy.spatial import cKDTree
from solved import solve_alone

from planner.cell.cell import build_cell
from planner.export.languages import LANGUAGES
from planner.export.player.play import play
from planner.export.program import held_by
from planner.export.rapid.reader import read_rapid
from planner.export.text import LONGEST_COMMENT
from planner.plan import Plan
from planner.problem import load_problem
from planner.problem.settings import MachineSpec
from planner.verify.verdict import verify

HELD = ("cell.positioner.free=[]", "strategy=ladder")
# as the paper's bowl stands in the cell, the arm cannot reach around it: turned by a quarter it can
BOWL = ("cell.positioner.held_deg.joint_6=-90",)
UR = ("cell.arm=ur10e", "cell.home_deg=[180, -130, 100, -60, -90, 0]", "program.style=output")
CASES = [
    ("fibre_plane", "rapid", ()),
    ("fibre_plane", "krl", ()),
    ("fibre_plane", "urscript", UR),
    ("fibre_bowl", "rapid", BOWL),
    ("fibre_bowl", "krl", BOWL),
    ("fibre_corrugated", "rapid", ()),
    ("fibre_corrugated", "krl", ()),
]


@cache
def held(name: str, *changes: str) -> Plan:
    return solve_alone(load_problem(name, (*HELD, *changes)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "language", "changes"), CASES)
def test_the_program_moves_one_arm(name: str, language: str, changes: tuple[str, ...]) -> None:
    plan = held(name, *changes)
    assert plan.verified
    assert plan.cell.station is None and len(plan.cell.joint_names) == 6
    assert LANGUAGES[language].unsupported(plan) is None
    files = LANGUAGES[language].write(plan)
    assert LANGUAGES[language].differences(plan, files) == []
    text = "".join(files.values())
    assert "A second arm, ABB IRB 1200-5/0.9, holds the part and is not moved" in text
    assert "joint_2 60, joint_3 -40" in text
    assert "STN1" not in text and "ActUnit" not in text and "E1 " not in text and "EK(" not in text
    # the other arm's bodies are judged
    (apart,) = (check for check in plan.checks if check.name == "robots clear of each other and of fixtures")
    assert apart.ok and apart.worst < 50.0


UR_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


@pytest.mark.parametrize(
    ("robot", "names"),
    [
        ("ur10e", tuple(f"{name}_joint" for name in UR_JOINTS)),
        ("irb1200_09", tuple(f"joint_{k}" for k in range(1, 7))),
    ],
)
def test_the_header_says_where_every_joint_of_the_other_arm_stands(robot: str, names: tuple[str, ...]) -> None:
    angles = dict(zip(names, (-101.125, -92.25, 50.375, -104.5, -105.625, -106.75), strict=True))
    held = ", ".join(f"{name}: {angle}" for name, angle in angles.items())
    arm = f"{{robot: {robot}, base_mm: [1500, 0, 0], free: [], held_deg: {{{held}}}}}"
    lines = held_by(build_cell(load_problem("fibre_plane", (f"cell.positioner={arm}",))))
    assert max(map(len, lines)) <= LONGEST_COMMENT
    for name, angle in angles.items():
        assert any(f"{name} {angle:g}" in line for line in lines), name


@pytest.mark.slow
def test_the_part_stands_in_the_world() -> None:
    plan = held("fibre_plane")
    files = LANGUAGES["rapid"].write(plan)
    program = read_rapid(files["FibrePlane.mod"])
    T = plan.cell.T_world_holder
    assert program.station == "" and np.isnan(program.external).all()
    np.testing.assert_allclose(program.uframe[:3], T[:3, 3], atol=1e-6)
    moved = files["FibrePlane.mod"].replace(f"[[{T[0, 3] * 1e3:.3f},", f"[[{T[0, 3] * 1e3 + 1.0:.3f},", 1)
    assert moved != files["FibrePlane.mod"]
    assert LANGUAGES["rapid"].differences(plan, files | {"FibrePlane.mod": moved}) != []


def test_an_arm_that_moves_is_a_station_and_so_is_a_table_that_is_held() -> None:
    for name, changes in (("fibre_plane", ()), ("cylinder_logo", ("cell.positioner.free=[]",))):
        cell = build_cell(load_problem(name, changes))
        assert cell.station is cell.holder_robot is not None


@pytest.mark.parametrize("name", ["urscript", "fanuc", "inform", "val3", "kawasaki", "melfa"])
def test_a_table_that_is_held_is_no_axis_of_a_controller_without_external_ones(name: str) -> None:
    language, arm = LANGUAGES[name], "ur5e" if name == "urscript" else "kr6_r900"
    plan = make_plan(free=(), arm=arm)
    assert plan.cell.station is not None
    assert language.unsupported(plan) is None
    files = language.write(plan)
    assert language.differences(plan, files) == []
    text = "".join(files.values())
    assert "A positioner" in text and "IRBP" in text and "tilt 0" in text
    own = language.plan(plan)
    program = language.program(plan, files)
    assert program.station == "" and own.cell.station is None
    played = play(program, own.cell)
    tip = played.at(np.linspace(0.0, played.duration, 4000)).position
    assert cKDTree(tip).query(plan.tip)[0].max() < 1e-3


def test_a_table_that_is_held_turns_no_part_for_a_robot_with_gcode() -> None:
    plan = make_plan(free=(), arm="kr6_r900")
    program = plan.problem.program.model_copy(update={"machine": MachineSpec(flavour="linuxcnc", type="robot")})
    plan = replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]
    (text,) = LANGUAGES["axes"].write(plan).values()
    assert "pose in the part frame" in text and "turning part" not in text
    assert "A positioner, ABB IRBP A250" in text and "tilt 0, rotation 0" in text


@pytest.mark.slow
def test_an_arm_in_the_way_is_found() -> None:
    """The same motion, with the other arm standing where it would be hit."""
    plan = held("fibre_plane")
    near = plan.cell.T_world_holder_base.copy()
    near[0, 3] -= 0.75
    report = verify(plan.problem, replace(plan.cell, T_world_holder_base=near), plan.toolpath, plan.trajectory)
    assert "robots clear of each other and of fixtures" in {check.name for check in report.checks if not check.ok}
