"""A problem file of one's own: questions to a pipe, answers that are wrong, what is written, copies of what ships."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner.base.errors import InputError
from planner.base.rapid_names import LONGEST_NAME
from planner.base.shipped import PROBLEMS, ROBOTS
from planner.cell.cell import build_cell
from planner.cell.robot import read_robot, robot_names, shipped_robots
from planner.new.command import main
from planner.new.posture import reached
from planner.new.questions import DOWN, WHAT, _read_drawing
from planner.planning.check_command import examine
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.fields import identifier_like

SQUARE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 20"><path d="M0 0h20v20H0z"/></svg>'
DEFAULTS = 20  # empty answers: more than there are questions
# Answers of each kind of print, after name, arm, tip, bore, holder, kind.
KINDS = {
    "pattern": ("zigzag", "8", "30 20", "dome", "50"),
    "drawing": ("square.svg", "60", "cylinder"),
    "waypoints": ("peer_cap.txt",),
    "gcode": ("planar_box.gcode",),
    "mesh": ("saddle_ring.stl",),
    "wing": ("0012",),
}


def run(monkeypatch: pytest.MonkeyPatch, file: Path, *answers: str, more: int = DEFAULTS) -> int:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join([*answers, *[""] * more]) + "\n" * bool(answers or more)))
    return main([str(file)])


@pytest.mark.slow
def test_default_answers_are_accepted_and_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "my_vase.yaml"
    assert run(monkeypatch, file) == 0
    said = capsys.readouterr()
    assert said.out == f"{file}\n"
    assert f"python -m planner.solve {file}" in said.err
    assert list(tmp_path.iterdir()) == [file]
    text = file.read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=")
    assert (tmp_path / text.split("$schema=")[1].split("\n")[0]).resolve().is_file()
    file.unlink()
    assert main([str(file), "--yes"]) == 0
    assert file.read_text(encoding="utf-8") == text
    problem = load_problem(file, ["layers.count=1", "strategy=ladder", "layers.source.size_mm=[20, 20]"])
    assert problem.name == "my_vase"
    assert solve(problem, dt=0.01).verified


@pytest.mark.slow(keep=("pattern",))
@pytest.mark.parametrize("what", WHAT)
def test_every_kind_is_accepted(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("peer_cap.txt", "planar_box.gcode", "saddle_ring.stl"):
        (tmp_path / name).symlink_to(PROBLEMS / name)
    (tmp_path / "square.svg").write_text(SQUARE, encoding="utf-8")
    holder = "irbp_a250" if what == "drawing" else "bed"
    file = tmp_path / "mine.yaml"
    assert run(monkeypatch, file, "", "", "", "", holder, what, *KINDS[what]) == 0
    problem = load_problem(file)
    assert examine(problem).mistakes == ()
    assert (problem.cell.positioner is None) == (holder == "bed")


@pytest.mark.slow
def test_another_arm_has_a_place_and_a_posture_of_which_no_links_touch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mine.yaml"
    assert run(monkeypatch, file, "", "ur5") == 0  # whose best posture has its wrist too near its forearm
    assert load_problem(file).cell.arm == "ur5"


def test_what_can_be_chosen() -> None:
    assert shipped_robots(arms=False) == {
        "gantry_xy": "gantry of 3 by 2 m",
        "irbp_a250": "ABB IRBP A250",
        "track_3m": "linear track of 3 m",
    }
    assert {*shipped_robots(arms=True), "gantry_xy", "irbp_a250", "track_3m"} == set(robot_names())


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize(
    ("answers", "said"),
    [
        (["my print"], "cannot be a name in RAPID"),
        (["", "irb104"], "did you mean irb140?"),
        (["", "", "0 0"], "must be a list of 3 numbers"),
        (["", "", "", "0"], "too small"),
        (["my-print"], "cannot be a name"),
        (["null"], "must be a name"),
        ([*[""] * 6, "", "", "2000 2000"], "there is no place"),
        (["", "", "", "", "table"], "choices: bed, irbp_a250"),
        (["", "", "", "", "", "patern"], "did you mean pattern?"),
        (["", "", "", "", "", "drawing", "nowhere.svg"], "there is no file"),
        (["", "", "", "", "", "drawing", ""], "an answer is needed"),
        (["", "", "", "", "", "wing", "0000"], "not a four-digit section"),
        (["", "", "", "", "", "", "", "", "", "", "", "", "2.5"], "whole number"),
        ([*[""] * 14, "2000 0 0"], "does not reach all of the part there"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_wrong_answers_of_a_pipe(
    answers: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path / "mine.yaml", *answers) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []


def test_a_drawing_is_read_up_to_what_it_draws(tmp_path: Path) -> None:
    file = tmp_path / "text.svg"
    file.write_text(SQUARE.replace("<path", "<text>a</text><path"), encoding="utf-8")
    with pytest.raises(InputError, match="turn text into paths"):
        _read_drawing(file)


def test_a_terminal_is_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stdin = io.StringIO("\nirb104\nirb1600_12\n" + "\n" * DEFAULTS)
    monkeypatch.setattr(stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stdin", stdin)
    assert main([str(tmp_path / "mine.yaml")]) == 0
    assert load_problem(tmp_path / "mine.yaml").cell.arm == "irb1600_12"


@pytest.mark.parametrize("answers", [(), ("mine", "irb140")])
def test_an_end_of_the_input_writes_nothing(
    answers: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, tmp_path / "mine.yaml", *answers, more=0) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_file_that_is_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("mine", encoding="utf-8")
    assert main([str(file), "--yes"]) == 2
    assert run(monkeypatch, file, "no") == 2
    assert run(monkeypatch, file, "") == 2
    assert file.read_text(encoding="utf-8") == "mine"
    assert run(monkeypatch, file, "yes") == 0
    assert load_problem(file).name == "mine"


@pytest.mark.parametrize("name", ["cylinder_logo", "aerofoil_core_tapered", "curved_plate"])
def test_copies_of_what_ships(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "2nd-try.yaml"
    assert main([str(file), "--from", name]) == 0
    problem, model = load_problem(file), load_problem(name)
    assert problem.name == "print_2nd_try"
    assert name == "cylinder_logo" or examine(problem).mistakes == ()
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {line.rsplit("/", 1)[1] for line in capsys.readouterr().out.split()}
    assert len(files) == {"cylinder_logo": 2, "aerofoil_core_tapered": 3, "curved_plate": 2}[name]
    assert problem.process == model.process
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert main([str(file), "--from", name]) == 2  # it is there already
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(("stem", "name"), [("test", "print_test"), ("null", "print_null"), ("7 of 9", "print_7_of_9")])
def test_words_that_name_nothing_are_no_names(stem: str, name: str, tmp_path: Path) -> None:
    assert main([str(tmp_path / f"{stem}.yaml"), "--from", "peer_cap"]) == 0
    assert load_problem(tmp_path / f"{stem}.yaml").name == name
    assert identifier_like(stem, "_print") == (
        f"{name.removeprefix('print_')}_print" if stem[0] != "7" else f"{name}_print"
    )
    assert len(identifier_like("a" * 80, "_print")) <= LONGEST_NAME


def test_a_copy_names_a_rail_where_it_is(tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    for file in (ROBOTS / "track_3m.yaml", ROBOTS / "track_3m.urdf"):
        (own / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    text = (PROBLEMS / "rail_panel.yaml").read_text(encoding="utf-8")
    assert "robot: track_3m " in text
    text = text.replace("robot: track_3m ", "robot: track_3m.yaml ")
    (own / "mine.yaml").write_text(text.replace("rail_panel.txt", str(PROBLEMS / "rail_panel.txt")), encoding="utf-8")
    copy = tmp_path / "copy"
    copy.mkdir()
    assert main([str(copy / "other.yaml"), "--from", str(own / "mine.yaml")]) == 0
    assert build_cell(load_problem(copy / "other.yaml")).rails == 1
    assert not (copy / "track_3m.yaml").exists()


def test_a_copy_does_not_write_over_another_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "logo.svg").write_text("mine", encoding="utf-8")
    assert main([str(tmp_path / "mine.yaml"), "--from", "cylinder_logo"]) == 2
    assert "logo.svg" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["logo.svg"]
    assert main([str(tmp_path / "mine.yaml"), "--from", "cylinder_lego"]) == 2
    assert main([str(tmp_path / "no" / "mine.yaml"), "--yes"]) == 2


def test_what_is_reached() -> None:
    robot = read_robot(ROBOTS / "irb140.yaml")
    tip = np.array([0.0, 0.0, 0.15])
    near = reached(robot, tip, np.array([[0.5, 0.0, 0.1]]), DOWN)
    assert near.worth > 0.5
    assert len(near.postures) > 1
    assert reached(robot, tip, np.array([[0.5, 0.0, 0.1], [2.0, 0.0, 0.1]]), DOWN).worth == 0.0


def test_postures_are_counted_as_the_ranges_are() -> None:
    """An arm whose joints are counted a turn further is reached as well, in postures within its ranges."""
    robot = read_robot(ROBOTS / "irb140.yaml")
    tip, points = np.array([0.0, 0.0, 0.15]), np.array([[0.5, 0.0, 0.1]])
    low, high = robot.model.lowerPositionLimit + 2.0 * np.pi, robot.model.upperPositionLimit + 2.0 * np.pi
    further = robot.model.copy()
    further.lowerPositionLimit, further.upperPositionLimit = low, high
    found = reached(replace(robot, model=further), tip, points, DOWN)
    assert found.worth == pytest.approx(reached(robot, tip, points, DOWN).worth)
    assert len(found.postures) > 1
    assert ((found.postures >= low) & (found.postures <= high)).all()
