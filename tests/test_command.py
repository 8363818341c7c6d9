"""The command line: exit codes, one clear message, and nothing half-written, whatever it is given."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from solved import SVG, line_of, write_small

import planner.planning.pipeline
from planner.base.errors import EXIT_VERIFIED
from planner.base.results import results_folder
from planner.planning.solve_command import main, plan_of_another
from planner.problem import load_problem, shipped_problems

ROOT = Path(__file__).resolve().parents[1]
VERIFIED = {
    "plan.json",
    "trajectory.csv",
    "report_part.stl",
    "Small.mod",
    "Small.pgf",
    "extrusion.gcode",
    "forecast.json",
    "report.html",
    "manifest.json",
}
REFUSED = {"plan.json", "report.html", "manifest.json"}
COMPILING = "compiling kernels, "  # said on stderr where numba's cache is empty
OUT_OF_REACH = ("origin_mm: [633.5, 9.87, 380]", "origin_mm: [1500, 9.87, 380]")

Change = tuple[str, str]


class Outcome:
    """What a run gave back."""

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Outcome]:
    """Run the command line in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: str | Path) -> Outcome:
        capfd.readouterr()
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as stop:  # argparse's own refusals
            code = int(stop.code or 0)
        out, err = capfd.readouterr()
        told = [line for line in err.splitlines(keepends=True) if not line.startswith(COMPILING)]
        return Outcome(code, out, "".join(told))

    return call


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every file, link and folder below a folder, with the files' bytes."""

    def inside(path: Path) -> bytes | None:
        if path.is_symlink():
            return os.fsencode(path.readlink())
        return None if path.is_dir() else path.read_bytes()

    return {path.relative_to(folder).as_posix(): inside(path) for path in sorted(folder.rglob("*"))}


def one_message(outcome: Outcome) -> str:
    """The single line on stderr that says what is wrong; nothing else is there, least of all a traceback."""
    assert "Traceback" not in outcome.err
    lines = [line for line in outcome.err.splitlines() if line.strip()]
    errors = [line for line in lines if "error: " in line or line.startswith("no plan: ")]
    assert len(errors) == 1, outcome.err
    assert [line for line in lines if not line.startswith(("usage:", " "))] == errors, outcome.err
    return errors[0]


def wrong_input(outcome: Outcome, folder: Path, before: dict[str, bytes | None], *fragments: str) -> None:
    """Exit code 2, one message with all the fragments, nothing on stdout, nothing written."""
    assert outcome.code == 2, outcome.err
    message = one_message(outcome)
    assert outcome.out == ""
    assert contents(folder) == before
    for fragment in fragments:
        assert fragment in message


# --- wrong input: code 2 -----------------------------------------------------------------------------------


def test_problem_file_that_is_not_there(run: Callable[..., Outcome], tmp_path: Path) -> None:
    wrong_input(run("nowhere.yaml"), tmp_path, {}, "nowhere.yaml", "no such problem file")
    wrong_input(run("cylinder_lgoo"), tmp_path, {}, "cylinder_lgoo", "did you mean cylinder_logo?")


def test_no_problem_at_all(run: Callable[..., Outcome], tmp_path: Path) -> None:
    wrong_input(run(), tmp_path, {}, "which problem?", "cylinder_logo")


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        ("", ("is empty",)),
        ("name: [unclosed\n", ("is not YAML",)),
        ("\tname: small\n", (":1: is not YAML",)),
        ("- just\n- a list\n", ("a list",)),
        ("name: &a small\ncell: *a\n", (":1: ", "anchor")),
        ("name: !!python/object:os.system small\n", (":1: ", "tag")),
        ("\x00\x01\x02", ("control character",)),
    ],
    ids=["empty", "unclosed", "tab", "list", "anchor", "tag", "binary"],
)
def test_file_that_is_no_problem(
    run: Callable[..., Outcome], tmp_path: Path, text: str, fragments: tuple[str, ...]
) -> None:
    (tmp_path / "odd.yaml").write_text(text, encoding="utf-8")
    wrong_input(run("odd.yaml"), tmp_path, contents(tmp_path), "odd.yaml", *fragments)


FIELDS: dict[str, tuple[Change, str, tuple[str, ...]]] = {
    # what is wrong: change of the file, text of the line that is named, fragments of the message
    "unknown key": (
        ("radius_mm: 34", "raduis_mm: 34"),
        "raduis_mm",
        ("part.cylinder.raduis_mm", "unknown key", "did you mean radius_mm?"),
    ),
    "wrong type": (("height_mm: 100", "height_mm: tall"), "height_mm: tall", ("part.cylinder.height_mm", "'tall'")),
    "list for a number": (("speed_mm_s: 40", "speed_mm_s: [40]"), "speed_mm_s: [40]", ("process.speed_mm_s", "a list")),
    "missing": (("  wrap: cylinder\n", ""), "layers:", ("layers.wrap", "is missing")),
    "negative length": (("radius_mm: 34", "radius_mm: -34"), "radius_mm: -34", ("part.cylinder.radius_mm", "-34")),
    "length of nought": (("width_mm: 30", "width_mm: 0"), "width_mm: 0", ("layers.source.width_mm", "0.1")),
    "NaN length": (("width_mm: 30", "width_mm: .nan"), "width_mm: .nan", ("layers.source.width_mm", "nan")),
    "infinite": (("origin_mm: [633.5", "origin_mm: [.inf"), "origin_mm", ("cell.positioner.origin_mm", "inf")),
    "half a layer": (("count: 1", "count: 0.5"), "count: 0.5", ("layers.count", "0.5")),
    "unknown robot": (("arm: irb140", "arm: irb14"), "arm: irb14", ("cell.arm", "irb14", "did you mean irb140?")),
    "a positioner for an arm": (("arm: irb140", "arm: irbp_a250"), "arm: ", ("cell.arm", "irbp_a250")),
    "unknown positioner": (
        ("robot: irbp_a250", "robot: irbp_a25"),
        "robot: irbp_a25",
        ("cell.positioner.robot", "did you mean irbp_a250?"),
    ),
    "unknown axis": (("free: [rotation]", "free: [rotaton]"), "free:", ("cell.positioner.free", "rotaton", "rotation")),
    "unknown strategy": (
        ("strategy: ladder", "strategy: lader"),
        "strategy: lader",
        ("strategy", "lader", "did you mean ladder?"),
    ),
    "home out of range": (
        ("[30, 20, 30, 90, -80, 60]", "[30, 20, 30, 90, -180, 60]"),
        "home_deg",
        ("cell.home_deg", "joint 5"),
    ),
    "name of another folder": (("name: small", "name: ../../small"), "name: ", ("name", "../../small")),
    "logo wider than the circumference": (
        ("width_mm: 30", "width_mm: 220"),
        "width_mm: 220",
        ("layers.source.width_mm", "220.0 mm wide", "circumference is 213.6 mm"),
    ),
    "logo higher than the cylinder": (
        ("height_mm: 100", "height_mm: 20"),
        "svg: small.svg",
        ("layers.source.width_mm", "higher than the cylinder"),
    ),
}


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize("mistake", FIELDS)
def test_field_that_is_wrong(run: Callable[..., Outcome], tmp_path: Path, mistake: str) -> None:
    change, spot, fragments = FIELDS[mistake]
    file = write_small(tmp_path, change)
    before = contents(tmp_path)
    wrong_input(run("small.yaml"), tmp_path, before, f"small.yaml:{line_of(file, spot)}: ", *fragments)


DRAWINGS: dict[str, tuple[str | bytes, tuple[str, ...]]] = {
    "malformed": (SVG.replace("</svg>", ""), ("small.svg:",)),
    "not XML": (b"GIF89a\x01\x00", ("small.svg",)),
    "an empty file": ("", ("small.svg",)),
    "a drawing of nothing": (
        '<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="24mm"/>',
        ("draws nothing",),
    ),
    "text": (SVG.replace("</svg>", "  <text>Hello</text>\n</svg>"), ("small.svg:5:", "text")),
    "huge coordinates": (SVG.replace("L20,4", "L1e300,4"), ("small.svg:2:", "1e300")),
    "coordinate that is no number": (SVG.replace("L20,4", "Lnan,4"), ("small.svg:2:",)),
    "another file's shape": (
        SVG.replace("</svg>", '  <use href="other.svg#a"/>\n</svg>'),
        ("small.svg:5:", "other.svg#a"),
    ),
    "an image": (SVG.replace("</svg>", '  <image href="/etc/passwd"/>\n</svg>'), ("small.svg:5:", "image")),
    "an entity of another file": (
        '<!DOCTYPE svg [<!ENTITY x SYSTEM "file:///etc/passwd">]>\n' + SVG.replace("</svg>", "&x;</svg>"),
        ("small.svg:1:",),
    ),
    "an entity that grows": (
        '<!DOCTYPE svg [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>\n' + SVG.replace("</svg>", "&b;</svg>"),
        ("small.svg:1:",),
    ),
}


@pytest.mark.parametrize("mistake", DRAWINGS)
def test_drawing_that_is_wrong(run: Callable[..., Outcome], tmp_path: Path, mistake: str) -> None:
    svg, fragments = DRAWINGS[mistake]
    write_small(tmp_path, svg=svg)
    outcome = run("small.yaml")
    wrong_input(outcome, tmp_path, contents(tmp_path), *fragments)
    assert {path.name for path in tmp_path.iterdir()} == {"small.yaml", "small.svg"}


@pytest.mark.parametrize("how", ["missing", "folder"])
def test_drawing_that_is_not_there(run: Callable[..., Outcome], tmp_path: Path, how: str) -> None:
    write_small(tmp_path)
    (tmp_path / "small.svg").unlink()
    if how == "folder":
        (tmp_path / "small.svg").mkdir()
    wrong_input(run("small.yaml"), tmp_path, contents(tmp_path), "small.svg")


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (["--strategy", "lader"], ("--strategy", "lader", "ladder")),
        (["--dt", "soon"], ("--dt", "'soon'", "0.0005 to 0.02")),
        (["--dt", "0"], ("--dt", "'0'")),
        (["--dt", "-0.004"], ("--dt",)),
        (["--dt", "nan"], ("--dt", "'nan'")),
        (["--dt", "inf"], ("--dt", "'inf'")),
        (["--dt", "4"], ("--dt", "'4'")),
        (["--set", "layers.cuont=1"], ("--set layers.cuont", "unknown key", "did you mean count?")),
        (["--set", "layers.count=-1"], ("--set layers.count", "-1")),
        (["--set", "layers.count"], ("--set layers.count", "dotted.key=value")),
        (["--set", "strategy=lader"], ("--set strategy", "did you mean ladder?")),
        (["--set", "cell.arm=irb9000"], ("--set cell.arm", "irb9000")),
        (["--qiuet"], ("--qiuet",)),
        (["another.yaml"], ("another.yaml",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_option_that_is_wrong(
    run: Callable[..., Outcome], tmp_path: Path, options: Sequence[str], fragments: tuple[str, ...]
) -> None:
    write_small(tmp_path)
    wrong_input(run("small.yaml", *options), tmp_path, contents(tmp_path), *fragments)


@pytest.mark.parametrize("out", ["taken", "taken/inside", "dangling", "/proc/nowhere"])
def test_output_folder_that_cannot_be(run: Callable[..., Outcome], tmp_path: Path, out: str) -> None:
    """Told before anything is computed (root writes through permissions, so a file stands in the way)."""
    write_small(tmp_path)
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere" / "at all")
    start = time.perf_counter()
    wrong_input(run("small.yaml", "--out", out), tmp_path, contents(tmp_path), "cannot write", out)
    assert time.perf_counter() - start < 5.0


@pytest.mark.slow
def test_a_folder_stands_where_a_result_would(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    (tmp_path / "results" / "report.html").mkdir(parents=True)
    (tmp_path / "results" / "plan.json").write_text("earlier")
    (tmp_path / "results" / "Small.mod").write_text("earlier")
    wrong_input(run("small.yaml", "--out", "results"), tmp_path, contents(tmp_path), "report.html")


@pytest.mark.slow
def test_disk_that_is_full(run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small(tmp_path)
    assert run("small.yaml", "--out", "results", "--quiet").code == 0
    before = contents(tmp_path)
    real = Path.open

    def full(self: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if self.name.startswith("trajectory.csv") and "w" in mode:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(self, mode, *arguments, **options)

    monkeypatch.setattr(Path, "open", full)
    wrong_input(run("small.yaml", "--out", "results"), tmp_path, before, "No space left on device")


# --- no plan: code 3 ---------------------------------------------------------------------------------------


def refused(outcome: Outcome, folder: Path) -> tuple[str, dict[str, Any]]:
    """Exit code 3, one message, what to try, and only a report and a plan.json that is not verified; returns both."""
    assert outcome.code == 3, outcome.err
    assert "Traceback" not in outcome.err
    first, *tries, last = (line for line in outcome.err.splitlines() if line.strip())
    assert first.startswith("no plan: ")
    assert last == f"see {folder.relative_to(Path.cwd()) / 'report.html'}"
    assert {path.name for path in folder.iterdir()} == REFUSED
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert plan["verified"] is False
    html = unescape((folder / "report.html").read_text(encoding="utf-8"))
    assert plan["refusal"]["reason"].split(" (")[0] in html
    assert tries == [f"try: {hint}" for hint in plan["refusal"]["hints"]]
    assert all(hint in html for hint in plan["refusal"]["hints"])
    return first, plan["refusal"]


def place_in(message: str) -> tuple[int, int, float]:
    """Bead, waypoint and millimetres that a message names."""
    found = re.match(r"no plan: bead (\d+), waypoint (-?\d+), (-?[\d.]+) mm along it: ", message)
    assert found, message
    return int(found[1]), int(found[2]), float(found[3])


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["ladder", "greedy", "fixed", "as_published"])
def test_cylinder_out_of_reach(run: Callable[..., Outcome], tmp_path: Path, strategy: str) -> None:
    write_small(tmp_path, OUT_OF_REACH)
    message, refusal = refused(run("small.yaml", "--strategy", strategy), tmp_path / "out" / "small")
    bead, waypoint, s_mm = place_in(message)
    assert (refusal["bead"], refusal["waypoint"]) == (bead, waypoint)
    assert refusal["s_mm"] == pytest.approx(s_mm, abs=0.06)
    missing = re.search(r"out of the arm's reach by ([\d.]+) mm", message)
    assert missing, message
    assert refusal["missing_mm"] == pytest.approx(float(missing[1]), abs=0.06)


@pytest.mark.slow
def test_how_far_out_of_reach(run: Callable[..., Outcome], tmp_path: Path) -> None:
    """Where the arm is stretched towards the cylinder, 100 mm farther away is nearly 100 mm farther out of reach."""
    gaps = []
    for x in (1500, 1600):
        write_small(tmp_path / str(x), (OUT_OF_REACH[0], f"origin_mm: [{x}, 9.87, 380]"))
        outcome = run(f"{x}/small.yaml", "--out", f"out{x}")
        _, refusal = refused(outcome, tmp_path / f"out{x}")
        gaps.append(refusal["missing_mm"])
    assert gaps[0] > 100.0
    assert gaps[1] - gaps[0] == pytest.approx(100.0, abs=5.0)


LIMITS = "    free: [rotation]\n"


@pytest.mark.slow
@pytest.mark.parametrize("strategy", ["ladder", "greedy", "fixed", "as_published"])
def test_joint_range_that_leaves_no_posture(run: Callable[..., Outcome], tmp_path: Path, strategy: str) -> None:
    """The first three joints hardly leave home, so that the wrist stays where it is."""
    still = "joint_1: {range_deg: [29, 31]}, joint_2: {range_deg: [19, 21]}, joint_3: {range_deg: [29, 31]}"
    write_small(tmp_path, (LIMITS, f"{LIMITS}  limits: {{{still}}}\n"))
    message, refusal = refused(run("small.yaml", "--strategy", strategy), tmp_path / "out" / "small")
    assert refusal["bead"] in (0, 1, 2)
    if strategy != "fixed":  # which looks for one roll for the whole of a bead
        place_in(message)
        assert re.search(r"range.*joint_[123]|joint_[123].*range", message)


@pytest.mark.slow
def test_joints_too_slow_for_the_speed_slow_the_print_down(run: Callable[..., Outcome], tmp_path: Path) -> None:
    """Joints that crawl: every rung has postures, and none is reached in time from the one before."""
    crawl = ", ".join(f"joint_{j}: {{speed_deg_s: 2}}" for j in range(1, 7))
    write_small(tmp_path, (LIMITS, f"{LIMITS}  limits: {{{crawl}, rotation: {{speed_deg_s: 2}}}}\n"))
    outcome = run("small.yaml")
    assert outcome.code == EXIT_VERIFIED, outcome.err
    metrics = json.loads((tmp_path / "out" / "small" / "plan.json").read_text())["metrics"]
    assert metrics["at_speed_fraction"] < 0.1
    assert metrics["deposition_time_s"] > 3.0 * metrics["ideal_deposition_time_s"]


@pytest.mark.slow
def test_every_posture_too_near_a_singularity(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    message, _ = refused(run("small.yaml", "--set", "resolve.min_sigma=0.9"), tmp_path / "out" / "small")
    place_in(message)
    assert "resolve.min_sigma" in message


def test_plan_that_fails_a_check(run: Callable[..., Outcome], tmp_path: Path) -> None:
    """The published way of moving looks at no singularity; the verifier does, and no robot code is written."""
    write_small(tmp_path)
    outcome = run("small.yaml", "--strategy", "as_published", "--set", "resolve.min_sigma=0.3", "--quiet")
    assert outcome.code == 3
    assert "Traceback" not in outcome.err
    assert "FAILED singularity margin" in outcome.out
    assert "NOT verified: no robot code was written" in outcome.out
    folder = tmp_path / "out" / "small"
    assert {path.name for path in folder.iterdir()} == REFUSED | {"trajectory.csv", "report_part.stl"}
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert plan["verified"] is False
    assert [check["name"] for check in plan["checks"] if not check["ok"]] == ["singularity margin"]


# --- what was there before ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_plan_removes_stale_robot_code_and_nothing_else(run: Callable[..., Outcome], tmp_path: Path) -> None:
    file = write_small(tmp_path)
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "photos").mkdir()
    (folder / "photos" / "print.mod").write_text("mine too")
    assert run(file, "--out", folder, "--quiet").code == 0
    assert {path.name for path in folder.iterdir()} == VERIFIED | {"notes.txt", "photos"}

    write_small(tmp_path, OUT_OF_REACH)
    assert run(file, "--out", folder, "--quiet").code == 3
    assert {path.name for path in folder.iterdir()} == REFUSED | {"notes.txt", "photos"}
    assert (folder / "notes.txt").read_text() == "mine"
    assert (folder / "photos" / "print.mod").read_text() == "mine too"


@pytest.mark.slow
def test_plan_that_fails_a_check_removes_stale_robot_code(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    folder = tmp_path / "out" / "small"
    assert run("small.yaml", "--quiet").code == 0
    old = (folder / "plan.json").read_bytes()
    assert run("small.yaml", "--strategy", "as_published", "--set", "resolve.min_sigma=0.3", "--quiet").code == 3
    assert {path.name for path in folder.iterdir()} == REFUSED | {"trajectory.csv", "report_part.stl"}
    assert (folder / "plan.json").read_bytes() != old


@pytest.mark.slow
def test_robot_code_of_a_problem_that_was_renamed_goes(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    assert run("small.yaml", "--out", "results", "--quiet").code == 0
    assert run("small.yaml", "--out", "results", "--quiet", "--set", "name=other").code == 0
    expected = (VERIFIED - {"Small.mod", "Small.pgf"}) | {"Other.mod", "Other.pgf"}
    assert {path.name for path in (tmp_path / "results").iterdir()} == expected


@pytest.mark.slow
def test_robot_programs_of_others_are_left_alone(run: Callable[..., Outcome], tmp_path: Path) -> None:
    """A folder of robot programs is a likely place for results; those programs are not ours to delete."""
    write_small(tmp_path)
    (tmp_path / "robot").mkdir()
    theirs = {"ToolCalibration.mod": "MODULE ToolCalibration\nENDMODULE\n", "Cell.pgf": "<Program/>\n"}
    for name, text in theirs.items():
        (tmp_path / "robot" / name).write_text(text)
    assert run("small.yaml", "--out", "robot", "--quiet").code == 0
    assert {path.name for path in (tmp_path / "robot").iterdir()} == VERIFIED | set(theirs)


@pytest.mark.slow
def test_wrong_input_leaves_earlier_results(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    assert run("small.yaml", "--quiet").code == 0
    write_small(tmp_path, svg=SVG.replace("L20,4", "L1e300,4"))
    before = contents(tmp_path)
    assert run("small.yaml").code == 2
    assert contents(tmp_path) == before


# --- a verified plan: code 0 -------------------------------------------------------------------------------


@pytest.mark.slow(keep=("quiet",))
@pytest.mark.parametrize("quiet", [[], ["--quiet"]], ids=["bars", "quiet"])
def test_verified_plan(run: Callable[..., Outcome], tmp_path: Path, quiet: list[str]) -> None:
    write_small(tmp_path)
    outcome = run("small.yaml", *quiet)
    assert outcome.code == 0
    assert outcome.err == ""  # what is no terminal gets no bars
    folder = tmp_path / "out" / "small"
    assert {path.name for path in folder.iterdir()} == VERIFIED
    assert all(path.stat().st_size > 50 for path in folder.iterdir())
    assert {path.name for path in tmp_path.iterdir()} == {"small.yaml", "small.svg", "out"}
    header = next(line for line in outcome.out.splitlines() if "ladder" in line)
    assert "as_published" in header
    assert re.search(r"at commanded speed.* \d+\.\d+ .* \d+\.\d+ .*%", outcome.out)
    assert re.search(r"verified: \d+ checks hold", outcome.out)
    assert str(Path("out") / "small") in outcome.out


@pytest.mark.slow
def test_table_and_files_agree(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    outcome = run("small.yaml", "--quiet", "--dt", "0.008", "--set", "process.speed_mm_s=30", "--out", "deep/er")
    assert outcome.code == 0
    plan = json.loads((tmp_path / "deep" / "er" / "plan.json").read_text(encoding="utf-8"))
    shown = re.search(r"at commanded speed[^│┃]*[│┃]\s*([\d.]+) [│┃]\s*([\d.]+) ", outcome.out)
    assert shown, outcome.out
    assert float(shown[1]) == pytest.approx(100 * plan["metrics"]["at_speed_fraction"], abs=0.051)
    assert float(shown[2]) == pytest.approx(100 * plan["baseline"]["as_published"]["at_speed_fraction"], abs=0.051)
    assert plan["metrics"]["ideal_deposition_time_s"] == pytest.approx(plan["metrics"]["deposited_length_mm"] / 30.0)
    with (tmp_path / "deep" / "er" / "trajectory.csv").open(encoding="utf-8") as stream:
        times = [float(row["t_s"]) for row in csv.DictReader(stream)]
    assert times[:3] == [0.0, 0.008, 0.016]
    assert plan["settings"]["overrides"] == ["process.speed_mm_s=30"]


@pytest.mark.slow
def test_strategy_on_the_command_line_wins(run: Callable[..., Outcome], tmp_path: Path) -> None:
    write_small(tmp_path)
    outcome = run("small.yaml", "--strategy", "as_published", "--quiet")
    assert outcome.code == 0
    plan = json.loads((tmp_path / "out" / "small" / "plan.json").read_text(encoding="utf-8"))
    assert plan["strategy"] == "as_published"
    assert plan["baseline"] == {}


def test_list_names_what_ships(run: Callable[..., Outcome], tmp_path: Path) -> None:
    outcome = run("--list")
    assert outcome.code == 0
    names = [line.split()[0] for line in outcome.out.splitlines()]
    assert names == list(shipped_problems())
    assert set(names) == {path.stem for path in (ROOT / "problems").glob("*.yaml")}
    assert all(len(line.split()) > 8 for line in outcome.out.splitlines())  # and what each is
    assert "\x1b" not in outcome.out
    assert outcome.err == ""
    assert contents(tmp_path) == {}


# --- in a process of its own -------------------------------------------------------------------------------


def environment(**more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


@pytest.mark.slow
def test_same_input_same_bytes(tmp_path: Path) -> None:
    write_small(tmp_path)
    for seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-m", "planner.solve", "small.yaml", "--quiet", "--out", seed],
            cwd=tmp_path,
            env=environment(PYTHONHASHSEED=seed),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
    first, second = contents(tmp_path / "1"), contents(tmp_path / "2")
    assert set(first) == set(second) == VERIFIED
    for name in ("trajectory.csv", "Small.mod", "Small.pgf", "extrusion.gcode"):
        assert first[name] == second[name], name
    plans = [json.loads((tmp_path / seed / "plan.json").read_bytes()) for seed in ("1", "2")]
    for plan in plans:
        del plan["timing_s"]
    assert plans[0] == plans[1]


@pytest.mark.slow
def test_exit_code_of_the_process(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "planner.solve", "nowhere.yaml"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1


# Runs the command line with one function held up: it leaves a mark, then waits for the interruption.
HELD_UP = """
import sys, time
from pathlib import Path
import planner.base.results, planner.planning.pipeline, planner.planning.solve_command
from planner.base.launch import end, launch

def hold(module, name, before):
    real = getattr(module, name)
    def held(*arguments, **options):
        if not before:
            result = real(*arguments, **options)
        elsewhere = name == "replace" and Path(arguments[1]).parent.name != "results"
        if not elsewhere and not Path("mark").exists():
            Path("mark").touch()
            time.sleep({seconds})
        return real(*arguments, **options) if before else result
    setattr(module, name, held)

hold({module}, {name!r}, {before})
end(launch("solve", {arguments!r}))
"""


def interrupted(
    folder: Path, module: str, name: str, before: bool, seconds: float = 60.0, number: int = signal.SIGINT
) -> Outcome:
    """A signal to a process that is held up before or after a function; the outcome, when it has ended."""
    arguments = ["small.yaml", "--out", "results"]
    script = HELD_UP.format(module=module, name=name, before=before, seconds=seconds, arguments=arguments)
    with subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            deadline = time.monotonic() + 60.0
            while not (folder / "mark").exists():
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < deadline
                time.sleep(0.02)
            process.send_signal(number)
            out, err = process.communicate(timeout=30.0)
        finally:
            process.kill()
    (folder / "mark").unlink()
    nothing_runs_in(folder)
    return Outcome(process.returncode, out, err)


def nothing_runs_in(folder: Path) -> None:
    """No process that was started in a folder is left behind (seen through /proc, where there is one)."""

    def there(process: Path) -> bool:
        try:
            return (process / "cwd").readlink() == folder.resolve()
        except OSError:  # ended meanwhile, or not ours to look at
            return False

    deadline = time.monotonic() + 5.0
    while left := [process for process in Path("/proc").glob("[0-9]*") if there(process)]:
        assert time.monotonic() < deadline, [(process / "cmdline").read_bytes() for process in left]
        time.sleep(0.05)


PLACES = {
    "before the resolving": ("planner.planning.context", "tasks_of", True),
    "before the verifying": ("planner.planning.pipeline", "verify", True),
    "between robot code and report": ("planner.planning.files", "write_robot_code", False),
    "when all is written aside": ("planner.planning.files", "write_plan", False),
}


def put_earlier(folder: Path) -> None:
    """Results as an earlier run left them."""
    with results_folder(folder, "solve") as fresh:
        for name in VERIFIED - {"manifest.json"}:
            (fresh / name).write_text("earlier")


@pytest.mark.parametrize(
    ("there", "told"),
    [
        ("monday/small.yaml", ""),
        ("./monday/../monday/small.yaml", ""),
        ("tuesday/small.yaml", "tuesday/small.yaml"),
        ("small", "small"),
        (None, ""),
    ],
)
def test_the_plan_of_another_file_of_the_same_name_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: str | None, told: str
) -> None:
    """Copies of a problem, as for a part that stands elsewhere, have one folder of results."""
    monkeypatch.chdir(tmp_path)
    problem, folder = load_problem(write_small(Path("monday"))), Path("out/small")
    assert plan_of_another(folder, problem) == ""
    folder.mkdir(parents=True)
    held = {"problem": "small", "problem_file": there, "strategy": "sqp"}
    (folder / "plan.json").write_text(json.dumps(held, indent=1), encoding="utf-8")
    assert plan_of_another(folder, problem) == told
    (folder / "plan.json").write_text("earlier", encoding="utf-8")
    assert plan_of_another(folder, problem) == ""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("place", PLACES)
def test_interruption_leaves_earlier_results(tmp_path: Path, place: str, number: int) -> None:
    write_small(tmp_path)
    put_earlier(tmp_path / "results")
    nothing_came_of_it(tmp_path, place, number)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_interruption_once_results_are_in_place_changes_nothing(tmp_path: Path, number: int) -> None:
    write_small(tmp_path)
    outcome = interrupted(tmp_path, "planner.planning.solve_command", "print_summary", True, seconds=1.0, number=number)
    assert outcome.code == 0 and "interrupted" not in outcome.err and "results" in outcome.out
    assert set(contents(tmp_path / "results")) == VERIFIED


@pytest.mark.slow
def test_interruption_of_a_first_run_leaves_no_folder(tmp_path: Path) -> None:
    write_small(tmp_path)
    nothing_came_of_it(tmp_path, "when all is written aside")


def nothing_came_of_it(folder: Path, place: str, number: int = signal.SIGINT) -> None:
    before = contents(folder)
    outcome = interrupted(folder, *PLACES[place], number=number)
    assert outcome.code == 130
    assert "Traceback" not in outcome.err
    told = [line for line in outcome.err.splitlines() if line.strip() and not line.startswith(COMPILING)]
    assert told == ["interrupted: nothing was written"]
    assert outcome.out == ""
    assert contents(folder) == before


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_interruption_while_files_change_places(tmp_path: Path, number: int) -> None:
    """All of the new files or all of the old ones, and a message that says which."""
    write_small(tmp_path)
    put_earlier(tmp_path / "results")
    outcome = interrupted(tmp_path, "planner.base.results.os", "replace", True, seconds=1.0, number=number)
    assert "Traceback" not in outcome.err
    after = contents(tmp_path / "results")
    assert set(after) == VERIFIED
    new = {name for name, text in after.items() if text != b"earlier"} - {"manifest.json"}
    assert new in (set(), VERIFIED - {"manifest.json"})
    if new:
        assert json.loads(after["plan.json"] or b"")["verified"] is True
        assert "nothing was written" not in outcome.err
    else:
        assert outcome.code == 130


def test_interruption_of_code_that_was_text(tmp_path: Path) -> None:
    """CPython kills a module that is run by SIGINT if an interrupt once left an `exec` of a text, though it was caught."""
    (tmp_path / "interrupted.py").write_text(
        "import sys\n"
        "from planner.base import launch\n"
        "from planner.base.command_line import exit_code\n"
        "def _interrupt() -> None:\n"
        "    raise KeyboardInterrupt\n"
        "def main(arguments: object = None) -> int:\n"
        "    return exit_code(lambda: exec('interrupt()', {'interrupt': _interrupt}), print)\n"
        "if __name__ == '__main__':\n"
        "    launch.COMMANDS['solve'] = launch.CommandModule('interrupted', '')\n"
        "    sys.exit(launch.launch('solve'))\n"
    )
    ended = subprocess.run([sys.executable, "-m", "interrupted"], cwd=tmp_path, env=environment(), capture_output=True)
    assert ended.stdout == b"interrupted: nothing was written\n"
    assert ended.returncode == 130


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_interruption_of_a_real_run(tmp_path: Path, number: int) -> None:
    """Nothing held up: as soon as the folder for the results stands, Ctrl-C, or what a system sends that goes down."""
    with subprocess.Popen(
        [sys.executable, "-m", "planner.solve", "cylinder_logo", "--out", "results"],
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            deadline = time.monotonic() + 60.0
            while not list(tmp_path.glob("results/.beadwise-writing-*")):
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < deadline
                time.sleep(0.01)
            time.sleep(0.3)
            process.send_signal(number)
            out, err = process.communicate(timeout=60.0)
        finally:
            process.kill()
    nothing_runs_in(tmp_path)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "interrupted" in err
    assert out == ""
    assert contents(tmp_path) == {}


def test_a_bug_is_not_hidden(run: Callable[..., Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not the user's to mend stays a traceback, and still nothing is half-written."""
    write_small(tmp_path)
    before = contents(tmp_path)

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(planner.planning.pipeline, "verify", broken)
    with pytest.raises(ZeroDivisionError):
        run("small.yaml", "--quiet")
    assert contents(tmp_path) == before
