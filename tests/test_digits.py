"""Numbers as text: the compiled formatter against Python's own, byte for byte."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from solved import small_plan

from planner.export.tables import FIXED, SIGNIFICANT, rows_text, write_table

DECIMALS = np.array([0, 2, 5, 9], dtype=np.int64)
ANY = st.floats(allow_nan=True, allow_infinity=True)
JOINTS = st.floats(-7.0, 7.0)
# numbers of few digits, and what lies a hair beside a half of the last digit that is written
SHORT = st.builds(lambda k, e: k / 10.0**e, st.integers(-(10**6), 10**6), st.integers(0, 12))
HALVES = st.builds(
    lambda k, e, ulps: _moved((k + 0.5) / 10.0**e, ulps),
    st.integers(10**11, 10**12),
    st.integers(7, 15),
    st.integers(-2, 2),
)


def _moved(value: float, ulps: int) -> float:
    for _ in range(abs(ulps)):
        value = math.nextafter(value, math.inf if ulps > 0 else -math.inf)
    return value


def _expected(fixed: np.ndarray, decimals: np.ndarray, free: np.ndarray) -> str:
    lines = []
    for a, b in zip(fixed, free, strict=True):
        cells = [f"{np.round(v, d) + 0.0:.{d}f}" for v, d in zip(a, decimals, strict=True)]
        lines.append(",".join([*cells, *(f"{v + 0.0:.{SIGNIFICANT}g}" for v in b)]) + "\n")
    return "".join(lines)


@given(st.lists(JOINTS | SHORT | HALVES | ANY, min_size=1, max_size=12))
@example([0.0, -0.0, 1.0, -1.0, 0.1, 1e-4, 9.99999999999951e-5, 9.9999999999995, 99999.99999995, 1e5, 123456.5])
@example([0.5, 1.5, 2.5, -0.5, 0.125, 1e15, 2.0**52, 2.0**52 - 0.5, 1e22, 5e-324, math.pi])
@example([9.99999999999949, 9.9999999999996, 0.00099999999999999, 99999.999999999, 10.0, 100.0, 1000.0, 12345.0])
def test_text_is_pythons_own(values: list[float]) -> None:
    free = np.array(values)[:, None]
    fixed = np.repeat(free, len(DECIMALS), axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        assert rows_text(fixed, DECIMALS, free) == _expected(fixed, DECIMALS, free)


@pytest.mark.parametrize("span", [1e-3, 0.3, 3.0, 400.0])
def test_text_of_many_numbers(span: float) -> None:
    rng = np.random.default_rng(7)
    free = rng.uniform(-span, span, (4000, 3))
    free[::5] = np.round(free[::5], 3)
    fixed = rng.uniform(-span, span, (4000, len(DECIMALS)))
    assert rows_text(fixed, DECIMALS, free) == _expected(fixed, DECIMALS, free)


def test_no_rows_no_text() -> None:
    assert rows_text(np.empty((0, 4)), DECIMALS, np.empty((0, 2))) == ""


def test_whole_table_is_what_formatting_row_by_row_writes() -> None:
    plan = small_plan()
    t = plan.trajectory
    stream = io.StringIO()
    write_table(plan, stream)
    lines = stream.getvalue().splitlines()
    assert lines[0].split(",") == [*FIXED, *plan.cell.joint_names]
    assert len(lines) == len(t) + 1
    one = (t.t, t.bead, t.layer, t.deposit, t.s * 1e3, *(t.tip.T * 1e3), *t.axis.T, t.speed * 1e3, t.flow * 1e9)
    columns = [*one, t.feed * 1e3]
    for k in range(0, len(t), 7):
        fixed = [f"{round(float(c[k]), d) + 0.0:.{d}f}" for c, d in zip(columns, FIXED.values(), strict=True)]
        assert lines[k + 1] == ",".join([*fixed, *(f"{q + 0.0:.12g}" for q in t.q[k])])
