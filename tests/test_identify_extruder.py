"""Lag and flow of an extruder from a test line that was weighed or looked at: known truth through noise; bad tables refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.recordings import line_table
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.base.shipped import PROBLEMS
from planner.feedback.identify_command import main
from planner.feedback.identify_extruder import (
    LENGTH,
    FlowLine,
    fit_flow,
    flow_lines,
    line_of,
    line_text,
    problem_text,
    process_values,
    read_asked_line,
    read_table,
    usual_length,
    width_of,
)
from planner.problem import Problem, load_problem
from planner.problem.rewrite import without
from planner.toolpath.build import build_toolpath

PLA = 1240.0  # kg/m³


@cache
def asked(name: str = "peer_cap", *overrides: str) -> tuple[Problem, FlowLine]:
    problem = load_problem(name, overrides)
    return problem, line_of(problem, LENGTH)


def weighed(folder: Path, lag: float, flow: float = 1.0, noise: float = 0.0, seed: int = 1, **more: float) -> Path:
    return line_table(folder / "line.csv", asked()[1], lag, flow, density=PLA, noise=noise, seed=seed, **more)


def looked_at(folder: Path, lag: float, flow: float = 1.0, noise: float = 0.0, seed: int = 1, **more: float) -> Path:
    return line_table(folder / "line.csv", asked()[1], lag, flow, noise=noise, seed=seed, **more)


# ---- known truth --------------------------------------------------------------------------------------------------


@given(lag=st.floats(1e-3, 0.5), s=st.floats(0.0, LENGTH))
def test_what_is_laid_is_the_integral_of_what_is_there(lag: float, s: float) -> None:
    line = asked()[1]
    step = 1e-6
    rate = (line.laid(np.array([s + step]), lag) - line.laid(np.array([s]), lag)) / step
    inside = np.abs(line.ends - s).min() > 2.0 * step
    # of the middle of the step: at the beginning flow may rise within tens of them
    assert not inside or rate[0] == pytest.approx(line.area_at(np.array([s + 0.5 * step]), lag)[0], rel=1e-2, abs=3e-10)
    whole = line.laid(line.ends[-1:], lag)[0]
    assert 0.0 < whole <= (line.area * np.diff(line.ends)).sum() * 1.1


@pytest.mark.parametrize("lag", [0.02, 0.06, 0.15, 0.4])
def test_lag_and_flow_of_a_weighed_line(tmp_path: Path, lag: float) -> None:
    """Segments of 5 mm, on a scale that is off by 0.02 mg."""
    found = fit_flow(read_table(weighed(tmp_path, lag, 0.92, 0.02e-6), asked()[1]), asked()[1], PLA)
    assert found.lag == pytest.approx(lag, abs=max(4e-3, 4.0 * found.lag_error)) and found.lag_error < 0.01
    assert found.flow == pytest.approx(0.92, abs=max(4.0 * found.flow_error, 2e-3)) and found.flow_error < 0.01


@pytest.mark.parametrize("lag", [0.02, 0.06, 0.15, 0.4])
def test_lag_and_flow_of_a_line_that_was_looked_at(tmp_path: Path, lag: float) -> None:
    """A width every millimetre, off by 0.02 mm, and a ruler whose zero is 0.7 mm off."""
    table = read_table(looked_at(tmp_path, lag, 1.08, 0.02e-3, zero=0.7e-3), asked()[1])
    found = fit_flow(table, asked()[1], None)
    assert found.lag == pytest.approx(lag, abs=4e-3) and abs(found.lag - lag) < 4.0 * found.lag_error
    assert found.flow == pytest.approx(1.08, abs=4.0 * found.flow_error)
    assert found.offset == pytest.approx(0.7e-3, abs=0.3e-3)


@pytest.mark.slow
def test_errors_are_as_large_as_the_scatter(tmp_path: Path) -> None:
    line = asked()[1]
    found = [fit_flow(read_table(weighed(tmp_path, 0.12, 1.0, 0.03e-6, seed), line), line, PLA) for seed in range(24)]
    scatter = np.std([each.lag for each in found])
    assert scatter == pytest.approx(np.median([each.lag_error for each in found]), rel=0.5)
    assert np.mean([each.lag for each in found]) == pytest.approx(0.12, abs=2e-3)


def test_a_rounded_bead_is_wider_than_its_section_over_its_height(tmp_path: Path) -> None:
    problem, line = asked("peer_cap", "process.bead.section=rounded")
    assert line.rounded
    file = line_table(tmp_path / "line.csv", line, 0.1, 0.95, noise=0.01e-3)
    found = fit_flow(read_table(file, line), line, None)
    assert found.lag == pytest.approx(0.1, abs=4e-3) and found.flow == pytest.approx(0.95, abs=0.01)
    assert width_of(line.area, line.height, True)[0] == pytest.approx(problem.process.bead.width)


def test_an_extruder_without_a_lag_shows_none(tmp_path: Path) -> None:
    found = fit_flow(read_table(looked_at(tmp_path, 0.0, 1.0, 0.02e-3), asked()[1]), asked()[1], None)
    assert not found.lag_told or found.lag < 4e-3
    assert "lag" in flow_lines(found)[1]


def test_masses_tell_no_flow_without_a_density(tmp_path: Path) -> None:
    problem, line = asked()
    found = fit_flow(read_table(weighed(tmp_path, 0.1, 0.9), line), line, None)
    assert np.isnan(found.flow) and found.lag == pytest.approx(0.1, abs=4e-3)
    assert "flow: not shown by masses without --density" in flow_lines(found)
    assert set(process_values(found, line, problem)) == {"process.extruder"}


def test_a_share_of_the_flow_is_written_as_the_filament_that_is_fed(tmp_path: Path) -> None:
    problem, line = asked()
    found = fit_flow(read_table(weighed(tmp_path, 0.1, 0.81), line), line, PLA)
    values = process_values(found, line, problem)
    assert values["process.filament_diameter_mm"] == pytest.approx(1.75 * 0.9, rel=2e-3)


@pytest.mark.parametrize(
    ("said", "counted"),
    [("", 1.75), ("; filament_diameter = 2.85\n", None), (";FLAVOR:UltiGCode\n", None)],
    ids=["nothing", "a diameter", "a volume"],
)
def test_what_e_of_a_file_counts_is_written_where_the_file_does_not_say_it(
    tmp_path: Path, said: str, counted: float | None
) -> None:
    file, line = tmp_path / "box.gcode", asked()[1]
    file.write_text(said + (PROBLEMS / "planar_box.gcode").read_text("utf-8"), encoding="utf-8")
    found = fit_flow(read_table(weighed(tmp_path, 0.1, 0.9), line), line, PLA)
    values = process_values(found, line, load_problem("planar_gcode", [f"layers.source.gcode={file}"]))
    assert values.get("layers.source.filament_diameter_mm") == counted


# ---- tables -------------------------------------------------------------------------------------------------------


def _replaced(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new, 1)


def _column(factor: float, k: int) -> Callable[[str], str]:
    def change(text: str) -> str:
        head, *rows = text.splitlines()
        out = [row.split(",") for row in rows]
        for row in out:
            row[k] = f"{float(row[k]) * factor:.9g}"
        return "\n".join([head, *(",".join(row) for row in out)])

    return change


def _rows(pick: Callable[[list[str]], list[str]]) -> Callable[[str], str]:
    return lambda text: "\n".join([text.splitlines()[0], *pick(text.splitlines()[1:])])


SPOILT = {
    "empty": (lambda text: "", "holds no table"),
    "no header": (lambda text: text.partition("\n")[2], r":1: no column s_mm"),
    "other name": (_replaced("mass_mg", "mass_g"), r":1: no column s_mm"),
    "no end": (_replaced("to_mm", "till"), r":1: no column to_mm"),
    "word": (_replaced("\n10,", "\nten,"), r":4: from_mm: 'ten' is no number"),
    "nan": (_replaced("\n10,15,", "\n10,nan,"), r":4: to_mm: 'nan' is no number"),
    "comma": (_replaced("\n10,15,", "\n10,15,0,"), r":4: 4 columns, and 3 in the header"),
    "few": (_rows(lambda rows: rows[:5]), "holds 5 rows"),
    "metres": (lambda text: _column(1e-3, 0)(_column(1e-3, 1)(text)), r":2: from_mm: places go from 0 to 0.24 mm"),
    "micrometres": (lambda text: _column(1e3, 0)(_column(1e3, 1)(text)), r":2: from_mm: places go from 0 to 240000 mm"),
    "beyond": (_replaced("\n235,240,", "\n235,260,"), r":49: to_mm: 260 mm is not on the line"),
    "before": (_replaced("\n0,5,", "\n-20,5,"), r":2: from_mm: -20 mm is not on the line"),
    "turned": (_replaced("\n10,15,", "\n15,10,"), r":4: to_mm: ends at 10 mm, where it begins or before"),
    "order": (_rows(lambda rows: [rows[1], rows[0], *rows[2:]]), r":3: from_mm: 0 mm lies before the end of the row above"),
    "no step": (_rows(lambda rows: rows[:9]), r":2: from_mm: no step of flow lies between 0 and 45 mm"),
    "negative": (_replaced("\n10,15,", "\n10,15,-"), r":4: mass_mg: must not be below 0"),
    "grams": (_column(1e-3, 2), "times what was asked"),
    "no mass": (_column(0.0, 2), r":2: mass_mg: holds no mass"),
    "a decimal point": (_replaced("\n10,15,", "\n10,15,99"), r":4: mass_mg: is .* times the line's mean"),
    "endless": (_replaced("\n10,15,", "\n10,15," + "9" * 200_000), r":4: is not CSV: field larger"),
}  # fmt: skip


@pytest.mark.parametrize("mark", [";", "\t", "  "])
def test_columns_are_parted_by_what_the_header_shows(tmp_path: Path, mark: str) -> None:
    file = weighed(tmp_path, 0.1)
    value = read_table(file, asked()[1]).value
    file.write_text(file.read_text().replace(",", mark), encoding="utf-8")
    np.testing.assert_array_equal(read_table(file, asked()[1]).value, value)


@pytest.mark.parametrize("case", SPOILT)
def test_a_table_of_something_else_is_refused(tmp_path: Path, case: str) -> None:
    change, said = SPOILT[case]
    file = weighed(tmp_path, 0.1)
    file.write_text(change(file.read_text()), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        fit_flow(read_table(file, asked()[1]), asked()[1], PLA)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_column(1e3, 1), r":2: width_mm: widths are [0-9.]+ mm on average"),
        (_column(0.0, 1), r":2: width_mm: must be above 0"),
        (_rows(lambda rows: [*rows[:20], *rows[10:]]), r":22: s_mm: 1[0-9](.5)? mm lies before"),
    ],
)
def test_widths_of_something_else_are_refused(tmp_path: Path, change: Callable[[str], str], said: str) -> None:
    file = looked_at(tmp_path, 0.1)
    file.write_text(change(file.read_text()), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_table(file, asked()[1])


@given(text=st.text(alphabet='s_mwidthfro,;\n0.5-e\t "', max_size=300))
def test_any_text_is_read_or_refused(text: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    file = tmp_path_factory.getbasetemp() / "table.csv"
    for head in ("", "s_mm,width_mm\n", "from_mm,to_mm,mass_mg\n"):
        file.write_text(head + text, encoding="utf-8")
        with pytest.raises(InputError):
            read_table(file, asked()[1])


# ---- the line and its files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "overrides", "said"),
    [
        ("fibre_plane", (), "a fibre is as thick as it is fed"),
        ("planar_gcode", (), "the height of beads is in their G-code"),
        ("peer_cap", ("process.extruder.motor=on_off",), "only on or off"),
    ],
)
def test_extruders_whose_flow_cannot_step_are_refused(name: str, overrides: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        line_of(load_problem(name, overrides), LENGTH)


def test_the_line_s_problem_has_the_cell_and_nothing_of_the_print(tmp_path: Path) -> None:
    problem = load_problem("cylinder_logo", ("process.extruder.lag_s=0.1",))
    line = line_of(problem, LENGTH)
    text = problem_text(problem, line, "logo_line", tmp_path)
    assert "waypoints: logo_line.txt" in text and "svg" not in text and "\npart:" not in text
    (tmp_path / "logo_line.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "logo_line.txt").write_text("0 0 0 0 0 1\n1 0 0 0 0 1\n", encoding="utf-8")
    read = load_problem(tmp_path / "logo_line.yaml")
    assert read.process.extruder.lag == 0.0 and read.process.bead.height == problem.process.bead.height
    assert read.cell.model_dump(exclude={"arm"}) == problem.cell.model_dump(exclude={"arm"})


def test_the_line_begins_without_pressure(tmp_path: Path) -> None:
    """Its flow is fitted as one that rises from none; what is pulled back at its end does not matter."""
    text = (PROBLEMS / "cylinder_logo.yaml").read_text("utf-8")
    moves = "prime: {length_mm: 2, speed_mm_s: 25}\n  retract: {length_mm: 2, speed_mm_s: 25}"
    (tmp_path / "logo.svg").write_text((PROBLEMS / "logo.svg").read_text("utf-8"), encoding="utf-8")
    (tmp_path / "primed.yaml").write_text(text.replace("\nprocess:\n", f"\nprocess:\n  {moves}\n"), encoding="utf-8")
    problem = load_problem(tmp_path / "primed.yaml")
    assert problem.process.prime.length == pytest.approx(2e-3)
    line = problem_text(problem, line_of(problem, LENGTH), "logo_line", tmp_path)
    (tmp_path / "logo_line.yaml").write_text(line, encoding="utf-8")
    (tmp_path / "logo_line.txt").write_text("0 0 0 0 0 1\n1 0 0 0 0 1\n", encoding="utf-8")
    process = load_problem(tmp_path / "logo_line.yaml").process
    assert process.prime.length == 0.0 and process.retract == problem.process.retract


def test_the_line_s_problem_has_nothing_of_what_runs_have_taught(tmp_path: Path) -> None:
    """Corrections are of the print's beads."""
    text = (PROBLEMS / "cylinder_logo.yaml").read_text("utf-8")
    (tmp_path / "logo.svg").write_text((PROBLEMS / "logo.svg").read_text("utf-8"), encoding="utf-8")
    (tmp_path / "taught.yaml").write_text(f"{text}\nas_run:\n  corrections: run.csv\n", encoding="utf-8")
    problem = load_problem(tmp_path / "taught.yaml")
    assert "as_run" not in problem_text(problem, line_of(problem, LENGTH), "logo_line", tmp_path)


@pytest.mark.parametrize(
    ("text", "fields", "left"),
    [
        ("a: 1\n# of b\nb:\n  c: 2\n# of d\nd: 3\n", ("b",), "a: 1\n# of b\n# of d\nd: 3\n"),
        ("a: 1\nb:\n  c: 2\n  d: 4\n", ("b.c",), "a: 1\nb:\n  d: 4\n"),
        ("a: {b: 1, c: 2}\n", ("a.b",), "a: {c: 2}\n"),
        ("a: {b: 1, c: 2}\n", ("a.c",), "a: {b: 1}\n"),
        ("a: {b: 1}\nc: 2\n", ("a.b",), "c: 2\n"),
        ("a:\n  b:\n    c: 1\n\n# of d\nd: 2\n", ("a.b.c",), "\n# of d\nd: 2\n"),
        ("a:\n  b: 1\n  c: 2\n# of d\nd: 2", ("a.c", "d"), "a:\n  b: 1\n# of d\n"),
        ("a: 1\nb: 2\n", ("b", "x", "a.y"), "a: 1\n"),
    ],
)  # fmt: skip
def test_fields_are_left_out_of_a_file(text: str, fields: tuple[str, ...], left: str) -> None:
    assert without(text, fields) == left


def test_what_a_line_asks_is_read_back(tmp_path: Path) -> None:
    problem, line = asked()
    file = tmp_path / "asked.json"
    file.write_text(line_text(line), encoding="utf-8")
    read = read_asked_line(file, problem)
    np.testing.assert_allclose(read.ends, line.ends, atol=1e-9)
    np.testing.assert_allclose(read.area, line.area, rtol=1e-5)
    for change, said in (
        ({"format": "x"}, "its format is 'x'"),
        ({"problem": "other"}, "was written for other"),
        ({"ends_mm": [0, 1]}, "does not say what a line asked"),
        ({"speed_mm_s": "quick"}, "does not say what a line asked"),
        ({"speed_mm_s": 0}, "sections without a length or a flow"),
    ):
        data = json.loads(line_text(line)) | change
        file.write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_asked_line(file, problem)


def test_the_command_reads_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _, line = asked()
    weighed(tmp_path, 0.12, 0.9, 0.02e-6)
    Path("peer_cap_line_asked.json").write_text(line_text(line))
    read = ["extruder", "read", "line.csv", "peer_cap", "--density", "1.24"]
    assert main(read) == EXIT_VERIFIED
    said = capsys.readouterr().out
    assert "flow lags the motor by 0.1" in said and "extruder: {lag_s: 0.1" in said
    assert main([*read, "--write", "mine.yaml"]) == EXIT_VERIFIED
    mine = load_problem("mine.yaml").process
    assert mine.extruder.lag == pytest.approx(0.12, abs=4e-3)
    assert mine.filament_diameter == pytest.approx(1.75e-3 * 0.9**0.5, rel=5e-3)
    assert main([*read, "--write", "mine.yaml"]) == EXIT_INPUT and "is there already" in capsys.readouterr().err
    assert main(["extruder", "raed"]) == EXIT_INPUT and "did you mean extruder read" in capsys.readouterr().err
    assert main(["extruder", "read", "line.csv", "cylinder_logo"]) == EXIT_INPUT


def test_a_measured_flow_leaves_the_beads_of_a_file_as_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """E of a file that names no filament counts that of the process, which the extruder no longer feeds."""
    monkeypatch.chdir(tmp_path)
    weighed(tmp_path, 0.12, 0.9, 0.02e-6)
    Path("planar_gcode_line_asked.json").write_text(line_text(replace(asked()[1], problem="planar_gcode")))
    read = ["extruder", "read", "line.csv", "planar_gcode", "--density", "1.24"]
    assert main(read) == EXIT_VERIFIED
    assert "layers:\n  source:\n    filament_diameter_mm: 1.75 " in capsys.readouterr().out
    assert main([*read, "--write", "mine.yaml"]) == EXIT_VERIFIED
    old, new = (load_problem(name, ["layers.count=1"]) for name in ("planar_gcode", "mine.yaml"))
    assert new.process.filament_diameter == pytest.approx(1.75e-3 * 0.9**0.5, rel=5e-3)
    for was, now in zip(build_toolpath(old).beads, build_toolpath(new).beads, strict=True):
        np.testing.assert_array_equal(now.width, was.width)


def test_a_table_that_tells_nothing_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    weighed(tmp_path, 0.0, 1.0, 0.6e-6)
    Path("peer_cap_line_asked.json").write_text(line_text(asked()[1]))
    assert main(["extruder", "read", "line.csv", "peer_cap", "--write", "mine.yaml"]) == EXIT_NOT_VERIFIED
    assert "lag: not shown, at most" in capsys.readouterr().out and not Path("mine.yaml").exists()


@pytest.mark.parametrize(("width", "wanted"), [(0.6e-3, 0.24), (10e-3, 0.24), (30e-3, 0.72)])
def test_a_line_of_wide_beads_is_longer(width: float, wanted: float) -> None:
    """The shortest section of 240 mm, 29 mm, would be as long as a bead of 30 mm is wide."""
    assert usual_length(width) == pytest.approx(wanted)


@pytest.mark.slow
def test_the_command_plans_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["extruder", "write", "planar_gcode", "--bead", "0.6,0.3"]) == EXIT_VERIFIED
    folder = Path("out/planar_gcode_line")
    assert (folder / "plan" / "extrusion.gcode").is_file() and list((folder / "plan").glob("*.mod"))
    line = read_asked_line(folder / "planar_gcode_line_asked.json", load_problem("planar_gcode"))
    table = np.genfromtxt(folder / "plan" / "trajectory.csv", delimiter=",", names=True)
    laid = table["deposit"] > 0
    s, flow = 1e-3 * table["s_mm"][laid], 1e-9 * table["flow_mm3_s"][laid]
    settled = np.abs(s[:, None] - line.ends).min(axis=1) > 3e-3
    wanted = line.speed * line.area[np.searchsorted(line.ends, s) - 1]
    np.testing.assert_allclose(flow[settled], wanted[settled], rtol=0.01)
    for wrong in (["--from", "0,0,0.3", "--to", "1,0,0.3"], ["--normal", "1,0,0"]):
        assert main(["extruder", "write", "peer_cap", *wrong]) == EXIT_INPUT


@pytest.mark.parametrize("is_weighed", [True, False])
def test_a_table_that_does_not_follow_the_line_is_refused(tmp_path: Path, is_weighed: bool) -> None:
    _, line = asked()
    file = weighed(tmp_path, 0.1) if is_weighed else looked_at(tmp_path, 0.1)
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    same = [",".join([*row.split(",")[:-1], rows[-9].split(",")[-1]]) for row in rows]
    file.write_text("\n".join([head, *same]), encoding="utf-8")
    with pytest.raises(InputError, match="does not follow the steps of the line"):
        fit_flow(read_table(file, line), line, PLA if is_weighed else None)


def test_a_number_that_is_too_large_for_a_line_is_refused(tmp_path: Path) -> None:
    problem, line = asked()
    data = json.loads(line_text(line))
    data["height_mm"] = 10**400
    (tmp_path / "asked.json").write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(InputError, match="does not say what a line asked"):
        read_asked_line(tmp_path / "asked.json", problem)
