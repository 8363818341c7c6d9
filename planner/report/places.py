"""Places to go to in the scene: the plan's worst places, bodies close to each other, and dips with their remedies."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from planner.report.templates import render

if TYPE_CHECKING:
    from planner.plan import Approach, Dip, Plan, Remedy, Trajectory

# ----------------------------------------------------------------------------------------------------
# Dips: marks on the part, a table of those that cost most, and what would avoid them.

MOST_ROWS = 30
SLOWEST_ADVISED = 0.5  # × the commanded speed: nobody would print slower to avoid a dip
MOST_MARKS = 800  # each carries some 300 bytes of words


def worst_first(dips: Sequence[Dip]) -> list[Dip]:
    """Dips by the time that they cost, the costliest first."""
    return sorted(dips, key=lambda dip: -dip.lost)


def without_stops(dips: Sequence[Dip]) -> list[Dip]:
    """Dips without those where the nozzle has to rest on its bead."""
    return [dip for dip in dips if dip.limit != "stop"]


def samples_of(trajectory: Trajectory, dips: Sequence[Dip]) -> NDArray[np.intp]:
    """Sample at which each dip is slowest."""
    return np.rint(np.array([dip.t for dip in dips]) / trajectory.dt).astype(np.intp)


def dip_marks(plan: Plan) -> dict[str, Any] | None:
    """Marks of the dips that cost most; None without any.

    `point` and `normal` (part frame, m), `sample`, `layer`, `words`, and `cost`, the square root of the time lost as a
    share of the greatest.
    """
    if not plan.dips:
        return None
    shown = sorted(worst_first(plan.dips)[:MOST_MARKS], key=lambda dip: dip.t)
    traj, commanded = plan.trajectory, plan.commanded
    at = samples_of(traj, shown)
    return {
        "point": traj.tip[at].astype(np.float32).ravel(),
        "normal": (-traj.axis[at]).astype(np.float32).ravel(),
        "sample": at.astype(np.int32),
        "layer": np.array([dip.layer for dip in shown], dtype=np.int32),
        "cost": np.sqrt(np.array([dip.lost for dip in shown]) / max(max(dip.lost for dip in shown), 1e-9)).astype(
            np.float32
        ),
        "words": [_lines(dip, float(commanded[dip.bead])) for dip in shown],
    }


def dips_section(plan: Plan, numbers: Sequence[int]) -> Markup:
    """HTML of the dips: their number and cost by cause, and the worst of them with what would avoid each.

    numbers: of their places on the page, those of the costliest first
    """
    dips, commanded = without_stops(plan.dips), plan.commanded
    by_cause: dict[str, list[Dip]] = defaultdict(list)
    for dip in dips:
        by_cause[dip.cause].append(dip)
    return render(
        "dips",
        dips=dips,
        advice=plan.advice,
        rests=[dip for dip in plan.dips if dip.limit == "stop"],
        causes=sorted(by_cause.items(), key=lambda item: -sum(dip.lost for dip in item[1])),
        shown=list(zip(worst_first(dips), numbers, strict=False)),
        all_marked=len(plan.dips) <= MOST_MARKS,
        most_marks=MOST_MARKS,
        flows=any(dip.over_extruded for dip in dips),
        commanded=commanded * 1e3,
        place=place_words,
        followable=lambda dip: followable(dip, float(commanded[dip.bead])),
    )


def place_words(dip: Dip) -> str:
    """Where a dip is, in words."""
    return f"bead {dip.bead}, layer {dip.layer + 1}, {dip.from_s * 1e3:.1f} to {dip.to_s * 1e3:.1f} mm along it"


def followable(dip: Dip, commanded: float) -> list[Remedy]:
    """Remedies that a user could follow: no speed below half of the commanded one [m/s]."""
    least = SLOWEST_ADVISED * commanded * 1e3
    return [each for each in dip.remedies if each.kind != "speed" or each.changes[0][1] >= least]


def _lines(dip: Dip, commanded: float) -> list[str]:
    return [
        place_words(dip),
        f"{dip.speed * 1e3:.1f} of {commanded * 1e3:g} mm/s, {dip.lost:.3f} s lost",
        f"why: {dip.cause}",
        *([f"too much material: {dip.over_extruded * 1e9:.3g} mm³"] if dip.over_extruded else []),
        *(f"{'or' if k else 'would avoid it:'} {remedy.words}" for k, remedy in enumerate(followable(dip, commanded))),
    ]


# ----------------------------------------------------------------------------------------------------
# Places: where the plan is worst, where bodies come close to each other, and what would help there.

AT_SPEED = 0.98
SAME_DIP = 1e-6  # s within which a dip's slowest sample and a given sample are the same
PLACEMENT = "another position or rotation of the part (python -m planner.place searches for it)"
SINGULAR = f"A nozzle at an angle to the flange (cell.nozzle.axis), or {PLACEMENT}, keeps away from it."
STOPS = f"Another posture to start from (cell.home_deg), or {PLACEMENT}, gives the joint more room."
BUSY = "A wider process.corner_tolerance_mm asks less of it in corners, a lower process.speed_mm_s everywhere."
IN_TRAVEL = "It travels there, as quickly as its limits allow: nothing is printed."
LEANS = "process.cones.nozzle_normal_deg bounds the lean; 0 holds the nozzle upright on the surface."
NEAR = f"More room: {PLACEMENT}; collision.nozzle_mm and collision.arm_mm set the distances to keep."
COUNTED = "process.crossings: told counts them and refuses nothing."
EVEN_SPEED = (
    "a wider process.corner_tolerance_mm, or a lower process.speed_mm_s. With process.extruder.motor: e_axis or speed_demand "
    "the flow follows the speed; process.extruder.flow_tolerance says how uneven it may be."
)
LAGGING = "Beads longer than what is laid in process.extruder.lag_s, a lower process.speed_mm_s, or finer samples (--dt 0.002)."
SAMPLED = "Finer samples (--dt 0.002), where beads are short or their width changes quickly."
STEERED = (
    "A curve of layers.source that bends less there, or a wider process.corner_tolerance_mm where it has a corner; "
    "process.fibre.least_radius_mm should be what the tow tolerates."
)
ORDERS = {"velocity": 1, "acceleration": 2, "jerk": 3}  # derivative by time


@dataclass(frozen=True)
class ReportPlace:
    """A place to go to: what is there, its value in words, the sample, and what would help.

    letter  empty for a place in the folded part of the list
    kind    "fail", "worst", "slow" or "near"
    pair    the two bodies that come near each other there, if it is about a pair
    """

    letter: str
    kind: str
    what: str
    value: str
    sample: int
    help: str = ""
    pair: tuple[str, ...] = ()


@dataclass(frozen=True)
class Worst:
    """Where a metric has its value: the sample, the joint concerned, if any, and what would help."""

    sample: int
    joint: str = ""
    help: str = ""


def worst_samples(plan: Plan) -> dict[str, Worst]:
    """Where metrics have their values, by the metric's key; metrics without a place are left out.

    While depositing: slowest, closest to a singularity, leaning most. In the whole motion: closest to an end stop,
    hardest on the joints.
    """
    traj, series = plan.trajectory, plan.series
    printing = np.flatnonzero(traj.deposit)
    if not len(printing):
        return {}
    found: dict[str, Worst] = {}
    i = int(printing[traj.speed[printing].argmin()])
    if traj.speed[i] < AT_SPEED * plan.commanded[traj.bead[i]]:
        found["speed_min_mm_s"] = Worst(i, help=_of_dip(plan, i))
    for key, name, help_ in (("sigma_min", "sigma", SINGULAR), ("wrist_margin_deg", "wrist_deg", SINGULAR)):
        if name in series and np.isfinite(series[name][printing]).any():
            found[key] = Worst(int(printing[np.nanargmin(series[name][printing])]), help=help_)
    if "limit_margin_deg" in series and np.isfinite(series["limit_margin_deg"]).any():
        i = int(np.nanargmin(series["limit_margin_deg"]))
        found["joint_limit_margin_deg"] = Worst(i, _at_its_end(plan, i), STOPS)
    for name in ORDERS:
        values = series.get(f"{name}_ratio")
        if values is not None and np.isfinite(values).any():
            i = int(np.nanargmax(values))
            found[f"{name}_ratio_max"] = Worst(i, plan.cell.joint_names[_busiest(plan, name, i)], _busy(plan, i))
    if "tilt_deg" in series:
        found["tilt_max_deg"] = Worst(int(printing[series["tilt_deg"][printing].argmax()]), help=LEANS)
    return found


def where_shortly(plan: Plan, sample: int) -> str:
    """A sample's whereabouts: bead, layer and how far along."""
    traj = plan.trajectory
    if traj.bead[sample] < 0:
        return f"in travel, {traj.t[sample]:.2f} s"
    return f"bead {traj.bead[sample]}, layer {traj.layer[sample] + 1}, {traj.s[sample] * 1e3:.1f} mm"


def where_words(plan: Plan, sample: int) -> str:
    """A sample's whereabouts, and the point in the part frame."""
    x, y, z = plan.trajectory.tip[sample] * 1e3
    along = " along it" if plan.trajectory.bead[sample] >= 0 else ""
    return f"{where_shortly(plan, sample)}{along}; x {x:.1f}, y {y:.1f}, z {z:.1f} mm".replace("-", "−")


def places_data(plan: Plan, places: Sequence[ReportPlace]) -> list[dict[str, Any]]:
    """Places as data for the page: time, point [m] and outward normal in the part frame, and the words of the card."""
    traj = plan.trajectory
    return [
        {
            "letter": place.letter,
            "kind": place.kind,
            "what": place.what,
            "value": place.value,
            "t": float(traj.t[place.sample]),
            "point": traj.tip[place.sample].round(6).tolist(),
            "normal": (-traj.axis[place.sample]).round(4).tolist(),
            "where": where_words(plan, place.sample),
            "help": place.help,
            "pair": [drawn(name) for name in place.pair],
        }
        for place in places
    ]


def drawn(name: str) -> str:
    """The body that represents a name in the scene: all beads are one."""
    return "print" if name.startswith("bead ") else name


def check_advice(name: str, plan: Plan, sample: int) -> str:
    """What may help where a check is worst, by the check's subject; sample: -1 if it is at none."""
    if name in REMEDIES:
        return REMEDIES[name](plan)
    for word, advice in (("clear", NEAR), ("singular", SINGULAR), ("branch", SINGULAR), ("range", STOPS)):
        if word in name:
            return advice
    return _busy(plan, sample) if "joint" in name else ""


def near_place(each: Approach) -> ReportPlace:
    """The place where two bodies come closest to each other."""
    value = f"{each.distance * 1e3:.1f} mm apart, {each.need * 1e3:g} mm required"
    return ReportPlace("", "near", f"{each.a} – {each.b}", value, each.sample, NEAR, (each.a, each.b))


def dip_place(plan: Plan, dip: Dip) -> ReportPlace:
    """The place where a dip is slowest."""
    commanded = float(plan.commanded[dip.bead])
    value = f"{dip.speed * 1e3:.1f} of {commanded * 1e3:g} mm/s"
    (sample,) = samples_of(plan.trajectory, [dip]).tolist()
    return ReportPlace(
        "", "slow", f"dip: {dip.cause}", f"{value}, {dip.lost:.3f} s lost", sample, _remedies(dip, commanded)
    )


def letter(k: int) -> str:
    """The letter of the k-th place: A to Z, then AA, AB and so on."""
    before, last = divmod(k, 26)
    return (letter(before - 1) if before else "") + chr(ord("A") + last)


def _remedies(dip: Dip, commanded: float) -> str:
    """What would avoid a dip, in words; empty if nothing is known."""
    remedies = "; or ".join(remedy.words for remedy in followable(dip, commanded))
    return f"Would avoid it: {remedies}." if remedies else ""


def _of_dip(plan: Plan, sample: int) -> str:
    """Why the tip is slow at a sample, and what would avoid it."""
    t = plan.trajectory.t[sample]
    dip = next((dip for dip in plan.dips if abs(dip.t - t) < SAME_DIP), None)
    if dip is None:
        return BUSY
    return f"Cause: {dip.cause}. {_remedies(dip, float(plan.commanded[dip.bead]))}".strip()


def _busy(plan: Plan, sample: int) -> str:
    return BUSY if sample < 0 or plan.trajectory.bead[sample] >= 0 else IN_TRAVEL


def _uncrossed(plan: Plan) -> str:
    """What to change where beads cross."""
    path = getattr(plan.problem.layers.source, "path", None)  # of faces: how they are covered
    if path is None:
        return f"Lines of one layer that cross must be separated where they are drawn. {COUNTED}"
    others = [f"layers.source.path: {name}" for name in ("rows", "tour") if name != path]
    of_samples = "" if path == "rows" else "another layers.source.direction, "
    return f"Another way over the faces: {', '.join(others)}, {of_samples}another layers.source.spacing_mm. {COUNTED}"


def _even_flow(plan: Plan) -> str:
    """What to change where flow is uneven."""
    process, layers = plan.problem.process, plan.problem.layers
    if process.extruder.motor == "on_off":
        joined = getattr(layers, "passes", None) == "joined"
        apart = "layers.passes: apart, so that it is off in the turns of zig-zags; " if joined else ""
        return f"A motor that is only on or off needs an even speed: {apart}{EVEN_SPEED}"
    return LAGGING if process.extruder.lag > 0.0 else SAMPLED


REMEDIES: dict[str, Callable[[Plan], str]] = {
    "beads cross nowhere": _uncrossed,
    "flow per millimetre": _even_flow,
    "steering radius of the fibre": lambda plan: STEERED,
}


def _busiest(plan: Plan, name: str, sample: int) -> int:
    """Index of the joint that uses most of its limit around a sample."""
    order, traj = ORDERS[name], plan.trajectory
    first = max(min(sample - 2, len(traj) - 5), 0)
    about = traj.q[first : first + 5]
    rates = np.abs(np.diff(about, order, axis=0)) / traj.dt**order / getattr(plan.cell.limits, name)
    return int(rates.max(axis=0).argmax())


def _at_its_end(plan: Plan, sample: int) -> str:
    """Name of the revolute joint closest to its end stop: metres cannot be compared with radians."""
    limits, q = plan.cell.limits, plan.trajectory.q[sample]
    margin = np.where(limits.turns, np.minimum(q - limits.q_min, limits.q_max - q), np.inf)
    return str(plan.cell.joint_names[int(margin.argmin())])
