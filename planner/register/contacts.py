"""Files of contacts: where the nozzle's tip was when it touched the part; and Pollard's turntable from them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import block_array, coo_array, eye_array

from planner.base.arrays import MAD_TO_SIGMA, Array, Flags, ReadOnlyArrays
from planner.base.errors import Complaint, InputError, nearest_name
from planner.base.tables import is_number, rows_of, separator_of, split_row
from planner.cell.cell import Cell

# ----------------------------------------------------------------------------------------------------
# Files of contacts: where the nozzle's tip was when it touched the part, as read from the robot's display.

TIP, AXIS = ("x", "y", "z"), ("ax", "ay", "az")
NAMES = ("name", "contact")
LARGEST_FILE = 2_000_000  # bytes
MOST_CONTACTS = 2_000  # touched one by one; more would be a scan, and take minutes
FARTHEST = {"mm": 1e5, "deg": 3600.0, "": 1e6}  # a hall of 100 m, ten turns, a direction of any length
LENGTHS = {"mm": 1e-3, "m": 1.0, "inches": 25.4e-3, "cm": 1e-2}
ANGLES = {"degrees": math.pi / 180.0, "radians": 1.0}
_BRACKETS = re.compile(r"\s*[\[(]\s*([a-z°]+)\s*[\])]")
_UNIT = re.compile(r"(.+)_(mm|cm|m|in|inch|inches|deg|rad)")


@dataclass(frozen=True)
class Readings(ReadOnlyArrays):
    """The readings in a file of contacts (n of them), in its own units.

    file, lines (n), names (n)   line of each, counted from 1, and its name
    tips (n, 3)      the tip in the world [mm]; or instead
    joints (n, a)    the arm's joints [deg; mm for sliding ones]
    axes (n, 3)      directions in which the nozzle points, if the file has them
    holder (n, k)    free axes of the part's holder [deg, mm]
    """

    file: Path
    lines: NDArray[np.int64]
    names: tuple[str, ...]
    tips: Array | None
    joints: Array | None
    axes: Array | None
    holder: Array


@dataclass(frozen=True)
class Contacts(ReadOnlyArrays):
    """Places (n) that the nozzle touched.

    tips (n, 3)    in the world [m];  T_world_plate (n, 4, 4) of the plate that the part is on then, as in the problem
    axes (n, 3)    unit directions of the nozzle in the world, if known
    """

    names: tuple[str, ...]
    lines: NDArray[np.int64]
    file: Path
    tips: Array
    axes: Array | None
    T_world_plate: Array

    def __len__(self) -> int:
        return len(self.tips)


def read_readings(file: Path, cell: Cell) -> Readings:
    """Read a CSV file of contacts made in this cell.

    A header names the columns: x_mm y_mm z_mm, or the arm's joints by name in degrees, or mm for sliding ones; the free
    axes of the part's holder; optionally name, and ax ay az, the nozzle's direction. Columns are separated by commas,
    semicolons, tabs or blanks. Raises InputError with file, line and column for whatever is wrong.
    """
    rows = rows_of(file, LARGEST_FILE)
    if not rows:
        raise InputError("holds no contacts", file=file, hint=_expected(cell))
    head_line, head = rows[0]
    separator = separator_of(head)
    wrong = partial(InputError, file=file, line=head_line)
    words = split_row(head, separator, wrong)
    if all(is_number(word) for word in words):
        raise wrong("a header that names the columns is missing", hint=_expected(cell))
    places = _places(words, cell, wrong)
    if len(rows) == 1:
        raise InputError("holds no contacts below its header", file=file, line=head_line)
    if len(rows) - 1 > MOST_CONTACTS:
        raise InputError(f"holds {len(rows) - 1} contacts", file=file, hint=f"at most {MOST_CONTACTS}")
    name_at = next((places.pop(name) for name in NAMES if name in places), None)
    names, table = [], []
    for line, text in rows[1:]:
        cells = split_row(text, separator, partial(InputError, file=file, line=line))
        if len(cells) != len(words):
            count = f"{len(cells)} value{'s' if len(cells) != 1 else ''}"
            hint = "a decimal point, not a comma, between columns as in the header"
            raise InputError(
                f"the header names {len(words)} columns; here are {count}", file=file, line=line, hint=hint
            )
        table.append([_number(cells[k], column, _unit(column, cell), file, line) for column, k in places.items()])
        names.append(str(len(table)) if name_at is None else cells[name_at][:20])
    columns = dict(zip(places, np.array(table).T, strict=True))
    numbers = np.array([line for line, _ in rows[1:]], dtype=np.int64)
    return _readings(file, numbers, tuple(names), columns, cell)


def _readings(
    file: Path, lines: NDArray[np.int64], names: tuple[str, ...], columns: dict[str, Array], cell: Cell
) -> Readings:
    def group(keys: tuple[str, ...]) -> Array | None:
        return np.column_stack([columns[key] for key in keys]) if keys and keys[0] in columns else None

    axes = group(AXIS)
    if axes is not None:
        length = np.linalg.norm(axes, axis=1)
        if (length < 1e-6).any():
            line = int(lines[int(np.argmin(length))])
            raise InputError("ax ay az has no direction", file=file, line=line, hint="for example 0, 0, -1")
        axes = axes / length[:, None]
    na = len(cell.arm)
    holder = group(cell.joint_names[na:])
    return Readings(
        file=file,
        lines=lines,
        names=names,
        tips=group(TIP),
        joints=group(cell.joint_names[:na]),
        axes=axes,
        holder=np.empty((len(lines), 0)) if holder is None else holder,
    )


def contacts_of(cell: Cell, readings: Readings, length: str = "mm", angle: str = "degrees") -> Contacts:
    """The contacts given by readings, if their lengths and angles are in these units (LENGTHS, ANGLES)."""
    tips, axes = readings.tips, readings.axes
    units = np.where(cell.limits.turns, ANGLES[angle], LENGTHS["mm"])
    na = len(cell.arm)
    if readings.joints is not None:
        T_world_nozzle = cell.arm.poses(readings.joints * units[:na])
        tips, axes = T_world_nozzle[:, :3, 3], T_world_nozzle[:, :3, 2]
    elif tips is not None:
        tips = tips * LENGTHS[length]
    else:
        raise ValueError("readings with neither tips nor joints")
    return Contacts(
        names=readings.names,
        lines=readings.lines,
        file=readings.file,
        tips=tips,
        axes=axes,
        T_world_plate=plate_poses(cell, readings.holder * units[na:]),
    )


def plate_poses(cell: Cell, q: Array) -> Array:
    """World poses (m, 4, 4) of the part's plate with free axes at q (m, k) [rad, m]; for a bed, the world."""
    if cell.holder_robot is None:
        return np.tile(np.eye(4), (len(q), 1, 1))
    return np.asarray(cell.holder.poses(q) @ np.linalg.inv(cell.T_plate_part))


def other_units(readings: Readings) -> list[tuple[str, str]]:
    """Pairs of length and angle units that the file might be in instead of mm and degrees."""
    lengths = ["mm"] if readings.joints is not None else list(LENGTHS)
    angles = ["degrees"] if readings.joints is None and readings.holder.shape[1] == 0 else list(ANGLES)
    return [(length, angle) for length in lengths for angle in angles][1:]


def _expected(cell: Cell) -> str:
    na = len(cell.arm)
    names = [f"{name}_mm" if _unit(name, cell) == "mm" else name for name in cell.joint_names]
    also = f", and {', '.join(names[na:])}" if names[na:] else ""
    return f"columns x_mm, y_mm, z_mm, or {', '.join(names[:na])} in degrees{also}; optionally name, ax, ay, az"


def _unit(column: str, cell: Cell) -> str:
    """The unit of a column: "mm", "deg", or none."""
    if column not in cell.joint_names:
        return "mm" if column in TIP else ""
    return "mm" if cell.joint_names.index(column) in cell.limits.sliding else "deg"


def _places(words: list[str], cell: Cell, wrong: Complaint) -> dict[str, int]:
    """Indices of the known columns; InputError for one that is missing, unknown, or in another unit."""
    joints, na = cell.joint_names, len(cell.arm)
    known = {name.lower(): name for name in (*TIP, *AXIS, *NAMES, *joints)}
    places: dict[str, int] = {}
    for k, word in enumerate(words):
        plain = _BRACKETS.sub(r"_\1", word.strip("\"' ").lower()).replace("°", "deg")
        match = None if plain in known else _UNIT.fullmatch(plain)
        plain, unit = (plain, "") if match is None else (match[1], match[2])
        if plain not in known:
            near = nearest_name(plain, known)
            raise wrong(f"unknown column {word[:40]!r}", hint=f"did you mean {near}?" if near else _expected(cell))
        name = known[plain]
        if name in places:
            raise wrong(f"column {name} appears twice")
        right = _unit(name, cell)
        if unit not in ("", right):
            raise wrong(f"column {word[:40]!r} is in {unit}", hint=f"lengths in mm, angles in degrees: {name}_{right}")
        places[name] = k
    arm = joints[:na]
    if any(name in places for name in TIP) and any(name in places for name in arm):
        raise wrong("both the tip's place and the arm's joints are given", hint="leave one of them out")
    needed = (arm if any(name in places for name in arm) else TIP) + joints[na:]
    if any(name in places for name in AXIS):
        needed += AXIS
    missing = [name for name in needed if name not in places]
    if missing:
        columns = f"columns {', '.join(missing)} are" if len(missing) > 1 else f"column {missing[0]} is"
        raise wrong(f"{columns} missing", hint=_expected(cell))
    if all(name in places for name in NAMES):
        raise wrong("both name and contact are given", hint="leave one of them out")
    # columns in order of groups: a group is present if its first column is
    return {name: places[name] for name in (*NAMES, *TIP, *AXIS, *joints) if name in places}


def _number(word: str, column: str, unit: str, file: Path, line: int) -> float:
    wrong = partial(InputError, file=file, line=line, field=column)
    if not word:
        raise wrong("is missing")
    if not is_number(word) or "_" in word:
        hint = "a decimal point, not a comma" if "," in word else None
        raise wrong(f"{word[:40]!r} is not a number", hint=hint)
    value = float(word)
    if not abs(value) <= FARTHEST[unit]:
        why = "is too large" if abs(value) < math.inf else "is not a finite number"
        raise wrong(f"{word[:40]} {why}", hint=f"at most {FARTHEST[unit]:g} {unit}".rstrip())
    return value


# ----------------------------------------------------------------------------------------------------
# The turntable and a cylinder on it from contacts at several angles, as published (Pollard et al., eq. 1).

_RIGHT = 4.0  # standard deviations within which a coordinate counts as right
_EXACT = 1e-6  # m: readings are no more exact than this


@dataclass(frozen=True)
class Turntable(ReadOnlyArrays):
    """The axes of a table and of the cylinder on it, seen from above.

    axis (2)    of the table in the world [m];  cylinder (2) the cylinder's own axis on the plate [m]
    off (n, 2)  measured minus estimated places [m], with the least possible sum of absolute values
    """

    axis: Array
    cylinder: Array
    off: Array

    @property
    def cost(self) -> float:
        """Eq. (1b): the mean over contacts of |x| + |y| [m]."""
        return float(np.abs(self.off).sum(axis=1).mean())

    @property
    def usual(self) -> float:
        """The median over contacts of |x| + |y| [m], which a few wrong contacts hardly affect."""
        return float(np.median(np.abs(self.off).sum(axis=1)))


def locate(tips: Array, turns: Array, reach: Array) -> Turntable:
    """The axes that minimise the sum of absolute differences between estimated and measured places.

    tips (n, 2) of the nozzle in the world; turns (n, 2, 2) of the plate; reach (n, 2) from the cylinder's axis to the
    tip, which the paper, where the nozzle always points the same way, includes in the table's axis. Solved exactly as a
    linear program, where the paper uses a search routine. Raises ValueError if all angles are equal.
    """
    n = len(tips)
    A = _columns(turns)
    if np.linalg.matrix_rank(A, tol=1e-3) < 4:
        raise ValueError("the table is at one angle only")
    b = (tips - reach).ravel()
    least = eye_array(2 * n)
    solved = linprog(
        np.append(np.zeros(4), np.ones(2 * n)),
        A_ub=block_array([[coo_array(A), -least], [coo_array(-A), -least]], format="csc"),
        b_ub=np.append(b, -b),
        bounds=[(None, None)] * 4 + [(0.0, None)] * (2 * n),
    )
    z = solved.x[:4]
    return Turntable(z[:2], z[2:], (b - A @ z).reshape(n, 2))


def settled(table: Turntable, turns: Array) -> tuple[Turntable, Flags]:
    """Least squares over the coordinates that eq. (1) fits, and whether contacts (n) are right in both coordinates.

    The least sum of absolute differences is robust against wrong contacts, but for normal noise its variance is half as
    much again as that of least squares. turns (n, 2, 2): as for `locate`.
    """
    A, off = _columns(turns), table.off.ravel()
    free = A.shape[1]
    # the solution of eq. (1) fits as many coordinates exactly as it has unknowns
    deviation = MAD_TO_SIGMA * float(np.median(np.abs(off))) * math.sqrt(len(off) / max(len(off) - free, 1))
    kept = np.abs(off) <= _RIGHT * max(deviation, _EXACT)
    if np.linalg.matrix_rank(A[kept], tol=1e-3) < free:
        return table, np.ones(len(turns), dtype=bool)
    z = np.linalg.lstsq(A[kept], off[kept], rcond=None)[0]
    found = Turntable(table.axis + z[:2], table.cylinder + z[2:], (off - A @ z).reshape(-1, 2))
    return found, np.asarray(kept.reshape(-1, 2).all(axis=1))


def axis_of(T_world_plate: Array) -> tuple[Array, Array]:
    """The axis (2), in the world, about which upright plates (n, 4, 4) of the problem turn, and the plate's origin (2)
    relative to it, in the plate's frame [m]. The plates must be at two or more angles."""
    A = _columns(T_world_plate[:, :2, :2])
    z = np.asarray(np.linalg.lstsq(A, T_world_plate[:, :2, 3].ravel(), rcond=None)[0], dtype=np.float64)
    return z[:2], z[2:]


def _columns(turns: Array) -> Array:
    """Derivatives of the measured places (2n) by the axes of table and cylinder (4), plate turned by (n, 2, 2)."""
    return np.concatenate([np.tile(np.eye(2), (len(turns), 1, 1)), turns], axis=2).reshape(-1, 4)
