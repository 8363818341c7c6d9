"""Whatever the bytes of a problem file and the text of an override: an InputError or a problem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from problem_text import TEXT, swap
from pydantic import BaseModel

from planner.base.errors import InputError
from planner.problem import load_problem

# Whatever the bytes, an InputError or a problem


def is_sound(value: object) -> bool:
    if isinstance(value, BaseModel):
        return all(is_sound(v) for v in value.__dict__.values())
    if isinstance(value, dict):
        return all(is_sound(v) for v in value.values())
    if isinstance(value, tuple):
        return all(is_sound(v) for v in value)
    return not isinstance(value, float) or math.isfinite(value)


def survives(folder: Path, text: bytes, overrides: Sequence[str] = ()) -> None:
    file = folder / "p.yaml"
    file.write_bytes(text)
    try:
        problem = load_problem(file, overrides)
    except InputError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 600 + len(str(file))
    else:
        assert is_sound(problem)


BITS = st.sampled_from(
    ["& ", "*", "!", "!!x", "?", "- ", ": ", ",", "[", "]", "{", "}", "#", "|", ">", "'", '"', "%", "@", "`", "\\"]
    + ["\n---\n", "...", "<<: ", "null", "true", ".nan", ".inf", "1e999", "-1", "0", "0x1", "1_0", "&a ", "*a"]
    + [
        "\t",
        "\n",
        "\r",
        "\0",
        "\x85",
        "\u2028",
        "\ufeff",
        "%YAML ",
        "%TAG ",
        "\\U",
        '"\\ud800"',
        "é",
        "日",
        " ",
        "\n  ",
    ]
)
folders = pytest.fixture(scope="module")(lambda tmp_path_factory: tmp_path_factory.mktemp("fuzz"))
quick = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@quick
@given(
    st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 12), st.one_of(BITS, st.text(max_size=6))), min_size=1, max_size=4
    )
)
def test_any_mutation_is_refused_or_read(folders: Path, cuts: list[tuple[float, int, str]]) -> None:
    text = TEXT
    for where, length, put in cuts:
        at = int(where * len(text))
        text = text[:at] + put + text[at + length :]
    survives(folders, text.encode("utf-8", "surrogatepass"))


@quick
@given(st.one_of(st.binary(max_size=200), st.lists(BITS, max_size=30).map(lambda bits: " ".join(bits).encode())))
def test_any_bytes_are_refused_or_read(folders: Path, raw: bytes) -> None:
    survives(folders, raw)


KEYS = st.sampled_from(["name", "cell", "cell.home_deg", "cell.limits.joint_1.range_deg", "process.bead", "a", "part"])


@pytest.mark.slow
@quick
@given(st.one_of(st.text(max_size=30), st.tuples(KEYS, st.one_of(BITS, st.text(max_size=20))).map("=".join)))
def test_any_override_is_refused_or_taken(folders: Path, override: str) -> None:
    survives(folders, TEXT.encode(), [override])


@pytest.mark.slow
@quick
@given(
    radius=st.floats(1, 2000),
    count=st.integers(1, 10_000),
    turns=st.floats(-3600, 3600),
    tip=st.tuples(*[st.floats(-1e5, 1e5)] * 3),
)
def test_values_come_back(
    folders: Path, radius: float, count: int, turns: float, tip: tuple[float, float, float]
) -> None:
    text = swap("radius_mm: 34", f"radius_mm: {radius!r}").replace("count: 10", f"count: {count}")
    text = text.replace("-80, 60]", f"-80, {turns!r}]").replace("[-44.51, 9.9, 113.95]", str(list(tip)))
    file = folders / "values.yaml"
    file.write_text(text)
    problem = load_problem(file)
    assert problem.part.cylinder.radius * 1000 == pytest.approx(radius, rel=1e-15)
    assert problem.layers.count == count
    assert problem.cell.home[5] * 180 / math.pi == pytest.approx(turns, rel=1e-14)
    assert tuple(1000 * x for x in problem.cell.nozzle.tip) == pytest.approx(tip, rel=1e-15)
