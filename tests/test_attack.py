"""Attacks on purpose: each is a change, always the same one by its number, and what is not found is judged by what it does."""

from __future__ import annotations

import random
import re
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from export_fixtures import make_plan
from solved import bed_plan, small_plan

from benchmarks.attack import cases, clouds, files, in_process, kills, motions, problems, programs, recordings
from benchmarks.attack.cases import ACCEPTED, BUGS, ESCAPED, HARMLESS, REFUSED, STOPPED, Chance, Outcome, one, run
from benchmarks.attack.cases import FOUND as FOUND_BY_IT
from benchmarks.attack.command import kinds as all_kinds
from benchmarks.attack.command import main
from benchmarks.attack.extruder import LINES, attack_gcode, fed_otherwise
from benchmarks.attack.programs import TEXTS, attack_program, played_otherwise
from benchmarks.attack.runs import whole
from benchmarks.attack.text import CHANGES, spoilt_lines
from planner.base.errors import InputError
from planner.export.extruder import gcode
from planner.export.languages import LANGUAGES
from planner.export.rapid.writer import rapid_files
from planner.plan import Plan
from planner.plan.seal import changed_since
from planner.planning.files import write

SEED = 20


def plans(language: str) -> Plan:
    return {"rapid": small_plan, "urscript": lambda: make_plan(beads=1, positioner=False, arm="ur5e")}.get(
        language, bed_plan
    )()


# ---- a slice of the attacks -----------------------------------------------------------------------------------------


def none_escapes(case: Callable[[Chance], Outcome], kind: str, count: int) -> None:
    done = [one(case, kind, number, SEED) for number in range(count)]
    assert [each for each in done if each.verdict == ESCAPED] == []


def test_no_problem_escapes(tmp_path: Path) -> None:
    problems.write_print(tmp_path, **problems.ON_POSITIONER)
    texts = {
        "small": (tmp_path / "small.yaml").read_text("utf-8"),
        "peer": (problems.PROBLEMS / "peer_cap.yaml").read_text("utf-8"),
    }
    (tmp_path / "peer_cap.txt").write_bytes((problems.PROBLEMS / "peer_cap.txt").read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problems, "solved_outcome", lambda problem, what: Outcome(what, ACCEPTED))
        none_escapes(lambda by: problems.attack_problem(texts, tmp_path, by), "problems", 30)


@pytest.mark.slow
def test_no_file_escapes(tmp_path: Path) -> None:
    known = {form: given for form, given in files.inputs().items() if form != "STEP"}
    for name in ("URDF", "robot", "SVG"):
        (tmp_path / known[name].name).write_bytes(known[name].data)
    none_escapes(lambda by: files.attack_file(known, tmp_path, by), "files", 8)


@pytest.mark.slow
def test_no_motion_escapes() -> None:
    none_escapes(lambda by: motions.attack_motion(small_plan(), by), "motions", 2)
    none_escapes(lambda by: motions.attack_plan(small_plan(), by), "plans", 2)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("language", ["rapid", "krl", "fanuc"])
def test_no_program_escapes(language: str) -> None:
    texts = LANGUAGES[language].write(plans(language))
    none_escapes(lambda by: attack_program(language, plans(language), texts, by), language, 8)


def test_no_gcode_escapes() -> None:
    none_escapes(lambda by: attack_gcode(small_plan(), gcode(small_plan()), by), "gcode", 40)


@pytest.mark.slow(keep=("tables-20",))
@pytest.mark.parametrize(("kind", "count"), [("recordings", 6), ("tables", 20), ("clouds", 3)])
def test_no_measurement_escapes(tmp_path: Path, kind: str, count: int) -> None:
    none_escapes(all_kinds()[kind].prepare(tmp_path), kind, count)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("bags", 12), ("runs", 12), ("corrections", 30)])
def test_no_run_escapes(tmp_path: Path, kind: str, count: int) -> None:
    none_escapes(all_kinds()[kind].prepare(tmp_path), kind, count)


# ---- what is spoilt, and how it is judged ------------------------------------------------------------------------------


def test_every_kind_has_its_number_of_cases() -> None:
    counts = {name: kind.count for name, kind in all_kinds().items()}
    assert (counts["problems"], counts["files"], counts["motions"], counts["plans"]) == (1500, 600, 1000, 500)
    assert sum(counts[name] for name in TEXTS) == 2000 and sum(counts[name] > 0 for name in TEXTS) == 5
    assert (counts["gcode"], counts["kills"], counts["determinism"]) == (400, 60, 12)
    assert {counts[name] for name in ("recordings", "bags", "runs", "tables", "corrections", "clouds")} == {300}


@pytest.mark.parametrize("name", recordings.TABLE_CHANGES)
@pytest.mark.parametrize("form", recordings.FORMS)
def test_every_change_of_a_recording_gives_a_table(name: str, form: str) -> None:
    q = np.cumsum(np.random.default_rng(1).normal(0.0, 1e-3, (60, 7)), axis=0)
    table = recordings.Table(4e-3 * np.arange(60), q, q, tuple(f"joint_{k}" for k in range(1, 8)))
    for k in range(4):
        assert recordings.FORMS[form](recordings.TABLE_CHANGES[name](table, random.Random(k))).startswith(b"t")


@pytest.mark.parametrize("name", clouds.POINT_CHANGES)
@pytest.mark.parametrize("form", clouds.FORMS)
def test_every_change_of_a_cloud_can_be_written(name: str, form: str) -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 3))
    for k in range(3):
        assert isinstance(clouds.FORMS[form][1](clouds.POINT_CHANGES[name](points, random.Random(k))), bytes)


def _says(text: str, code: int, out: Path | None = None) -> Callable[[Sequence[str]], int]:
    def main(arguments: Sequence[str]) -> int:
        if out is not None:
            out.mkdir()
            (out / "half.yaml").write_text("name:")
        if text == "warns":
            warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        if text == "hangs":
            time.sleep(30.0)
        print(f"error: {text}", file=sys.stderr)
        return code

    return main


def test_what_a_command_may_not_do_is_an_escape(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(in_process, "LONGEST", 0.5)
    out = tmp_path / "out"

    def verdict(main: Callable[[Sequence[str]], int]) -> str:
        done = in_process.attack_command(main, [], out, ("run.csv",), "x", lambda said: Outcome("x", HARMLESS))
        assert not out.exists()
        return done.verdict

    assert verdict(_says("run.csv: no", 2)) == REFUSED
    assert verdict(_says("", 3)) == FOUND_BY_IT
    assert verdict(_says("", 0, out)) == HARMLESS
    for command in (
        _says("no", 2), _says("run.csv: no", 2, out), _says("run.csv", 1), _says("warns", 0), _says("hangs", 0),
        _says("run.csv: \x1b[2J", 2), _says("run.csv" + "x" * 3000, 2),
    ):  # fmt: skip
        assert verdict(command) == ESCAPED


@pytest.mark.parametrize("name", motions.OF_MOTIONS | motions.OF_PLANS)
def test_every_change_of_a_motion_changes_it(name: str) -> None:
    change = (motions.OF_MOTIONS | motions.OF_PLANS)[name]
    what, changed = change(small_plan(), random.Random(3))
    assert isinstance(what, str) and changed_since(changed)


@pytest.mark.parametrize("language", TEXTS)
def test_every_change_of_a_text_changes_it(language: str) -> None:
    text = TEXTS[language]
    written = max(LANGUAGES[language].write(plans(language)).values(), key=len)
    for k in range(30):
        assert spoilt_lines(written, random.Random(k), re.compile(text.lines), text.words)[1] != written
    for change in CHANGES.values():
        lines = written.splitlines()
        own = [k for k, line in enumerate(lines) if re.search(text.lines, line)]
        change(lines, own, random.Random(5))
        assert isinstance(lines, list)


@pytest.mark.parametrize("form", files.inputs())
@pytest.mark.parametrize("name", files.CHANGES)
def test_every_change_of_a_file_gives_bytes(form: str, name: str) -> None:
    assert isinstance(files.CHANGES[name](files.inputs()[form].data, random.Random(1)), bytes)


def test_an_attack_is_the_same_by_its_number() -> None:
    texts = {"rapid": rapid_files(small_plan())}
    told = [
        one(lambda by: attack_program("rapid", small_plan(), texts["rapid"], by), "rapid", k, SEED) for k in (3, 4, 3)
    ]
    assert told[0] == told[2] != told[1]


def test_filament_is_told_apart_by_amount_time_and_waits() -> None:
    text = "M577 P1 S1\nG1 E1.0 F60\nG4 P500\nG1 E2.0 F60\nM577 P1 S0\n"
    assert fed_otherwise(text, text) == 0.0
    assert fed_otherwise(text, text.replace("E2.0", "E2.5")) == pytest.approx(0.5)
    assert fed_otherwise(text, text.replace("G4 P500\n", "") + "G4 P500\n") == pytest.approx(0.5)
    assert fed_otherwise(text, text.replace("P1 S1", "P2 S1")) == np.inf
    assert spoilt_lines(text, random.Random(1), LINES)[1] != text


def test_a_program_is_told_apart_by_path_order_time_and_outputs() -> None:
    plan = small_plan()
    true = rapid_files(plan)
    name = next(name for name in true if name.endswith(".mod"))

    def told(old: str, new: str) -> str:
        assert old in true[name]
        return played_otherwise(plan, "rapid", true, true | {name: true[name].replace(old, new)})

    assert told("MODULE", "MODULE") == ""
    assert " s of " in told("vel40:=[40,", "vel40:=[20,")
    assert "outputs differ" in told("trgOn,0\\DOp:=doExtrude,1", "trgOn,0\\DOp:=doExtrude,0")
    lines = true[name].splitlines()
    moves = [k for k, line in enumerate(lines) if "MoveL [[" in line]
    # back along the path that is there already: no point of it is off the true one
    lines[moves[-1] : moves[-1]] = [lines[k] for k in (moves[-2], moves[-3])]
    assert played_otherwise(plan, "rapid", true, true | {name: "\n".join(lines) + "\n"})


def test_what_fails_no_check_is_measured() -> None:
    plan = small_plan()
    assert motions.effect(plan, plan.trajectory) == []
    for name in ("bump", "offset", "whole turn", "not laid", "more material", "backwards", "faster"):
        told = [motions.effect(plan, motions.MOVEMENTS[name](plan, random.Random(k))[1].trajectory) for k in range(6)]
        assert any(told) or name in ("whole turn", "backwards", "faster"), name


# ---- processes that die, hang or fail ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_cases_that_die_hang_or_fail_have_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "LONGEST", 1.0)

    def case(by: Chance) -> Outcome:
        if by.number == 1:
            raise KeyError("x")
        if by.number == 2:
            import os

            os._exit(139)
        if by.number == 3:
            time.sleep(60.0)
        return Outcome("nothing", STOPPED if by.number == 4 else HARMLESS)

    done = run("any", case, range(6), 0, 2)
    assert [attack.number for attack in done] == list(range(6))
    verdicts = [attack.outcome.verdict for attack in done]
    assert verdicts == [HARMLESS, ESCAPED, ESCAPED, ESCAPED, STOPPED, HARMLESS]
    assert [attack.outcome.harm.get(BUGS, 0) for attack in done] == [0, 1, 1, 0, 0, 0]
    assert "KeyError" in done[1].words and "exit code 139" in done[2].words and "no end" in done[3].words


def test_results_are_whole_only_as_they_were_written(tmp_path: Path) -> None:
    write(small_plan(), tmp_path)
    assert whole(tmp_path) == ""
    (tmp_path / "Small.mod").write_text("edited")
    assert "Small.mod is not as it was written" in whole(tmp_path)
    (tmp_path / "Small.mod").unlink()
    assert "Small.mod is missing" in whole(tmp_path)


@pytest.mark.slow
def test_two_kills_and_two_runs_elsewhere(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "RUNS", {"a run": ()})
    assert main(["--only", "kills", "determinism", "--count", "2", "--jobs", "1", "--told"]) == 0
    assert "files alike" in capsys.readouterr().out


def test_an_unknown_kind_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--only", "plan"])
    assert ended.value.code == 2 and "there is no kind 'plan': did you mean plans?" in capsys.readouterr().err


# ---- what was found by it, and is refused now --------------------------------------------------------------------------

# language → what of its program, what instead, what is told
FOUND: dict[str, tuple[str, str, str, str]] = {
    "KRL, output at the start": ("krl", r"\$OUT\[1\]=FALSE", "$OUT[4]=FALSE", "other outputs"),
    "KRL, output at the end": ("krl", r"  \$OUT\[1\]=FALSE\n(?=END\n)", "", "other outputs"),
    "URScript, output at the start": ("urscript", r"  set_standard_digital_out\(1, False\)\n(?=  movej)", "", "other outputs"),
    "URScript, output at the end": ("urscript", r"out\(1, False\)(?=\s*end\s*\Z)", "out(2, False)", "other outputs"),
    "FANUC, configuration on the way": ("fanuc", r"(?<=P\[{via}\]\{{\n   GP1:\n\tUF : 9, UT : 9,\t\tCONFIG : ')N", "F", "CONFIG differs"),
    "FANUC, orientation on the way": ("fanuc", r"(?s)(P\[{via}\]\{{.*?W =  )  90", r"\g<1>  91", "orientations at via points"),
    "FANUC, an arc without a way": ("fanuc", r"C P\[{via}\]( +\n +: +)P\[({end})\]", r"C P[\2]\1P[\2]", "bent differs"),
    "URScript, a stop in travel": ("urscript", r"(movej.*), r=0\.00[0-9]+\)", r"\1, r=0)", "stops elsewhere"),
    "FANUC, no stop at the start": ("fanuc", r"(J P\[1\] \d+%) FINE", r"\1 CNT100", "stops elsewhere"),
}  # fmt: skip


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_is_told(name: str) -> None:
    language, old, new, words = FOUND[name]
    plan = plans(language)
    written = LANGUAGES[language].write(plan)
    file = max(written, key=lambda each: len(written[each]))
    if arc := re.search(r"C P\[(\d+)\]\s+: +P\[(\d+)\]", written[file]):
        old = old.replace("{via}", arc[1]).replace("{end}", arc[2]).replace("{{", "{")
    assert LANGUAGES[language].differences(plan, written) == []
    spoilt, count = re.subn(old, new, written[file], count=1)
    assert count == 1
    assert any(words in told for told in LANGUAGES[language].differences(plan, written | {file: spoilt}))


def read(form: str, folder: Path, data: bytes) -> Outcome:
    given = files.inputs()[form]
    (folder / given.name).write_bytes(data)
    (folder / "p.yaml").write_text(given.problem)
    return files.read(folder / "p.yaml", [], form, solved=False, whole=given.whole)


def test_a_vertex_without_a_place_is_refused(tmp_path: Path) -> None:
    data = files.inputs()["DXF"].data
    spoilt = data.replace(b"VERTEX\n8\n0\n10\n25\n20\n11\n", b"VERTEX\n8\n0\n")
    assert spoilt != data
    outcome = read("DXF", tmp_path, spoilt)
    assert outcome.verdict == REFUSED and "drawing.dxf" in outcome.told


@pytest.mark.slow
def test_a_damaged_mesh_prints_no_traceback_of_its_reader(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = files.inputs()["STL"].data.replace(b"facet normal 0 0 1", b"facet normal 0 0 x", 1)
    read("STL", tmp_path, data)
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.slow
def test_knots_that_are_none_are_refused(tmp_path: Path) -> None:
    data = files.inputs()["STEP"].data
    spoilt = data.replace(b"(0.,2.,3.,4.,6.),", b"(0.,2.,3.,x.,6.),")
    assert spoilt != data
    outcome = read("STEP", tmp_path, spoilt)  # what stands there in its place is another number each time
    assert outcome.verdict == ACCEPTED or "plate.step" in outcome.told


@pytest.mark.parametrize("language", programs.ASKED)
def test_true_programs_are_not_told(language: str) -> None:
    plan = plans(language)
    assert LANGUAGES[language].differences(plan, LANGUAGES[language].write(plan)) == []


def test_a_ply_that_calls_its_facets_otherwise_is_refused(tmp_path: Path) -> None:
    """trimesh then looks at a name that it has given to nothing."""
    data = files.inputs()["PLY"].data.replace(b"int vertex_indices", b"int corners")
    outcome = read("PLY", tmp_path, data)
    assert outcome.verdict == REFUSED and "block.ply" in outcome.told


def test_an_arc_that_leaves_the_hall_is_refused(tmp_path: Path) -> None:
    """Its ends are near, and its chords would be 2 TiB."""
    data = (
        files.inputs()["G-code"]
        .data.replace(b"I5 J5", b"I5 J2147483648")
        .replace(b"X100 Y100 F6000", b"X100 Y-101 F6000")
    )
    outcome = read("G-code", tmp_path, data)
    assert outcome.verdict == REFUSED and "the arc comes farther than 100 m" in outcome.told


def test_a_body_that_nothing_fits_into_is_refused(tmp_path: Path) -> None:
    outcome = read("OBJ", tmp_path, files.inputs()["OBJ"].data.replace(b"5.65685", b"0.00565685"))
    assert outcome.verdict == REFUSED and "block.obj is narrower" in outcome.told


def test_a_speed_that_is_none_is_refused() -> None:
    written = rapid_files(small_plan())
    name = next(name for name in written if name.endswith(".mod"))
    spoilt = re.sub(r"(speeddata vel40:=\[40,\d+,)\d+", r"\g<1>0", written[name])
    assert spoilt != written[name]
    with pytest.raises(InputError, match="vel40 has a speed that is not above 0"):
        LANGUAGES["rapid"].differences(small_plan(), written | {name: spoilt})
