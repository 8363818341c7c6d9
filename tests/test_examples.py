"""The examples of the page "From Python": short, listed, and each runs and says what it is to say."""

from __future__ import annotations

import ast
import re
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner import STRATEGIES

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "examples"
PAGE = FOLDER.parent / "python.md"
# What each tells, and the files that it leaves.
TOLD: dict[str, tuple[str, tuple[str, ...]]] = {
    "01_first_plan": (r"^verified$", ("out/peer_cap/report.html",)),
    "02_changes": (r"80 mm/s +5 deg +\d+\.\d%", ()),
    "03_spiral_from_arrays": (r"peer_cap by sqp: verified", ("out/spiral/plan.json",)),
    "04_layers_from_arrays": (r"verified, .* 8 beads(.|\n)*\(1, 61", ()),
    "05_what_goes_wrong": (r"normals\[7\]: \(0, 0, 0\) has no length(.|\n)*\ntry: cell\.bed_mm", ()),
    "06_own_robot": (r"jerk_rad_s3(.|\n)*irb140 <Plan cylinder_logo by ladder: verified", ("my_arm.yaml",)),
    "07_own_term": (r"0 terms: joint 5 at 8\d deg(.|\n)*1 terms: joint 5 at 9\d deg", ()),
    "08_own_strategy": (r"calm_roll +verified True", ()),
    "09_many_at_once": (r"no plan: bead 0(.|\n)*best: \(0\.45, 0\.0, 0\.25\)", ()),
    "10_save_and_tables": (r"speed_mm_s count(.|\n)*joint_6", ("cap.npz", "out/cap/plan.json", "scene.html")),
}
MOST_LINES = 40


def test_these_are_all_and_short_and_listed() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.py")) == sorted(TOLD)
    page = PAGE.read_text(encoding="utf-8")
    for name in TOLD:
        text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
        assert len(text.splitlines()) < MOST_LINES, name
        assert f"| [{name}](examples/{name}.py) | {ast.get_docstring(ast.parse(text))} |" in page


@pytest.fixture
def own_strategies() -> Iterator[None]:
    before = dict(STRATEGIES)
    yield
    STRATEGIES.clear()
    STRATEGIES.update(before)


@pytest.mark.slow
@pytest.mark.parametrize("name", TOLD)
def test_an_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], own_strategies: None
) -> None:
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    told, files = TOLD[name]
    assert re.search(told, capsys.readouterr().out, re.MULTILINE)
    assert all((tmp_path / file).exists() for file in files)


def test_pieces_of_code_on_the_page_are_python() -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 8
    for block in blocks:
        ast.parse(block)
