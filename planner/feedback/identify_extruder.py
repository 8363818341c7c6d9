"""How late an extruder's flow follows its motor, and how much it lays: a line with flow steps, weighed or photographed.

The test line is a problem of its own: a straight bead whose width steps while the nozzle keeps its speed, planned,
checked and written like any print. Pressure makes the flow follow the motor as a first-order system, so the bead
approaches each new width over a length of speed times lag. This model is fitted to the masses of segments, or to widths
measured in a picture.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from planner.base.arrays import Array, ReadOnlyArrays
from planner.base.errors import InputError, nearest_name
from planner.base.tables import rows_of, separator_of, split_row
from planner.problem import Problem
from planner.problem.layers import GcodeLayersSpec
from planner.problem.rewrite import Value, changed_text, without
from planner.toolpath.gcode.reader import read_gcode

BY = "identify"  # the command under which a results folder lists the files
FORMAT = "beadwise extruder line 1"
LARGEST_FILE = 5_000_000  # bytes
# Shares of the line, and the bead's width there × the usual one: large and small steps both ways, with time to settle.
STEPS = ((0.22, 1.0), (0.18, 1.5), (0.18, 1.0), (0.16, 0.7), (0.14, 1.5), (0.12, 1.0))
LENGTH = 240e-3  # m: at 40 mm/s and a lag of 0.2 s, a step takes 8 mm to be two thirds done
WIDTHS = 24.0  # × the bead's width, if that is longer: the shortest section is then about three times as long as wide
SHORTEST = 60e-3  # m
RAMP = 0.1e-3  # m over which a width steps, as waypoints must not coincide
SPACING = 1e-3  # m between waypoints
LEAST_ROWS = 8
OFF = 1e-3  # m: standard deviation of a ruler's zero from the start of the line
MOST_LAG = 2.0  # s: the upper bound of process.extruder.lag_s
ODD = 4.0  # × the median: beyond, a row is a mistake, as the line's own steps are 1.5 times
LEAST_EXPLAINED = 0.2  # share of a table's variance that the line's steps must explain
FACTOR = 5.0  # × what the line requires: beyond, a table is in another unit
LITTLE = 1e-3  # s: a lag below this hardly changes the model
SHOWN = 0.25  # standard error over value up to which a value is reported
# What belongs to a print, and not to a line. Without the lag the motor steps, so that a table shows the flow; without a
# prime the line begins as modelled, with no flow.
PRINTED = ("part", "layers", "as_printed", "as_run", "process.speeds", "process.layer_time", "process.pauses",
           "process.order", "process.seam", "process.skirt", "process.fan", "process.prime",
           "process.extruder.lag_s")  # fmt: skip
COLUMNS = {
    "from_mm": 1e-3, "to_mm": 1e-3, "mass_mg": 1e-6, "s_mm": 1e-3, "width_mm": 1e-3,
}  # name → its unit in m, kg  # fmt: skip


@dataclass(frozen=True)
class FlowLine(ReadOnlyArrays):
    """A test line as it was requested (k sections), SI units.

    ends (k + 1)   where the sections begin and end along it, from 0 [m]
    area (k)       cross-section of the bead [m²]
    speed [m/s], height [m], rounded: the bead has a rounded section;  filament: its diameter [m]
    """

    problem: str
    ends: Array
    area: Array
    speed: float
    height: float
    rounded: bool
    filament: float

    @property
    def length(self) -> float:
        """Length of the line [m]."""
        return float(self.ends[-1])

    def laid(self, s: Array, lag: float) -> Array:
        """Volume (n) [m³] laid from the start to arc lengths s (n) [m]; flow follows the motor with a lag [s]."""
        reach = max(self.speed * lag, 1e-9)
        out, area = np.zeros(len(s)), 0.0
        for begin, end, wanted in zip(self.ends, self.ends[1:], self.area, strict=False):
            own = np.clip(s, begin, end) - begin
            out += wanted * own + (area - wanted) * reach * -np.expm1(-own / reach)
            area = wanted + (area - wanted) * math.exp(-(end - begin) / reach)
        return out

    def area_at(self, s: Array, lag: float) -> Array:
        """Cross-section (n) [m²] at arc lengths s (n) [m]."""
        reach = max(self.speed * lag, 1e-9)
        out, area = np.zeros(len(s)), 0.0
        for begin, end, wanted in zip(self.ends, self.ends[1:], self.area, strict=False):
            inside = (s >= begin) & ((s < end) | (end == self.ends[-1]))
            out = np.where(inside, wanted + (area - wanted) * np.exp(-np.maximum(s - begin, 0.0) / reach), out)
            area = wanted + (area - wanted) * math.exp(-(end - begin) / reach)
        return out


@dataclass(frozen=True)
class LineTable(ReadOnlyArrays):
    """Measurements of a line (n rows): both ends and masses [kg] of weighed segments, or arc lengths and widths [m]."""

    file: Path
    begin: Array
    end: Array
    value: Array
    weighed: bool


@dataclass(frozen=True)
class FoundFlow:
    """Lag [s] and ratio of laid to requested flow, each with its standard error; NaN if the table does not show it.

    offset    of the table's zero from the start of the line [m];  residual: relative to the mean value
    """

    lag: float
    lag_error: float
    flow: float
    flow_error: float
    offset: float
    residual: float
    rows: int

    @property
    def lag_told(self) -> bool:
        """Whether the lag stands out from its error."""
        return self.lag_error < SHOWN * self.lag


# ----------------------------------------------------------------------------------------------------
# The line.


def line_of(problem: Problem, length: float, bead: tuple[float, float] | None = None) -> FlowLine:
    """The sections of a test line; bead: width and height [m], if they are not the problem's.

    Raises InputError for an extruder whose flow cannot step at a constant speed, and for beads without a height.
    """
    process = problem.process
    width, height = bead or (process.bead.width, process.bead.height)
    if not math.isfinite(height):
        hint = "--bead gives width and height, for example 0.6,0.3"
        raise InputError("the height of beads is in their G-code", file=problem.file, field="process.bead", hint=hint)
    for is_so, reason, field in (
        (process.section == "fibre", "a fibre is as thick as it is fed", "process.fibre"),
        (process.extruder.motor == "on_off", "a motor that is only on or off has one flow", "process.extruder.motor"),
        (bool(process.materials), "a test line has one material", "process.materials"),
    ):
        if is_so:
            raise InputError(f"{reason}: no line with steps of flow", file=problem.file, field=field)
    shares = np.array([share for share, _ in STEPS])
    ends = np.round(length * np.append(0.0, np.cumsum(shares) / shares.sum()), 6)
    widths = width * np.array([times for _, times in STEPS])
    rounded = process.section == "rounded"
    return FlowLine(
        problem=problem.name,
        ends=ends,
        area=area_of(np.maximum(widths, height) if rounded else widths, height, rounded),
        speed=process.speed,
        height=height,
        rounded=rounded,
        filament=process.filament_diameter,
    )


def usual_length(width: float) -> float:
    """Default length of a line [m] with a bead of a given width [m]."""
    return max(LENGTH, WIDTHS * width)


def area_of(width: Array, height: float, rounded: bool) -> Array:
    """Cross-section (n) [m²] of beads of a width (n)."""
    return width * height - ((1.0 - 0.25 * np.pi) * height**2 if rounded else 0.0)


def width_of(area: Array, height: float, rounded: bool) -> Array:
    """Width (n) [m] of beads of a cross-section (n)."""
    out: Array = (area + ((1.0 - 0.25 * np.pi) * height**2 if rounded else 0.0)) / height
    return out


def waypoints_text(line: FlowLine, begin: Array, end: Array, normal: Array) -> str:
    """The line as a file of waypoints from one point to another (3) [m]: positions in mm, normals, and widths in mm."""
    along = (end - begin) / np.linalg.norm(end - begin)
    inner = line.ends[1:-1]
    s = np.unique(
        np.round(np.concatenate([np.arange(0.0, line.length, SPACING), inner, inner - RAMP, [line.length]]), 6)
    )
    k = np.clip(np.searchsorted(line.ends, s, side="right") - 1, 0, len(line.area) - 1)
    widths = width_of(line.area[k], line.height, line.rounded)
    rows = np.column_stack([1e3 * (begin + s[:, None] * along), np.tile(normal, (len(s), 1)), 1e3 * widths])
    text = "\n".join(" ".join(f"{value:.6g}" for value in row) for row in rows)
    return f"# x y z nx ny nz width\n{text}\n"


def problem_text(problem: Problem, line: FlowLine, name: str, folder: Path) -> str:
    """The text of the line's problem: cell and process of a given problem, and a file of waypoints as its layers."""
    changes: dict[str, Value] = {"name": name, "process.bead.height_mm": 1e3 * line.height}
    text = without(changed_text(problem, changes, folder), PRINTED)
    return f"{text.rstrip()}\n\n# A line with steps of flow, by beadwise identify extruder.\nlayers:\n  source: {{waypoints: {name}.txt}}\n"


def line_text(line: FlowLine) -> str:
    """JSON of a requested line: mm, mm², mm/s."""
    data = {
        "format": FORMAT,
        "problem": line.problem,
        "ends_mm": [round(1e3 * float(each), 6) for each in line.ends],
        "area_mm2": [round(1e6 * float(each), 9) for each in line.area],
        "speed_mm_s": 1e3 * line.speed,
        "height_mm": 1e3 * line.height,
        "rounded": line.rounded,
        "filament_mm": 1e3 * line.filament,
    }
    return json.dumps(data, indent=1) + "\n"


def read_asked_line(file: Path, problem: Problem) -> FlowLine:
    """Read a requested line. Raises InputError for another kind of file, or another problem's."""
    hint = "the file that `identify extruder write` made beside its problem; --asked names it"
    try:
        data = json.loads(file.read_text("utf-8"))
        if data["format"] != FORMAT:
            raise InputError(f"its format is {str(data['format'])[:40]!r}", file=file, hint=hint)
        line = FlowLine(
            problem=str(data["problem"]),
            ends=1e-3 * np.array(data["ends_mm"], dtype=np.float64),
            area=1e-6 * np.array(data["area_mm2"], dtype=np.float64),
            speed=1e-3 * float(data["speed_mm_s"]),
            height=1e-3 * float(data["height_mm"]),
            rounded=bool(data["rounded"]),
            filament=1e-3 * float(data["filament_mm"]),
        )
    except FileNotFoundError:
        raise InputError("there is no such file", file=file, hint=hint) from None
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise InputError(f"does not say what a line asked: {error}"[:160], file=file, hint=hint) from error
    sizes = np.array([line.speed, line.height, line.filament, *line.area, *np.diff(line.ends)])
    if len(line.ends) != len(line.area) + 1 or not (np.isfinite(sizes).all() and (sizes > 0.0).all()):
        raise InputError("does not say what a line asked: sections without a length or a flow", file=file, hint=hint)
    if line.problem != problem.name:
        raise InputError(f"was written for {line.problem}", file=file, hint=f"CELL is {problem.name}")
    return line


# ----------------------------------------------------------------------------------------------------
# The table.


def read_table(file: Path, line: FlowLine) -> LineTable:
    """Read a table of a line: from_mm, to_mm, mass_mg, or s_mm, width_mm.

    Raises InputError with line and column for values that cannot belong to this line.
    """
    rows = rows_of(file, LARGEST_FILE)
    if not rows:
        raise InputError("holds no table", file=file)
    separator = separator_of(rows[0][1])
    wrong = partial(InputError, file=file, line=rows[0][0])
    head = [name.strip('"').lower() for name in split_row(rows[0][1], separator, wrong)]
    weighed = "mass_mg" in head
    wanted = ("from_mm", "to_mm", "mass_mg") if weighed else ("s_mm", "width_mm")
    for name in wanted:
        if name not in head:
            near = nearest_name(name, head)
            hint = "from_mm, to_mm, mass_mg of a line that was cut and weighed, or s_mm, width_mm of a picture"
            told = f"{hint}; there is {near}" if near else hint
            raise wrong(f"no column {name}", hint=told)
    table = np.array([_row(file, i, row, separator, head, wanted) for i, row in rows[1:]]).reshape(-1, len(wanted))
    if len(table) < LEAST_ROWS:
        raise InputError(f"holds {len(table)} rows", file=file, hint=f"at least {LEAST_ROWS}, on both sides of steps")
    numbers = [i for i, _ in rows[1:]]
    value = table[:, -1] * COLUMNS[wanted[-1]]
    begin, end = 1e-3 * table[:, 0], 1e-3 * table[:, 1 if weighed else 0]
    _check_places(file, numbers, line, begin, end, wanted)
    found = LineTable(file, begin, end, value, weighed)
    _check_values(found, numbers, line, wanted[-1])
    return found


def _row(
    file: Path, i: int, row: str, separator: str | None, head: Sequence[str], wanted: Sequence[str]
) -> list[float]:
    """The wanted numbers of a row."""
    wrong = partial(InputError, file=file, line=i)
    words = split_row(row, separator, wrong)
    if len(words) != len(head):
        hint = "a decimal point, not a comma" if len(words) > len(head) else "every row whole"
        raise wrong(f"{len(words)} columns, and {len(head)} in the header", hint=hint)
    out = []
    for name in wanted:
        word = words[head.index(name)]
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise wrong(f"{word[:40]!r} is no number", field=name)
        out.append(number)
    return out


def _check_places(
    file: Path, numbers: Sequence[int], line: FlowLine, begin: Array, end: Array, wanted: Sequence[str]
) -> None:
    """Raises InputError for positions that are off the line, not increasing, or in another unit."""
    span, length = float(end.max() - begin.min()), line.length
    if span > 1.5 * length or span < 0.02 * length:
        reason = (
            f"places go from {1e3 * begin.min():g} to {1e3 * end.max():g} mm, and the line is {1e3 * length:g} mm long"
        )
        raise InputError(reason, file=file, line=numbers[0], field=wanted[0], hint="places in mm from its beginning")
    for k, number in enumerate(numbers):
        wrong = partial(InputError, file=file, line=number)
        if begin[k] < -5e-3 or end[k] > length + 5e-3:
            off = begin[k] if begin[k] < -5e-3 else end[k]
            field = wanted[0] if begin[k] < -5e-3 or len(wanted) == 2 else wanted[1]
            raise wrong(f"{1e3 * off:g} mm is not on the line", field=field, hint=f"0 to {1e3 * length:g} mm")
        if len(wanted) == 3 and end[k] <= begin[k]:
            raise wrong(f"ends at {1e3 * end[k]:g} mm, where it begins or before", field=wanted[1])
        if k and begin[k] < (end[k - 1] if len(wanted) == 3 else begin[k - 1] + 1e-9) - 1e-9:
            raise wrong(
                f"{1e3 * begin[k]:g} mm lies before the end of the row above", field=wanted[0], hint="rows in order"
            )
    inner = line.ends[1:-1]
    if not ((inner > begin.min()) & (inner < end.max())).any():
        reason = f"no step of flow lies between {1e3 * begin.min():g} and {1e3 * end.max():g} mm"
        steps = ", ".join(f"{1e3 * each:g}" for each in inner)
        raise InputError(reason, file=file, line=numbers[0], field=wanted[0], hint=f"steps are at {steps} mm")


def _check_values(found: LineTable, numbers: Sequence[int], line: FlowLine, column: str) -> None:
    """Raises InputError for masses or widths below 0, outliers, and widths that no bead of this line can have."""
    wrong = np.flatnonzero(found.value < 0.0 if found.weighed else found.value <= 0.0)
    if len(wrong):
        raise InputError("must not be below 0" if found.weighed else "must be above 0", file=found.file,
                         line=numbers[int(wrong[0])], field=column)  # fmt: skip
    if not found.value.any():
        raise InputError("holds no mass", file=found.file, line=numbers[0], field=column)
    each = found.value / (found.end - found.begin) if found.weighed else found.value
    usual = float(np.median(each))
    odd = np.flatnonzero(each > ODD * usual)
    if len(odd):
        reason = f"is {each[odd[0]] / usual:.3g} times the line's mean" if usual else "is all that there is"
        hint = f"the line asks {float(line.area.max() / np.median(line.area)):.3g} times at most: a decimal point?"
        raise InputError(reason, file=found.file, line=numbers[int(odd[0])], field=column, hint=hint)
    if found.weighed:
        return
    widest = float(width_of(line.area, line.height, line.rounded).max())
    typical = float(np.median(found.value))
    if not widest / (2.0 * FACTOR) < typical < widest * FACTOR:
        reason = f"widths are {1e3 * typical:g} mm on average, but the line asks for at most {1e3 * widest:.3g}"
        raise InputError(reason, file=found.file, line=numbers[0], field=column, hint="widths in mm")


# ----------------------------------------------------------------------------------------------------
# The fit.


def fit_flow(found: LineTable, line: FlowLine, density: float | None) -> FoundFlow:
    """Fit lag and flow to a table by least squares.

    density [kg/m³] of the material, without which masses do not give the flow
    Raises InputError if the flow is off the line's by a large factor, or the line's steps do not explain the table.
    """
    middle, size = 0.5 * (found.begin + found.end), np.maximum(found.end - found.begin, 1e-9)
    value = found.value / size if found.weighed else area_of(found.value, line.height, line.rounded)
    unit = float(np.mean(line.area))

    def shape(x: Array) -> Array:
        """Mean cross-sections (n), relative to the line's mean one, for a lag and an offset."""
        lag, offset = x[0], x[1] * OFF
        if found.weighed:
            return (line.laid(found.end + offset, lag) - line.laid(found.begin + offset, lag)) / size / unit
        return line.area_at(middle + offset, lag) / unit

    scale = float(np.median(value)) / unit if found.weighed else 1.0
    noise = 1.0

    def residuals(x: Array) -> Array:
        # the ruler's zero has a prior; the noise has none
        return np.append((x[2] * shape(x) - value / (scale * unit)) / noise, x[1])

    best = None
    for _ in range(3):  # the noise determines the weight of the prior
        starts = (best.x[0],) if best is not None else (0.01, 0.05, 0.2, 0.6)
        tries = [
            least_squares(
                residuals, [lag, 0.0, 1.0], bounds=([0.0, -5.0, 0.0], [MOST_LAG, 5.0, 100.0]), x_scale=[0.02, 0.3, 0.1]
            )
            for lag in starts
        ]
        best = min(tries, key=lambda each: each.cost)
        left = best.fun[:-1] * noise
        noise = max(float(np.sqrt((left**2).sum() / max(len(left) - 3, 1))), 1e-4)
    if best is None:
        raise ValueError("nothing was fitted")
    jacobian = best.jac.copy()
    if best.x[0] < LITTLE:
        # a lag this close to zero changes nothing yet: a larger step in it shows how well it is known
        more = best.x + np.array([10.0 * LITTLE, 0.0, 0.0])
        jacobian[:, 0] = (residuals(more) - residuals(best.x)) / (10.0 * LITTLE)
    errors = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)))
    flow, flow_error = float(best.x[2]), float(errors[2])
    _check_explained(found, best.fun[:-1] * noise, value / (scale * unit))
    if found.weighed:
        per = scale / density if density is not None else math.nan
        flow, flow_error = flow * per, flow_error * per
    if math.isfinite(flow) and not 1.0 / FACTOR < flow < FACTOR:
        what = "mass_mg" if found.weighed else "width_mm"
        reason = f"the line is {flow:.3g} times what was asked"
        raise InputError(reason, file=found.file, field=what, hint="another unit, or another line; masses in mg")
    return FoundFlow(
        lag=float(best.x[0]),
        lag_error=float(errors[0]),
        flow=flow,
        flow_error=flow_error,
        offset=float(best.x[1]) * OFF,
        residual=noise / float(np.mean(value / (scale * unit))),
        rows=len(value),
    )


def _check_explained(found: LineTable, left: Array, value: Array) -> None:
    """Raises InputError if the steps of the line explain hardly any of a table's variance."""
    varies = float(((value - value.mean()) ** 2).sum())
    explained = 1.0 - float((left**2).sum()) / varies if varies > 0.0 else 0.0
    if explained < LEAST_EXPLAINED:
        reason = f"does not follow the steps of the line: they explain {max(explained, 0.0):.0%} of its variation"
        hint = "measure from the line's beginning, in order; --asked must be the file of this line"
        raise InputError(reason, file=found.file, hint=hint)


def flow_lines(found: FoundFlow) -> list[str]:
    """What a table shows, in words."""
    out = [f"{found.rows} rows, {100.0 * found.residual:.2g} % of a bead remain that nothing explains"]
    if found.lag_told:
        out.append(f"flow lags the motor by {found.lag:.4f} ±{found.lag_error:.4f} s")
    else:
        out.append(f"lag: not shown, at most {found.lag + 2.0 * found.lag_error:.3f} s")
    if math.isfinite(found.flow):
        out.append(f"laid is {found.flow:.4f} ±{found.flow_error:.4f} of what was asked")
    else:
        out.append("flow: not shown by masses without --density")
    if abs(found.offset) > 0.5 * OFF:
        out.append(f"the table's zero is {1e3 * found.offset:+.1f} mm off the line's beginning")
    return out


def process_values(found: FoundFlow, line: FlowLine, problem: Problem) -> dict[str, Value]:
    """The measured fields of the problem: the lag, and the filament diameter as the extruder feeds it.

    A motor that lays a share f of the requested flow acts as if fed by a filament of diameter d √f. The diameter that E
    of a slicer's file counts with is unchanged.
    """
    out: dict[str, Value] = {}
    if found.lag_told:
        known = "extruder" in problem.process.model_fields_set
        lag = float(f"{found.lag:.4g}")
        out |= {"process.extruder.lag_s": lag} if known else {"process.extruder": {"lag_s": lag}}
    if math.isfinite(found.flow):
        out["process.filament_diameter_mm"] = float(f"{1e3 * line.filament * math.sqrt(found.flow):.5g}")
        out |= _counted_by_e(problem)
    return out


def _counted_by_e(problem: Problem) -> dict[str, Value]:
    """The filament diameter that E of a slicer's file counts with, if only the process states it."""
    layers, process = problem.layers, problem.process
    if not isinstance(layers, GcodeLayersSpec) or layers.source.filament_diameter is not None:
        return {}
    read = read_gcode(layers.source.gcode, process.chord_tolerance, partial(problem.error, "layers.source.gcode"))
    if read.volume or read.filament:
        return {}
    return {"layers.source.filament_diameter_mm": float(f"{1e3 * process.filament_diameter:.9g}")}
