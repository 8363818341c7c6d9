"""Lines of numbers without column names: whether they can be x y z nx ny nz, or are plainly something else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array

UNIT_LENGTH = 2e-3  # how far the length of a direction or quaternion may be from 1: files are rounded
_ODD_LENGTH = 0.05  # normals whose lengths are farther from 1 may be something else
_NORMAL, _FIRST_AFTER, _AXES = slice(3, 6), 6, 9  # columns


def meant_otherwise(rows: Sequence[Sequence[float | None]]) -> tuple[str, str]:
    """What lines (n) of numbers hold instead of x y z nx ny nz, and what to write; empty strings if they may be these.

    The signs are vectors of length 1 in every line: a pose matrix, a quaternion, a frame's three axes, or a direction
    in later columns. Lines with only six numbers, or with different counts, show nothing.
    """
    count = len(rows[0]) if rows else 0
    if count <= _FIRST_AFTER or any(len(row) != count or None in row for row in rows):
        return "", ""
    table = np.array(rows, dtype=float)
    write = "the direction against the nozzle: x y z nx ny nz"
    if _matrices(table):
        return "has the matrix of a pose in each line", f"write its position and {write}"
    if count >= _AXES and _orthonormal(table[:, :_AXES]):
        return "has the three axes of a frame in each line, and no point", f"write its position and {write}"
    if _is_unit(table[:, _NORMAL]):
        if count >= 3 + _AXES and _orthonormal(table[:, 3 : 3 + _AXES]):
            return "has a point and the three axes of a frame in each line", f"of the axes, write only {write}"
        return "", ""
    steady = float(np.ptp(np.linalg.norm(table[:, _NORMAL], axis=1))) < UNIT_LENGTH
    for k in range(3, count - 2):
        three = table[:, k : k + 3]
        if _is_unit(three) and not (steady and (np.ptp(three, axis=0) < UNIT_LENGTH).all()):
            named = "name the columns in a line above: x y z nx ny nz, and any others"
            return f"has directions in columns {k + 1} to {k + 3}, not in 4 to 6", named
        if k + 4 <= count and _is_unit(table[:, k : k + 4]):
            at = "" if k == 3 else f" in columns {k + 1} to {k + 4}"
            return f"has a quaternion in each line, as in tool poses{at}", f"write instead {write}"
    return "", ""


def odd_lengths(normals: Array) -> str:
    """A note on normals (n, 3) from unnamed columns if most are not of length 1; empty if they are."""
    length = np.linalg.norm(normals, axis=1)
    if not len(length) or abs(float(np.median(length)) - 1.0) <= _ODD_LENGTH:
        return ""
    return (
        f"columns 4 to 6 are taken for normals, though they are {length.min():.3g} to {length.max():.3g} long: "
        "they are directions, not angles"
    )


def _is_unit(vectors: Array) -> bool:
    """Whether all vectors (n, d) are of length 1."""
    return bool((np.abs(np.linalg.norm(vectors, axis=1) - 1.0) < UNIT_LENGTH).all())


def _orthonormal(nine: Array) -> bool:
    """Whether nine numbers per line (n, 9) are three unit vectors perpendicular to each other."""
    axes = nine.reshape(-1, 3, 3)
    return bool((np.abs(axes @ axes.transpose(0, 2, 1) - np.eye(3)) < UNIT_LENGTH).all())


def _matrices(table: Array) -> bool:
    """Whether lines (n, 12 or 16) are pose matrices, row by row or column by column."""
    count = table.shape[1]
    if count not in (12, 16):
        return False
    four = table.reshape(-1, count // 4, 4)
    rotation: NDArray[np.float64] = four[:, :3, :3].reshape(-1, 9)
    if count == 16:
        last = (four[:, 3], four[:, :, 3])
        if not any(bool((np.abs(each - [0.0, 0.0, 0.0, 1.0]) < UNIT_LENGTH).all()) for each in last):
            return False
    return _orthonormal(rotation)
