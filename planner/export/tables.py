"""trajectory.csv and report_part.stl: every sample, and the body under the print, in common formats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TextIO, cast

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.compiled import inner_njit, njit
from planner.plan.plan import columns_of

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.toolpath.bead import Shape

# ----------------------------------------------------------------------------------------------------
# Rows of numbers as text, compiled: the same bytes as `%` formatting, many times faster.

Bytes = NDArray[np.uint8]

LONGEST_CELL = 24  # bytes, with sign, point and comma
SIGNIFICANT = 12
_EXACT = 2.0**52  # up to here a double holds a rounded fixed-point number digit by digit
_SMALL, _LARGE = 1e-4, 1e5  # outside, %g may write an exponent, or the product below is not accurate enough
_UNSURE = 2e-4  # around a half: rounding is uncertain, as the product is known only to 2^-14
_POWERS = np.array([10.0**k for k in range(16)])  # all exact
_LEAST = np.array([1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5])


def rows_text(fixed: Array, decimals: NDArray[np.int64], free: Array) -> str:
    """Rows of comma-separated numbers: fixed (m, f) with `decimals` (f), then free (m, k) with 12 significant digits.

    Fixed columns are rounded half to even, and zero has no sign; free columns are formatted like `%.12g`.
    """
    m = len(free)
    out = np.empty(m * LONGEST_CELL * (fixed.shape[1] + free.shape[1]), dtype=np.uint8)
    fixed, free = np.ascontiguousarray(fixed) + 0.0, np.ascontiguousarray(free) + 0.0
    scale = np.array([10.0**d for d in decimals.tolist()])
    parts = []
    row = 0
    while row < m:
        row, length = _fill(fixed, decimals, scale, free, row, out)
        parts.append(out[:length].tobytes().decode("ascii"))
        if row < m:  # it has a number that is not finite, very large or small, or too near a half
            parts.append(_plain_row(fixed[row], decimals, scale, free[row]))
            row += 1
    return "".join(parts)


def _plain_row(fixed: Array, decimals: NDArray[np.int64], scale: Array, free: Array) -> str:
    """One row, by Python's own formatting."""
    rounded = np.rint(fixed * scale) / scale + 0.0  # turns minus zero into zero
    cells = [f"{value:.{d}f}" for value, d in zip(rounded.tolist(), decimals.tolist(), strict=True)]
    return ",".join([*cells, *(f"{value:.{SIGNIFICANT}g}" for value in free.tolist())]) + "\n"


@njit
def _fill(
    fixed: Array, decimals: NDArray[np.int64], scale: Array, free: Array, row: int, out: Bytes
) -> tuple[int, int]:
    """Write rows from `row` on into out; returns the first row not written, and the length of the text."""
    at: Any = np.int64(0)  # a plain 0 as an argument has another type, for which kernels would be compiled again
    for i in range(row, len(free)):
        start = at
        for j in range(fixed.shape[1]):
            value = np.rint(fixed[i, j] * scale[j])
            if not abs(value) < _EXACT:
                return i, start
            at = _fixed(int(value), decimals[j], out, at)
            out[at] = 44  # comma
            at += 1
        for j in range(free.shape[1]):
            at = _significant(free[i, j], out, at)
            if at < 0:
                return i, start
            out[at] = 44
            at += 1
        out[at - 1] = 10  # line feed
    return len(free), at


@inner_njit
def _fixed(value: int, decimals: int, out: Bytes, at: int) -> int:
    """Write value / 10^decimals at a place in out; returns the place after it."""
    if value < 0:
        out[at] = 45  # minus
        at += 1
        value = -value
    count, power = decimals + 1, np.int64(1)
    for _ in range(decimals + 1):
        power *= 10
    while value >= power:
        power *= 10
        count += 1
    end = at + count + (1 if decimals else 0)
    k = end
    for digit in range(count):
        if decimals and digit == decimals:
            k -= 1
            out[k] = 46  # point
        k -= 1
        out[k] = 48 + value % 10
        value //= 10
    return end


@inner_njit
def _significant(x: float, out: Bytes, at: int) -> int:
    """Write x with 12 significant digits at a place in out; returns the place after it, or -1 if it cannot be sure."""
    if x == 0.0:
        out[at] = 48
        return at + 1
    size = abs(x)
    if not _SMALL <= size < _LARGE:
        return -1
    exponent = -4
    while size >= _LEAST[exponent + 5]:
        exponent += 1
    # the power is exact, so the product, below 2^40, is rounded once: off by at most 2^-14
    scaled = size * _POWERS[SIGNIFICANT - 1 - exponent]
    whole = np.floor(scaled)
    part = scaled - whole
    if abs(part - 0.5) < _UNSURE:
        return -1
    value = np.int64(whole) + (1 if part > 0.5 else 0)
    if value >= 10**SIGNIFICANT:
        value //= 10
        exponent += 1
    if x < 0.0:
        out[at] = 45
        at += 1
    digits = SIGNIFICANT
    while value % 10 == 0:
        value //= 10
        digits -= 1
    # digits after the point, with zeros leading them or ending the integer part
    after = digits - 1 - exponent
    while after < 0:
        value *= 10
        digits += 1
        after += 1
    count = max(digits, after + 1)
    end = at + count + (1 if after else 0)
    k = end
    for digit in range(count):
        if after and digit == after:
            k -= 1
            out[k] = 46
        k -= 1
        out[k] = 48 + value % 10
        value //= 10
    return end


# ----------------------------------------------------------------------------------------------------
# trajectory.csv: every sample, readable by any spreadsheet or checker.

CHUNK = 4096  # rows formatted at once: bounds the memory
# column → decimals to round to; joints keep 12 significant digits, so that third differences are meaningful
FIXED = {
    "t_s": 6,
    "bead": 0,
    "layer": 0,
    "deposit": 0,
    "s_mm": 5,
    "x_mm": 6,
    "y_mm": 6,
    "z_mm": 6,
    "ax": 9,
    "ay": 9,
    "az": 9,
    "speed_mm_s": 5,
    "flow_mm3_s": 6,
    "e_mm": 6,
}


def write_table(plan: Plan, stream: TextIO) -> None:
    """Write one row per sample to a text stream: mm, mm/s, mm^3/s, joints in rad or (sliding) m; e_mm is filament."""
    t = plan.trajectory
    stream.write(",".join([*FIXED, *plan.cell.joint_names]) + "\n")
    decimals = np.array(list(FIXED.values()), dtype=np.int64)
    for start in range(0, len(t), CHUNK):
        rows = slice(start, start + CHUNK)
        columns = columns_of(t, rows)
        fixed = np.column_stack([columns[name] for name in FIXED])
        stream.write(rows_text(fixed, decimals, t.q[rows]))


# ----------------------------------------------------------------------------------------------------
# report_part.stl: the body under the print as triangles, for pictures and for viewing the trajectory elsewhere.


def part_stl(shape: Shape) -> bytes:
    """A binary STL file of a shape: millimetres, part frame."""
    import trimesh  # takes a third of a second, and most problems have no part of their own

    mesh = trimesh.Trimesh(np.round(shape.vertices * 1e3, 4), shape.triangles, process=False)
    return cast(bytes, mesh.export(file_type="stl"))
