"""Which programs a plan is written as: what the arm's controller speaks, or what the problem asks for."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from export_fixtures import make_plan
from solved import line_of, small_problem, write_small

from planner.base.errors import InputError
from planner.base.shipped import ROBOTS
from planner.cell.cell import build_cell
from planner.cell.robot import read_robot, robot_names
from planner.export.languages import ALWAYS, LANGUAGES, check_languages, chosen
from planner.export.write import write_robot_code
from planner.plan import Plan
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.problem.settings import LANGUAGE_NAMES, USUAL_LANGUAGE

SPOKEN = {"irb": "rapid", "ur": "urscript"}  # by how the robots' names begin; all others go by the usual one


def asked(*languages: str, **plan: object) -> Plan:
    """A small plan that asks for languages."""
    made = make_plan(**plan)  # type: ignore[arg-type]
    problem = SimpleNamespace(**vars(made.problem))
    problem.program = made.problem.program.model_copy(update={"languages": languages})
    problem.error = lambda field, reason, hint: InputError(reason, field=field, hint=hint)
    return replace(made, problem=problem)  # type: ignore[arg-type]


def test_every_name_that_may_be_asked_for_is_a_language() -> None:
    assert set(LANGUAGE_NAMES) | set(ALWAYS) == set(LANGUAGES)
    assert not set(LANGUAGE_NAMES) & set(ALWAYS)


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("key", robot_names())
def test_robots_that_ship_speak_what_their_makers_controllers_do(key: str) -> None:
    robot = read_robot(ROBOTS / f"{key}.yaml")
    expected = next((name for begin, name in SPOKEN.items() if key.startswith(begin)), USUAL_LANGUAGE)
    if robot.inverse is not None:
        assert robot.language == expected


def test_languages_that_are_asked_for_stand_in_their_own_order(tmp_path: Path) -> None:
    names = [path.name for path in write_robot_code(asked("joint_trajectory", "rapid"), tmp_path)]
    assert names == [
        *("two_beads_joint_trajectory.json", "two_beads_extruder.json"),
        *("TwoBeads.mod", "TwoBeads.pgf", "extrusion.gcode"),
    ]


ARMS = {
    "urscript": {"arm": "ur5e", "positioner": False},
    "krl": {"arm": "kr6_r900"},
}


def resumed(plan: Plan) -> Plan:
    """The plan as the rest of one that had a bead before it."""
    t, beads = plan.trajectory, plan.toolpath.beads
    first = SimpleNamespace(**vars(beads[0]) | {"layer": 0})
    toolpath = SimpleNamespace(**vars(plan.toolpath) | {"beads": (first, *beads), "layers_from": lambda first: 1})
    later = replace(t, bead=np.where(t.bead < 0, t.bead, t.bead + 1).astype(t.bead.dtype), first_bead=1)
    return replace(plan, trajectory=later, toolpath=toolpath)  # type: ignore[arg-type]


@pytest.mark.parametrize("language", ["rapid", "joint_trajectory", *ARMS])
def test_a_resumed_print_says_from_which_bead_on(language: str, tmp_path: Path) -> None:
    paths = write_robot_code(resumed(asked(language, **ARMS.get(language, {}))), tmp_path)
    for path in paths[:-1]:
        assert re.search(r"(?i)two_?beads_?from_?1", path.name)
    text = paths[0].read_text(encoding="utf-8")
    if language != "joint_trajectory":
        assert "Resumes at bead 1: those before it must be there" in text
        assert re.findall(r"(?i)bead_?(\d{4})\(\)", text).count("0003") >= 1 and "0001()" not in text


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("language", ["fanuc", "inform", "val3", "kawasaki", "melfa"])
def test_a_resumed_print_says_so_where_beads_have_no_programs(language: str, tmp_path: Path) -> None:
    paths = write_robot_code(resumed(asked(language, arm="kr6_r900", positioner=False)), tmp_path)
    assert re.search(r"(?i)twobeads?from1\.", paths[0].name)
    text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    whole = re.sub(r"( ;)?\n *(\d+:  !|' )", " ", text)  # remarks that go on in the next line
    assert "Resumes at bead 1: those before it must be there" in whole


def test_none_may_be_asked_for(tmp_path: Path) -> None:
    assert [path.name for path in write_robot_code(asked(), tmp_path)] == ["extrusion.gcode"]


def test_the_summary_says_which_programs_there_are() -> None:
    assert chosen(make_plan()).words == "programs: RAPID, the extruder's G-code"
    assert chosen(asked("joint_trajectory")).words == "programs: ROS JointTrajectory, the extruder's G-code"


def unable(plan: Plan, language: str) -> Plan:
    """The plan on an arm without a spherical wrist that is said to speak a language."""
    robot = replace(plan.cell.arm_robot, language=language)
    cell = replace(plan.cell, arm_robot=robot, inverse=SimpleNamespace(redundant_joint=None))  # type: ignore[arg-type]
    return replace(plan, cell=cell)


def test_a_language_that_cannot_say_it_is_left_out_with_a_note() -> None:
    found = chosen(unable(make_plan(), "rapid"))
    assert found.names == ALWAYS
    assert "programs: the extruder's G-code; no RAPID program: " in found.words and "spherical wrist" in found.words


def test_a_language_that_cannot_say_it_is_refused_where_it_was_asked_for() -> None:
    with pytest.raises(InputError, match=r"rapid cannot say this: .* spherical wrist") as caught:
        chosen(unable(asked("joint_trajectory", "rapid"), "rapid"))
    assert caught.value.field == "program.languages.1"


UR = (
    ("arm: irb140", "arm: ur5e"),
    ("home_deg: [30, 20, 30, 90, -80, 60]", "home_deg: [0, -90, 90, 0, 90, 0]"),
    ("strategy: ladder", "strategy: ladder\nprogram:\n  languages: [joint_trajectory, rapid]"),
)


def test_what_cannot_be_said_is_refused_before_anything_is_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_small(tmp_path, *UR)
    problem = load_problem(path)
    with pytest.raises(InputError) as caught:
        check_languages(problem, build_cell(problem))
    assert (caught.value.file, caught.value.line) == (path, line_of(path, "languages:"))
    assert main([str(path), "--quiet", "--out", str(tmp_path / "out")]) == 2
    assert "program.languages: rapid cannot say this: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("key", ["tool", "work_object"])
def test_what_is_called_as_the_module_is_refused_before_anything_is_planned(key: str) -> None:
    problem = load_problem(small_problem().file, [f"program.{key}=sMall"])
    with pytest.raises(InputError, match=rf"program\.{key}.*also the name of the module"):
        check_languages(problem, build_cell(problem))
    elsewhere = load_problem(small_problem().file, [f"program.{key}=sMall", "program.languages=[joint_trajectory]"])
    check_languages(elsewhere, build_cell(elsewhere))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[rapdi]", "unknown name 'rapdi' .did you mean rapid?"),
        ("[rapid, rapid]", "twice"),
        ("[extruder]", "unknown name"),
        ("[1]", "must be a name, not 1"),
    ],
)
def test_names_that_are_no_languages(tmp_path: Path, value: str, message: str) -> None:
    path = write_small(tmp_path, ("strategy: ladder", f"strategy: ladder\nprogram:\n  languages: {value}"))
    with pytest.raises(InputError, match=message) as caught:
        load_problem(path)
    assert caught.value.line == line_of(path, "languages:")


@pytest.mark.parametrize(
    ("value", "wrong"), [("rapid", ""), ("rapdi", "no language 'rapdi' .did you mean rapid"), ("[]", "no lang")]
)
def test_the_language_of_a_robot_of_ones_own(tmp_path: Path, value: str, wrong: str) -> None:
    for name in ("irb140.yaml", "irb140.urdf"):
        shutil.copy(ROBOTS / name, tmp_path / name)
    path = tmp_path / "irb140.yaml"
    path.write_text(path.read_text().replace("language: rapid", f"language: {value}"))
    if not wrong:
        assert read_robot(path).language == value
        path.write_text(path.read_text().replace(f"language: {value}\n", ""))
        assert read_robot(path).language == USUAL_LANGUAGE
        return
    with pytest.raises(InputError, match=wrong) as caught:
        read_robot(path)
    assert (caught.value.field, caught.value.line) == ("language", line_of(path, "language:"))
