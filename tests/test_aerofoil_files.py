"""Section files as the UIUC collection has them, read or refused by line; NACA's formula."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.base.errors import InputError
from planner.problem import find_problem
from planner.toolpath.wing.section import naca_section, read_section

UPPER = [(0.0, 0.0), (0.05, 0.03), (0.2, 0.06), (0.5, 0.055), (0.8, 0.03), (1.0, 0.002)]
LOWER = [(0.0, 0.0), (0.05, -0.02), (0.2, -0.035), (0.5, -0.03), (0.8, -0.015), (1.0, -0.002)]


def rows(points: list[tuple[float, float]]) -> list[str]:
    return [f" {x:.5f}  {z:.5f}" for x, z in points]


SELIG = ["TEST 12%", *rows(UPPER[::-1]), *rows(LOWER[1:])]
LEDNICER = ["TEST 12%", "      6.       6.", "", *rows(UPPER), "", *rows(LOWER)]


def write(folder: Path, lines: list[str]) -> Path:
    path = folder / "section.dat"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_selig_and_lednicer_are_the_same_section(tmp_path: Path) -> None:
    wanted = np.array(UPPER[::-1] + LOWER[1:])
    for lines in (SELIG, LEDNICER):
        assert read_section(write(tmp_path, lines)) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    "lines",
    [
        SELIG[1:],
        ["# made by hand", "", *SELIG, "", ""],
        [line.replace("  ", ", ") if i else line for i, line in enumerate(SELIG)],
        ["TEST", *rows(LOWER[::-1]), *rows(UPPER[1:])],
        ["TEST", "6 6", *rows(LOWER), *rows(UPPER)],
        [*SELIG[:3], SELIG[2], *SELIG[3:]],
        [
            "TEST",
            "by someone",
            "",
            *SELIG[1:],
            "",
            "20 nov 2005",
            "http://example.org",
            "Cm0 -0.05 61",
            "0.1 -> 0.2",
            "7",
        ],
        ["TEST", "-2.0 3.0 -2.5 3.5", *SELIG[1:]],
        ["TEST", *(f"{15 + 80 * x:.4f} {8.7 + 80 * z:.4f}" for x, z in UPPER[::-1] + LOWER[1:])],
    ],
    ids=[
        "no header",
        "comments",
        "commas",
        "lower first",
        "Lednicer lower first",
        "a point twice",
        "words around",
        "bounds",
        "in mm",
    ],
)
def test_other_ways_to_write_it(tmp_path: Path, lines: list[str]) -> None:
    assert read_section(write(tmp_path, lines)) == pytest.approx(np.array(UPPER[::-1] + LOWER[1:]), abs=2e-6)


def test_a_turned_section_is_laid_on_its_chord(tmp_path: Path) -> None:
    points, c, s = np.array(UPPER[::-1] + LOWER[1:]), np.cos(0.1), np.sin(0.1)
    turned = points @ np.array([[c, s], [-s, c]])
    assert read_section(write(tmp_path, rows([(x, z) for x, z in turned]))) == pytest.approx(points, abs=2e-5)


BAD = [
    ([*SELIG[:4], " 0.5", *SELIG[4:]], 5, "two numbers"),
    ([*SELIG[:4], " 0.1 0.2 0.3", *SELIG[4:]], 5, "here are 3 words"),
    ([*SELIG[:4], " 0.1 up", *SELIG[4:]], 5, "'up' is not a number"),
    ([*SELIG[:4], "by someone", *SELIG[4:]], 5, "is not a point, but points follow"),
    ([*SELIG[:4], "a b c", "1 2 3", "", *SELIG[4:]], 5, "is not a point, but points follow"),
    ([*SELIG, " 1.O 0.0"], 13, "'1.O' is not a number"),  # a slip in the last point is not taken for words
    ([*SELIG, " 1.0 (0.0)"], 13, "'(0.0)' is not a number"),
    ([*SELIG, " 1.0 0.0 0.0"], 13, "here are 3 words"),
    ([*SELIG[:4], "-2.0 3.0 -2.5 3.5", *SELIG[4:]], 5, "here are 4 words"),
    ([*SELIG[:4], " nan 0.1", *SELIG[4:]], 5, "that a point can have"),
    ([*SELIG[:4], " 1e300 0.1", *SELIG[4:]], 5, "that a point can have"),
    ([*SELIG[:3], SELIG[1], *SELIG[3:]], 4, "x runs back"),
    ([*SELIG[:-2], " 0.8 0.05", SELIG[-1]], 11, "above the upper side"),
    (SELIG[:-1], 11, "the lower side ends here, at 0.80"),
    ([SELIG[0], *SELIG[2:]], 2, "the upper side ends here, at 0.80"),
    (["TEST", "6 7", *LEDNICER[2:]], 2, "6 and 7 points follow, but there are 12"),
    (SELIG[:7], None, "no leading edge"),
    ([*SELIG[:3], *SELIG[5:]], None, "points on one side"),
    (["TEST"], None, "no points"),
    ([], None, "no points"),
    (["TEST", *["0.5 0.5"] * 20], None, "no leading edge"),
]


@pytest.mark.parametrize(("lines", "line", "reason"), BAD)
def test_what_is_no_section_is_refused(tmp_path: Path, lines: list[str], line: int | None, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        read_section(write(tmp_path, lines))
    assert reason in caught.value.reason
    assert caught.value.line == line
    assert caught.value.exit_code == 2


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), words=st.lists(st.text(alphabet="abz0123456789.-,:/%() \t", max_size=30), max_size=4))
def test_words_around_the_points_change_nothing_and_between_them_are_refused(
    tmp_path: Path, data: st.DataObject, words: list[str]
) -> None:
    """Whatever is added to a file, it gives the same section or is refused: never another one."""
    wanted = read_section(write(tmp_path, SELIG))
    place = data.draw(st.sampled_from([1, len(SELIG)]) if words else st.just(1))
    lines = [*SELIG[:place], *words, *SELIG[place:]]
    numbers = [word for line in words for word in line.replace(",", " ").split() if _is_number(word)]
    try:
        found = read_section(write(tmp_path, lines))
    except InputError as refused:
        assert numbers, "words without any number are no reason"
        assert refused.exit_code == 2
        return
    if any(len(line.replace(",", " ").split()) == 2 for line in words):
        return  # which may be a point
    assert found == pytest.approx(wanted, abs=1e-12)
    between = data.draw(st.integers(2, len(SELIG) - 1))
    if any(line.strip() and not line.strip().startswith(("%", "//")) for line in words):
        with pytest.raises(InputError):
            read_section(write(tmp_path, [*SELIG[:between], *words, *SELIG[between:]]))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def test_files_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "section.dat"
    with pytest.raises(InputError, match="no file"):
        read_section(path)
    path.write_bytes(b"TEST\n\xff\xfe\n")
    with pytest.raises(InputError, match="UTF-8") as caught:
        read_section(path)
    assert caught.value.line == 2
    path.write_bytes(b"1 2\n" * 300_000)
    with pytest.raises(InputError, match="larger than 1 MB"):
        read_section(path)


def test_naca_sections_are_those_of_the_report() -> None:
    """Ordinates in per cent of the chord as NACA report 460 and Abbott and Doenhoff print them."""
    points = 100.0 * naca_section("0015")
    upper = points[: len(points) // 2 + 1][::-1]
    for x, z in ((1.25, 2.367), (5.0, 4.443), (30.0, 7.502), (60.0, 5.704), (90.0, 1.810)):
        assert np.interp(x, *upper.T) == pytest.approx(z, abs=0.01)
    points = 100.0 * naca_section("4412")
    nose = int(np.argmin(np.linalg.norm(points, axis=1)))
    for x, z in ((10.0, 6.59), (30.0, 9.76), (60.0, 8.14), (90.0, 2.71)):
        assert np.interp(x, *points[: nose + 1][::-1].T) == pytest.approx(z, abs=0.03)
    for x, z in ((10.0, -2.86), (30.0, -2.26), (60.0, -1.00)):
        assert np.interp(x, *points[nose:].T) == pytest.approx(z, abs=0.03)


def test_the_shipped_section_is_naca_0015() -> None:
    """The paper's points, and the file that the script beside it writes."""
    folder = find_problem("naca0015_wing").parent
    points = read_section(folder / "naca0015_arigela.dat")
    true = naca_section("0015")
    assert len(points) == 35
    upper = true[: len(true) // 2 + 1][::-1]
    assert np.interp(points[1:16, 0], *upper.T) == pytest.approx(points[1:16, 1], abs=3e-4)
    script: dict[str, object] = {"__name__": "draw", "__file__": str(folder / "draw_aerofoil.py")}
    exec((folder / "draw_aerofoil.py").read_text("utf-8"), script)
    assert (folder / "naca0015_arigela.dat").read_text("utf-8") == script["section"]()  # type: ignore[operator]
