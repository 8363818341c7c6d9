"""Reports what a run taught: its deviation in words, a table and a picture, and the problem file of the next run."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from planner.base.arrays import Array, Indices, Ints
from planner.base.errors import OutputError
from planner.base.rapid_names import LONGEST_NAME
from planner.feedback.learn_fit import Lessons, RunErrors
from planner.feedback.learn_track import RecordedWay
from planner.motion.as_run import COLUMNS, PLACES, Corrections, places_along, read_columns
from planner.plan import Plan, Trajectory
from planner.problem import Problem
from planner.problem.rewrite import Value, changed_text

CORRECTIONS, PICTURE = "corrections.csv", "learned.png"
TAUGHT = (
    "# What runs taught, by beadwise learn: the program asks for places beside the plan, so that the robot keeps to it."
)
# Further columns: deviation of the last run from the plan, empty where unknown; and the state of learning, see Lessons.
OFF, GAIN = "off_mm", "gain"
BEST, LEFT = ("best_dx_mm", "best_dy_mm", "best_dz_mm"), ("left_dx_mm", "left_dy_mm", "left_dz_mm")
WORTH = 0.9  # × the deviation of the best runs before: if more is left, further runs have hardly anything to teach
WORST = 3  # number of worst places reported
NEAR = 0.1  # mm
FARTHEST = 10.0  # mm: largest deviation or correction in a file; recordings farther off are rejected
APART = 5e-3  # m along a bead between the worst places
AT_SPEED = 0.02  # relative tolerance of a bead's speed
_RUN = "_run_"  # before the number of a run in the name of its problem
_BLUE, _GREY, _INK = "#0072b2", "#9aa7b4", "#1b2733"


def write_lessons(lessons: Lessons, plan: Plan, errors: RunErrors, target: Path) -> None:
    """Write the lessons of runs as CSV, a row for each place. Raises OutputError."""
    corrections = lessons.corrections
    off = off_at(corrections, plan.trajectory, errors) * 1e3
    numbers = np.column_stack([corrections.s, corrections.shift, lessons.best, lessons.left]) * 1e3
    places = places_along(plan.toolpath, corrections.bead, corrections.s) * 1e3
    try:
        with target.open("w", encoding="utf-8", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow((*COLUMNS, OFF, *BEST, *LEFT, GAIN, *PLACES))
            columns = (corrections.bead, off, numbers, lessons.gain, places)
            for bead, far, values, gain, place in zip(*(column.tolist() for column in columns), strict=True):
                texts, at = [f"{value:.6f}" for value in values], [f"{value:.3f}" for value in place]
                known = "" if np.isnan(far) else f"{far:.4f}"
                rows.writerow((bead, *texts[:4], known, *texts[4:], f"{gain:.4f}", *at))
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def read_lessons(problem: Problem, corrections: Corrections) -> Lessons:
    """The lessons of the runs before, from the file of a problem's corrections. Raises InputError if it lacks them."""
    spec = problem.as_run
    if spec is None:
        raise ValueError("a problem without corrections")
    complain = partial(problem.error, "as_run.corrections")
    numbered, table = read_columns(spec.corrections, (*BEST, *LEFT, GAIN), complain)
    beyond = (np.abs(table[:, :6]).max(axis=1, initial=0.0) > FARTHEST) | (table[:, 6] < 0.0) | (table[:, 6] > 1.0)
    if beyond.any():
        reason = f"{spec.corrections.name}, line {numbered[int(np.argmax(beyond))]}: no run can have taught this"
        raise complain(reason, hint="restore the file that beadwise learn wrote")
    return Lessons(corrections, table[:, :3] * 1e-3, table[:, 3:6] * 1e-3, table[:, 6])


def off_at(corrections: Corrections, t: Trajectory, errors: RunErrors) -> Array:
    """A run's distance (k) from the plan at the corrections' places [m]; NaN where unknown."""
    rows = np.flatnonzero(t.deposit)
    order = np.lexsort((t.s[rows], t.bead[rows]))
    rows = rows[order]
    longest = float(t.s.max()) + 1.0
    at = np.searchsorted(t.bead[rows] * longest + t.s[rows], corrections.bead * longest + corrections.s - 1e-9)
    sample = rows[np.minimum(at, len(rows) - 1)]
    off = np.linalg.norm(errors.off[sample], axis=1)
    return np.asarray(np.where(errors.known[sample] & (t.bead[sample] == corrections.bead), off, np.nan))


def next_name(problem: Problem, number: int | None = None) -> str:
    """The name of a run's problem; of the next run's if no number is given."""
    stem = problem.name.rpartition(_RUN)[0] if problem.as_run is not None and _RUN in problem.name else problem.name
    suffix = f"{_RUN}{run_of(problem) + 1 if number is None else number}"
    return stem[: LONGEST_NAME - len(suffix)] + suffix


def write_problem(problem: Problem, name: str, most: float, folder: Path) -> str:
    """The text of a run's problem with a given name, for the folder of its corrections."""
    values: dict[str, Value] = {"name": name}
    if problem.as_run is not None:
        values |= {"as_run.corrections": CORRECTIONS, "as_run.most_mm": most * 1e3}
        return changed_text(problem, values, folder)
    text = changed_text(problem, values, folder)
    return f"{text.rstrip()}\n\n{TAUGHT}\nas_run:\n  corrections: {CORRECTIONS}\n  most_mm: {most * 1e3:.6g}\n"


def run_of(problem: Problem) -> int:
    """The number of the run that a problem is for: the one in the name given to it here, otherwise 1."""
    number = problem.name.rpartition(_RUN)[2]
    return int(number) if problem.as_run is not None and number.isdecimal() else 1


def off_words(errors: RunErrors) -> str:
    """How far a run was off its plan, in words."""
    size = errors.size * 1e3
    rms, nearly = np.sqrt((size**2).mean()), np.quantile(size, 0.99)
    return (
        f"the tip is off the plan by {rms:.3f} mm (rms), {nearly:.3f} (99 %), {size.max():.3f} at most, and within {NEAR:g} mm "
        f"for {(size <= NEAR).mean():.1%} of the time"
    )


def run_lines(plan: Plan, way: RecordedWay, errors: RunErrors, run: int) -> list[str]:
    """How far a run deviated from its plan, and where most, in words."""
    t, size = plan.trajectory, errors.size * 1e3
    rows = np.flatnonzero(errors.known)
    seen = len(rows) / int(np.count_nonzero(t.deposit))
    out = [
        *way.remarks,
        f"run {run}: {seen:.1%} of the samples on beads recorded; {off_words(errors)}",
        f"noise of a recorded tip: {errors.noise * 1e3:.3f} mm, standard deviation",
    ]
    asked = plan.commanded[t.bead[rows]]
    speed = errors.speed[rows]
    told = ~np.isnan(speed)
    if told.any():
        share = float((speed[told] >= (1.0 - AT_SPEED) * asked[told]).mean())
        planned = float((t.speed[rows][told] >= (1.0 - AT_SPEED) * asked[told]).mean())
        out.append(f"at the commanded speed in {share:.1%} of that time, planned {planned:.1%}")
    turned = way.turned[t.deposit[np.minimum(np.rint(way.place).astype(np.int64), len(t) - 1)]]
    if len(turned):
        out.append(
            f"the axis is off by {np.degrees(np.quantile(turned, 0.99)):.2f} degrees (99 %), which is not corrected"
        )
    out.append("most off: " + "; ".join(_places(t, rows, size)))
    return out


def _places(t: Trajectory, rows: Indices, size: Array) -> list[str]:
    """The worst places, in words."""
    out: list[tuple[int, float]] = []
    words = []
    for k in np.argsort(-size, kind="stable")[:2000].tolist():
        bead, s = int(t.bead[rows[k]]), float(t.s[rows[k]])
        if all(bead != other or abs(s - there) > APART for other, there in out):
            out.append((bead, s))
            words.append(f"{size[k]:.3f} mm at bead {bead}, {s * 1e3:.1f} mm")
        if len(out) == WORST:
            break
    return words


def next_lines(lessons: Lessons, before: Lessons | None, shown: Ints, smoothed: int) -> list[str]:
    """How far the next program is off the plan, and whether another run is worthwhile; shown: the recorded beads."""
    out = [f"the next program asks for places up to {lessons.corrections.most * 1e3:.3f} mm beside the plan"]
    if smoothed:
        out.append(f"corrections were smoothed until lines of the program could follow them (rounds: {smoothed})")
    if before is not None:
        again = np.intersect1d(before.corrections.bead[before.gain > 0.0], shown)
        was, now = (_left(each, again) * 1e3 for each in (before, lessons))
        if len(again) and now > WORTH * was:
            out.append(
                f"hardly closer than before, place by place ({now:.3f} mm rms, {was:.3f}): runs have little left to teach"
            )
    return out


def _left(lessons: Lessons, beads: Ints) -> float:
    """Root mean square deviation of the best runs at places of some beads [m]; 0 without any."""
    left = lessons.left[np.isin(lessons.corrections.bead, beads)]
    return float(np.sqrt(np.square(left).sum() / max(len(left), 1)))


def write_picture(plan: Plan, errors: RunErrors, corrections: Corrections, run: int, target: Path) -> None:
    """Write a run's deviation from its plan, along the print and as a distribution, as PNG. Raises OutputError."""
    t = plan.trajectory
    rows = np.flatnonzero(errors.known)
    way = np.cumsum(np.concatenate([[0.0], np.where(np.diff(rows) == 1, np.diff(t.s[rows]), 0.0)]))
    figure = Figure(figsize=(12.0, 4.5), dpi=120, facecolor="white", layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 1))
    left.plot(way, errors.size * 1e3, color=_BLUE, linewidth=0.6)
    left.set_xlabel("along all beads [m]")
    left.set_ylabel("off the plan [mm]")
    left.set_title(f"run {run}: the executed tip across the planned path", fontsize=10, color=_INK)
    size = np.sort(errors.size) * 1e3
    right.plot(size, np.linspace(0.0, 1.0, len(size)), color=_BLUE, label="off the plan")
    asked = np.sort(np.linalg.norm(corrections.shift, axis=1)) * 1e3
    right.plot(asked, np.linspace(0.0, 1.0, len(asked)), color=_GREY, label="asked beside it next")
    right.set_xlabel("mm")
    right.set_ylabel("share of the places below")
    right.legend(frameon=False, fontsize=9)
    for ax in (left, right):
        axes: Any = ax
        axes.set_ylim(bottom=0.0)
        axes.spines[["top", "right"]].set_visible(False)
    try:
        FigureCanvasAgg(figure).print_png(str(target), metadata={"Software": None})
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error
