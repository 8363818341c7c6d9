"""The report of a table of runs: the same rows give the same text, and what does not hold is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import report
from benchmarks.programs import ASKED, COLUMNS, PLAYED, append_program, read_programs
from benchmarks.rows import Row, Run, append_row, make_row, read_rows
from benchmarks.summary import against_peers, files_of, of_one_commit, results_of
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError

GOLDEN = Path(__file__).parent / "golden" / "benchmark_report.md"
LARGEST_PICTURE = 150_000  # bytes
FIXED = {
    "commit": "0123456789ab", "machine": "Some Processor, 2 cores, 16 GB, Linux x86_64", "date": "2026-11-22T10:00:00",
    "versions": "python 3.11.7, beadwise 0.1.0",
}  # fmt: skip


def plan(
    run: Run, rate: float, sigma: float, at_speed: float = 1.0, waypoints: int = 1000, **values: float | str
) -> Row:
    given: dict[str, float | str] = {
        "seconds_total": 1.1 * waypoints / rate, "seconds_resolve": 0.5, "seconds_verify": waypoints / rate,
        "peak_mb": 500.0, "cpu_s": 3.0, "deposition_time_s": 26.0 / at_speed,
        "ideal_deposition_time_s": 25.0, "bound_deposition_time_s": 25.5, "jerk_ratio_max": 0.975,
        "limit_margin_rad": 0.1, "joint_step_max_rad": 0.02, "position_error_max_mm": 0.0001, **FIXED, **values,
    }  # fmt: skip
    return make_row(
        run, found=True, verified="reason" not in values, waypoints=waypoints, waypoints_per_s=rate, sigma_min=sigma,
        at_speed_fraction=at_speed, **given,
    )  # fmt: skip


def table() -> list[Row]:
    """Two problems, repeats, a plan that does not hold, a refusal, three peers, and a row of another commit."""
    settings = ("process.speed_mm_s=30",)
    cap = [Run("peer_cap", "sqp", (), repeat, "beadwise 0.1.0") for repeat in range(3)]
    return [
        plan(cap[0], 1000.0, 0.2, commit="ba9876543210", date="2026-11-21T10:00:00"),
        *(plan(each, rate, 0.2) for each, rate in zip(cap, (1200.0, 1400.0, 1300.0), strict=True)),
        plan(Run("peer_cap", "greedy", planner="beadwise 0.1.0"), 2000.0, 0.1, 0.5, reason="joint jerk 1.2 of limit"),
        plan(Run("logo", "sqp", settings, planner="beadwise 0.1.0"), 800.0, 0.3, 0.91),
        make_row(Run("logo", "greedy", settings, planner="beadwise 0.1.0"), reason="no plan: bead 0: stuck", **FIXED),
        plan(
            Run("peer_cap", "ladder_10", planner="ladders 1.2, 10°"),
            90.0,
            0.19,
            0.999,
            waypoints=800,
            seconds_resolve=2.0,
        ),
        plan(Run("peer_cap", "sqp, no bodies", planner="beadwise 0.1.0"), 2500.0, 0.2, seconds_resolve=0.1),
        plan(Run("peer_cap", "", planner="steps 0.3"), 9000.0, 0.01, reason="tip on the path 38 mm"),
        plan(Run("logo", "ladder_10", settings, planner="ladders 1.2, 10°"), 100.0, 0.2, 0.95),
    ]


@pytest.mark.slow
def test_the_same_rows_give_the_same_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = tmp_path / "runs.csv", tmp_path / "report"
    for row in table():
        append_row(file, row)
    assert report.main([str(file), "--out", str(folder)]) == EXIT_VERIFIED
    assert capsys.readouterr().out.strip() == str(folder / report.REPORT)
    assert (folder / report.REPORT).read_text(encoding="utf-8") == GOLDEN.read_text(encoding="utf-8")
    pictures = sorted(folder.glob("*.png"))
    assert [picture.name for picture in pictures] == ["margins.png", "rate.png", "speed.png", "success.png"]
    assert all(1000 < picture.stat().st_size <= LARGEST_PICTURE for picture in pictures)


def test_ours_is_set_beside_the_fastest_peer_that_verifies() -> None:
    logo, cap = against_peers(results_of(of_one_commit(table())[0]))
    assert (logo.ours.problem, cap.ours.problem) == ("logo", "peer_cap")
    assert cap.plans is not None and cap.plans.peer.label == "ladder_10"
    # 800 poses take 2 s, and 8.9 s to verify; ours without bodies around 0.1 s, and 0.4 s
    assert cap.plans.ratio == pytest.approx((2.0 + 800 / 90) / (0.1 + 1000 / 2500))
    assert cap.joints is not None and cap.joints.ratio == pytest.approx(2.0 / 0.1)
    assert cap.no_worse == {"σ min": True, "limit margin °": True, "at speed": True}
    assert logo.plans is not None and logo.plans.ratio == pytest.approx((0.5 + 10.0) / (0.5 + 1.25))
    assert logo.no_worse["at speed"] is False and logo.best["at speed"].label == "ladder_10"
    # at best: the peer's 10.5 s beside 1.25 s of verification
    assert logo.ceiling == pytest.approx((0.5 + 10.0) / 1.25)


def test_no_peer_that_verifies_is_no_race() -> None:
    rows = [row for row in table() if row["planner"] != "ladders 1.2, 10°"]
    (cap,) = against_peers(results_of(of_one_commit(rows)[0]))
    assert cap.plans is None and cap.joints is None and cap.ceiling is None and cap.no_worse == {} == cap.best


def test_a_file_without_rows_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report.main([str(tmp_path / "none.csv")]) == EXIT_INPUT
    assert "there is no such file" in capsys.readouterr().err
    (tmp_path / "none.csv").write_text("", encoding="utf-8")
    assert report.main([str(tmp_path / "none.csv")]) == EXIT_INPUT
    assert "has no rows" in capsys.readouterr().err


@pytest.mark.slow
def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    for row in table():
        append_row(tmp_path / "runs.csv", row)
    read = read_rows(tmp_path / "runs.csv")
    assert [row["waypoints"] for row in read] == [row["waypoints"] for row in table()]
    assert read[1]["waypoints_per_s"] == 1200.0 and read[1]["verified"] is True


def files() -> list[Row]:
    """Six files on one cell, of which four are verified, and one on another cell."""
    on = ("cell=peer_cap to fit", "mm, y up")
    shares = (0.9, 1.0, 0.95, 0.99)
    return [
        *(plan(Run(f"{k}.txt", "sqp", on), 900.0, 0.2 + 0.1 * k, share) for k, share in enumerate(shares)),
        plan(Run("near.txt", "sqp", on), 900.0, 0.01, reason="singularity margin 0.01 (limit 0.05)"),
        make_row(Run("far.txt", "sqp", on), reason="no plan: out of reach", **FIXED),
        plan(Run("free.txt", "sqp", ("cell=chen 40 mm/s",)), 900.0, 0.3),
    ]


def test_files_of_others_are_told_together_and_are_no_problems() -> None:
    on_cap, on_chen = files_of([*table(), *files()])
    assert (len(on_cap.rows), len(on_cap.verified), on_cap.failed) == (6, 4, 1)
    assert on_cap.reasons == [("singularity margin 0.01 (limit 0.05)", 1), ("no plan: out of reach", 1)]
    assert on_chen.on == "cell=chen 40 mm/s" and len(on_chen.verified) == 1
    without, lines = report.report(table(), ()), report.report([*table(), *files()], ())
    title = lines.index("## Files that others published")
    own, of_others = len(of_one_commit(table())[0]), len(files())
    assert lines[: title - 1] == [line.replace(f"{own} runs", f"{own + of_others} runs") for line in without]
    assert "| peer_cap to fit | sqp | 6 | 4 | 1 | 1 | 97.0 % | 90.0 % | 1.073 | 0.200 |" in lines[title:]
    assert "    - 1 × no plan: out of reach" in lines[title:]
    alone = report.report(files(), ())
    assert "## Claimed and verified" not in alone and "## By problem and strategy" not in alone


def test_programs_come_back_and_into_the_report(tmp_path: Path) -> None:
    file = tmp_path / "out" / "programs.csv"
    cells = [f"{name}'s" for name in (*ASKED, *PLAYED[1:])]
    append_program(file, ["cap", *cells[1:]], [])
    append_program(file, ["wing, tA", *cells[1:]], ["path 1 mm off", "late"])
    rows = read_programs(file)
    assert [row["problem"] for row in rows] == ["cap", "wing, tA"] and tuple(rows[0]) == COLUMNS
    lines = report.report(table(), (), rows)
    first = lines.index("## Programs in RAPID, read back and played")
    assert lines[first + 2].startswith("Of another commit: ") and lines[-1] == "- wing, tA: path 1 mm off; late"
    assert sum(line.startswith("| cap |") for line in lines[first:]) == 2
    same = [row | {"commit": str(FIXED["commit"]), "differences": ""} for row in rows]
    lines = report.report(table(), (), same)
    assert not any(line.startswith("Of another commit") for line in lines) and "every program repeats" in lines[-1]


@pytest.mark.parametrize("text", ["problem,path\ncap,1\n", ",".join(COLUMNS) + "\ncap\n"])
def test_a_table_of_something_else_holds_no_programs(tmp_path: Path, text: str) -> None:
    file = tmp_path / "programs.csv"
    with pytest.raises(InputError, match="no such file"):
        read_programs(file)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="no row of programs"):
        append_program(file, ["cap"], [])
    assert file.read_text(encoding="utf-8") == text
