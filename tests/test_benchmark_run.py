"""The table of all benchmarks: its rows whatever becomes of a run, its file when it is torn, and the run that goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import named, rows, run, single
from benchmarks.own_process import Ended, in_own_process
from benchmarks.rows import COLUMNS, KEY, Row, Run, append_row, make_row, read_rows
from benchmarks.usage import Usage, commit, cpu_seconds, machine, peak_mb
from planner.base.errors import EXIT_INPUT, EXIT_INTERRUPTED, EXIT_VERIFIED, InputError
from planner.cell.cell import Limits
from planner.plan.measures import METRICS
from planner.resolve.strategies import STRATEGIES

PROBLEMS, CHOSEN = ("peer_cap@60", "peer_cylinder@60"), ("greedy", "ladder")
GRID = ["--problems", *PROBLEMS, "--strategies", *CHOSEN, "--coarse"]
OF_TIME = {"waypoints_per_s", "cpu_s", "peak_mb", "date", *(name for name in COLUMNS if name.startswith("seconds_"))}


def test_steps_and_margins_are_of_joints_that_turn() -> None:
    bead = SimpleNamespace(s=np.array([0.0, 0.5, 1.0]))
    q = np.array([[0.0, 0.1], [0.9, 0.2], [1.999, 0.4]])  # a rail, and a joint
    motion = SimpleNamespace(bead=np.zeros(3, dtype=np.int32), first_bead=0, s=bead.s, q=q)
    one = np.ones(2)
    found = rows.at_waypoints([bead], motion, Limits(-2.0 * one, 2.0 * one, one, one, one, sliding=(0,)))
    assert found == pytest.approx({"joint_step_max_rad": 0.2, "limit_margin_rad": 1.6})


def cold(job: single.Job) -> Row:
    """A run in this process, which need not be warm."""
    return single.measured(job[0], warm=False)


def plans(table: list[Row]) -> list[Row]:
    """What does not depend on the clock, in order of runs."""
    kept = [{name: value for name, value in row.items() if name not in OF_TIME} for row in table]
    return sorted(kept, key=lambda row: str([row[name] for name in KEY]))


def ran(*arguments: str) -> int:
    return run.main([*GRID, *arguments])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    """Two small problems by two strategies."""
    file = tmp_path_factory.mktemp("whole") / "runs.csv"

    def not_asked_for(*_: object) -> None:
        raise AssertionError("the baseline was planned")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "run_apart", cold)
        patch.setitem(STRATEGIES, "as_published", not_asked_for)
        assert ran("--out", str(file)) == EXIT_VERIFIED
    return read_rows(file)


@pytest.mark.slow
def test_a_row_for_each_run(whole: list[Row]) -> None:
    assert [(row["problem"], row["strategy"]) for row in whole] == [(p, s) for p in PROBLEMS for s in CHOSEN]
    for row in whole:
        assert tuple(row) == COLUMNS
        assert row["found"] and (row["verified"] or row["reason"])
        assert row["planner"] == single.beadwise() and row["commit"] == commit() and row["machine"] == machine()
        assert float(row["waypoints_per_s"]) * float(row["seconds_total"]) > float(row["waypoints"]) > 50
        assert 0.0 < float(row["joint_step_max_rad"]) < 0.3 and float(row["limit_margin_rad"]) > 0.0
        assert float(row["limit_margin_rad"]) >= float(row["joint_limit_margin_deg"]) / 57.2958 - 1e-3
        assert float(row["cpu_s"]) > 0.1 and float(row["peak_mb"]) > 100.0
    assert any(row["verified"] for row in whole)


def test_every_metric_and_every_stage_has_a_column() -> None:
    assert set(METRICS) <= set(COLUMNS)
    assert len(set(COLUMNS)) == len(COLUMNS)
    with pytest.raises(ValueError, match="seconds_thinking"):
        make_row(Run("peer_cap", "sqp"), seconds_thinking=1.0)


@pytest.mark.slow
def test_an_interrupted_run_goes_on_where_it_ended(
    whole: list[Row], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, asked = tmp_path / "runs.csv", []
    by_run = {(row["problem"], row["strategy"]): row for row in whole}

    def remembered(job: single.Job) -> Row:
        asked.append(job[0])
        if len(asked) == 3:
            raise KeyboardInterrupt
        return by_run[job[0].problem, job[0].strategy]

    monkeypatch.setattr(run, "run_apart", remembered)
    assert ran("--out", str(file)) == EXIT_INTERRUPTED
    assert len(read_rows(file)) == 2
    assert f"what is done is in {file}" in capsys.readouterr().err
    assert ran("--out", str(file)) == EXIT_VERIFIED
    assert len(asked) == 5 and plans(read_rows(file)) == plans(whole)
    assert ran("--out", str(file)) == EXIT_VERIFIED and len(asked) == 5
    assert ran("--out", str(file), "--anew") == EXIT_VERIFIED and len(asked) == 9
    monkeypatch.setattr(run, "commit", lambda: "0123456789ab")
    capsys.readouterr()
    assert ran("--out", str(file)) == EXIT_VERIFIED and len(asked) == 13
    assert "8 rows in it are of another commit" in capsys.readouterr().err


@pytest.mark.slow
def test_a_crash_and_a_refusal_are_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("of nothing")

    monkeypatch.setitem(STRATEGIES, "ladder", broken)
    crashed = single.measured(Run("peer_cap@60", "ladder"), warm=False)
    assert not crashed["found"] and str(crashed["reason"]).startswith("crashed: ZeroDivisionError('of nothing') in ")
    assert float(crashed["seconds_load"]) > 0.0 and crashed["sigma_min"] == "" and crashed["waypoints_per_s"] == ""
    refused = single.measured(Run("rail_panel", "nlp"), warm=False)
    assert str(refused["reason"]).startswith("no plan: strategy nlp does not support sliding joints")


@pytest.mark.slow
def test_a_run_has_a_process_of_its_own() -> None:
    row = single.run_apart((Run("per_cap", "ladder"), None))
    assert row["reason"] == "refused: per_cap: there is no such problem file (did you mean peer_cap?)"
    assert float(row["peak_mb"]) > 50.0


ENDS = {
    "well": ("open(sys.argv[1], 'w').write(sys.argv[2])", Ended("given", "", 0.0)),
    "slow": ("time.sleep(60)", Ended("", "longer than 0.5 s", 0.0)),
    "killed": ("os.kill(os.getpid(), 9)", Ended("", "killed (signal 9), probably for want of memory", 0.0)),
    "says": ("sys.exit('no such luck')", Ended("", "crashed: ended with exit code 1: no such luck", 0.0)),
}


@pytest.mark.parametrize("name", ENDS)
def test_however_a_process_ends_it_is_told(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, ended = ENDS[name]
    (tmp_path / "ends.py").write_text(f"import os, sys, time\n{code}\n", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert in_own_process("ends", ["given"], 0.5 if name == "slow" else 30.0) == ended


@pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
def test_a_process_ends_with_the_one_that_watches_it(tmp_path: Path) -> None:
    code = (
        f"import os, time\nfrom benchmarks.own_process import end_with_parent\nopen({str(tmp_path / 'id')!r}, 'w')"
        ".write(str(os.getpid()))\nend_with_parent()\ntime.sleep(60)\n"
    )
    (tmp_path / "sleeper.py").write_text(code, encoding="utf-8")
    watch = "from benchmarks.own_process import in_own_process as run; run('sleeper', [])"
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.getcwd()}"}
    watcher = subprocess.Popen([sys.executable, "-c", watch], env=environment)
    until = time.monotonic() + 30.0
    while not (tmp_path / "id").is_file() or not (tmp_path / "id").read_text():
        assert time.monotonic() < until
        time.sleep(0.02)
    sleeper = Path("/proc") / (tmp_path / "id").read_text()
    assert sleeper.exists()
    watcher.send_signal(signal.SIGKILL)
    watcher.wait()
    while sleeper.exists() and "Z (" not in (sleeper / "status").read_text():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_torn_last_line_is_not_read_and_cut_off(tmp_path: Path) -> None:
    file, row = (
        tmp_path / "runs.csv",
        make_row(Run("peer_cap", "sqp", ("a=1", 'b="x, y"')), reason='said\n"no"', beads=2.5),
    )
    append_row(file, row)
    whole = file.read_bytes()
    file.write_bytes(whole + whole.splitlines(keepends=True)[1][:-3])
    assert len(read_rows(file)) == 1
    append_row(file, row)
    assert file.read_bytes() == whole + whole.splitlines(keepends=True)[1]
    read = read_rows(file)[1]
    assert (read["set"], read["reason"], read["beads"], read["found"]) == ('a=1; b="x, y"', 'said "no"', 2.5, False)
    file.write_bytes(whole[:20])  # torn within the header
    assert read_rows(file) == []
    append_row(file, row)
    assert file.read_bytes() == whole


def test_what_is_no_table_is_told_by_line(tmp_path: Path) -> None:
    file = tmp_path / "runs.csv"
    file.write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"runs\.csv:1: is no table of runs: it has no column 'problem'"):
        read_rows(file)
    with pytest.raises(InputError, match=r"does not have the columns"):
        append_row(file, make_row(Run("peer_cap", "sqp")))
    assert file.read_text(encoding="utf-8") == "a,b\n1,2\n"
    file.unlink()
    append_row(file, make_row(Run("peer_cap", "sqp"), sigma_min=0.5))
    file.write_text(file.read_text(encoding="utf-8").replace(",0.5,", ",half,"), encoding="utf-8")
    with pytest.raises(InputError, match=r"runs\.csv:2: sigma_min: 'half' is no value"):
        read_rows(file)
    file.write_text(file.read_text(encoding="utf-8") + "peer_cap,sqp\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"runs\.csv:[23]: "):
        read_rows(file)


def test_a_table_of_an_older_version_is_told_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, asked = tmp_path / "runs.csv", []
    file.write_text(",".join(KEY) + "\n", encoding="utf-8")
    monkeypatch.setattr(run, "run_apart", asked.append)
    assert read_rows(file) == []
    assert ran("--out", str(file)) == EXIT_INPUT and asked == []
    assert "runs.csv:1: does not have the columns that this version writes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--problems", "peer_cup"], "did you mean peer_cap?"),
        (["--problems", "peer_cup@100"], "did you mean peer_cap@100?"),
        (["--problems", "peer_cap@many"], "such as peer_cap@10000"),
        (["--problems", "peer_cap", "--set", "proces.speed_mm_s=30"], "did you mean process?"),
    ],
)
def test_bad_names_are_told_before_anything_runs(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run.main([*arguments, "--out", str(tmp_path / "runs.csv")]) == EXIT_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "runs.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--strategies", "lader"], "did you mean ladder?"),
        (["--limit", "-1"], "above 0"),
        (["--repeat", "0"], "from 1"),
    ],
)
def test_bad_options_are_told(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        run.main(arguments)
    assert said in capsys.readouterr().err


def test_the_usual_grid_has_all_that_ships_and_no_slow_reference() -> None:
    options = run.parser().parse_args([])
    assert set(options.problems) == {*named.shipped_problems(), "peer_cap@10000", "peer_cylinder@10000"}
    assert set(options.strategies) == set(STRATEGIES) - {"nlp"}


def test_usage_counts_up() -> None:
    before = cpu_seconds()
    while cpu_seconds() == before:
        sum(range(1000))
    assert peak_mb() > 10.0
    assert make_row(Run("peer_cap", "sqp"), Usage(1.5, 20.0))["cpu_s"] == 1.5
    assert rows.text_of(float("nan")) == "" and rows.text_of(True) == "yes"
