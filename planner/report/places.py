"""Places to go to in the scene: failed checks, the worst of the plan, near bodies, and dips with what would avoid them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from planner.report.templates import render
from planner.report.wording import CHECK_NAMES, significant

if TYPE_CHECKING:
    from planner.plan import Approach, Check, Dip, Plan, Remedy, Trajectory

# ----------------------------------------------------------------------------------------------------
# Approaches: where bodies come nearest to each other.


def approaches_section(plan: Plan, places: Sequence[ReportPlace]) -> Markup:
    """Table of the pairs that come nearest; nothing where no bodies come near. `places` hold them, in the same order."""
    if not plan.approaches:
        return Markup("")
    numbers = [k for k, place in enumerate(places) if place.kind == "near"]
    return render("approaches", near=list(zip(plan.approaches, numbers, strict=True)), t=plan.trajectory)


# ----------------------------------------------------------------------------------------------------
# Dips: marks on the part, a table of those that cost most, and what would avoid them.

MOST_ROWS = 30
SLOWEST_ADVISED = 0.5  # of the commanded speed: nobody would print slower to avoid a dip
MOST_MARKS = 800  # each carries some 300 bytes of words


def worst_first(dips: Sequence[Dip]) -> list[Dip]:
    """Dips by the time that they cost, most first."""
    return sorted(dips, key=lambda dip: -dip.lost)


def without_stops(dips: Sequence[Dip]) -> list[Dip]:
    """Dips but for those where the nozzle has to rest on its bead."""
    return [dip for dip in dips if dip.limit != "stop"]


def samples_of(trajectory: Trajectory, dips: Sequence[Dip]) -> NDArray[np.intp]:
    """Sample at which each dip is slowest."""
    return np.rint(np.array([dip.t for dip in dips]) / trajectory.dt).astype(np.intp)


def dip_marks(plan: Plan) -> dict[str, Any] | None:
    """Marks of the dips that cost most: `point` and `normal` (part frame, m), `sample`, `layer`, `words`, and `cost`, the root
    of the time lost as a share of the most; None without any."""
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


def dips_section(plan: Plan) -> Markup:
    """HTML of the dips: how many, what they cost, by cause, and the worst of them with what would avoid each."""
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
        shown=worst_first(dips)[:MOST_ROWS],
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
# The list of places: failed checks, the worst of the plan, and where bodies come near.

AT_SPEED = 0.98
NEAREST = 3  # approaches in the list; the table has all
SAME_DIP = 1e-6  # s: a dip's slowest sample and the slowest of all are one
PLACEMENT = "another place or turn of the part (python -m planner.place searches for it)"
SINGULAR = f"A nozzle at an angle to the flange (cell.nozzle.axis), or {PLACEMENT}, keeps away from it."
STOPS = f"Another posture to start from (cell.home_deg), or {PLACEMENT}, gives the joint more room."
BUSY = "A wider process.corner_tolerance_mm asks less of it in corners, a lower process.speed_mm_s everywhere."
IN_TRAVEL = "It travels there, as quickly as its limits allow: nothing is printed."
LEANS = "process.cones.nozzle_normal_deg bounds the lean; 0 holds the nozzle upright on the surface."
NEAR = f"More room: {PLACEMENT}; collision.nozzle_mm and collision.arm_mm say what has to be kept."


@dataclass(frozen=True)
class ReportPlace:
    """A place to go to: what is there, its value in words, the sample, and what would help.

    kind  "fail", "worst" or "near"
    pair  the two bodies that come near each other there, if it is about such
    """

    letter: str
    kind: str
    what: str
    value: str
    sample: int
    help: str = ""
    pair: tuple[str, ...] = ()


def places_of(plan: Plan) -> list[ReportPlace]:
    """All places, those of failed checks first; those of the list have letters, in this order, the others none."""
    near = [_near(each) for each in plan.approaches]
    listed = [*_failed(plan), *worst_places(plan), *near[:NEAREST]]
    return [replace(place, letter=_letter(k)) for k, place in enumerate(listed)] + near[NEAREST:]


def worst_places(plan: Plan) -> list[ReportPlace]:
    """The worst places, with the values that the metrics tell.

    While depositing: slowest, nearest to a singularity, leaning most. In the whole motion: nearest to an end stop, hardest
    on the joints.
    """
    traj, series = plan.trajectory, plan.series
    printing, anywhere = np.flatnonzero(traj.deposit), np.arange(len(traj))
    if not len(printing):
        return []
    found: list[tuple[str, str, int, str]] = []
    commanded = plan.commanded[traj.bead[printing]] * 1e3
    speed = traj.speed[printing] * 1e3
    k = int((speed / commanded).argmin())
    if speed[k] < AT_SPEED * commanded[k]:
        i = int(printing[k])
        found.append(("Slowest", f"{speed[k]:.2f} mm/s of {commanded[k]:g} mm/s", i, _of_dip(plan, i)))
    for name, what, words, advice, among in (
        ("sigma", "Nearest to a singularity", "σ {:.4f}", SINGULAR, printing),
        ("wrist_deg", "Wrist nearest to straight", "{:.1f}°", SINGULAR, printing),
        ("limit_margin_deg", "Nearest to an end stop", "{:.1f}°", STOPS, anywhere),
    ):
        if name in series and np.isfinite(series[name][among]).any():
            i = int(among[np.nanargmin(series[name][among])])
            value = words.format(series[name][i])
            found.append((what, value + (_stop(plan, i) if name == "limit_margin_deg" else ""), i, advice))
    for name, what in (
        ("velocity_ratio", "Most of a joint's speed"),
        ("acceleration_ratio", "Most of a joint's acceleration"),
        ("jerk_ratio", "Most of a joint's jerk"),
    ):
        if name in series and np.isfinite(series[name]).any():
            values = np.abs(series[name])
            each = values if values.ndim == 1 else np.where(np.isnan(values), -np.inf, values).max(axis=1)
            i = int(np.nanargmax(each))
            joint = "" if values.ndim == 1 else f" ({plan.cell.joint_names[int(np.nanargmax(values[i]))]})"
            found.append(
                (what, f"{100 * each[i]:.1f} % of the limit{joint}", i, BUSY if traj.bead[i] >= 0 else IN_TRAVEL)
            )
    if "tilt_deg" in series:
        i = int(printing[series["tilt_deg"][printing].argmax()])
        found.append(("Nozzle leans most", f"{series['tilt_deg'][i]:.2f}° from the normal", i, LEANS))
    return [
        ReportPlace(_letter(k), "worst", what, value, i, advice) for k, (what, value, i, advice) in enumerate(found)
    ]


def where_words(plan: Plan, sample: int) -> str:
    """A sample's whereabouts in words: bead, layer, how far along, and the point in the part frame."""
    traj = plan.trajectory
    x, y, z = traj.tip[sample] * 1e3
    line = f"bead {traj.bead[sample]}, layer {traj.layer[sample] + 1}, {traj.s[sample] * 1e3:.1f} mm along it"
    line = line if traj.bead[sample] >= 0 else "in travel"
    return f"{line}; x {x:.1f}, y {y:.1f}, z {z:.1f} mm".replace("-", "−")


def places_data(plan: Plan, places: Sequence[ReportPlace]) -> list[dict[str, Any]]:
    """The same for the page: time, point [m] and outward normal in the part frame, and the words of its card."""
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
    """The body that a name is drawn as: all beads are one."""
    return "print" if name.startswith("bead ") else name


def _failed(plan: Plan) -> list[ReportPlace]:
    """The places of checks that fail, where they have one."""
    return [
        ReportPlace("", "fail", check.name.translate(CHECK_NAMES), _value(check), check.sample, _advice(check))
        for check in plan.checks
        if not check.ok and check.sample >= 0
    ]


def _value(check: Check) -> str:
    return f"{significant(check.worst)} {check.unit}, limit {significant(check.limit)}".replace(" ,", ",")


def _advice(check: Check) -> str:
    """What would help against a failed check, by what it is about."""
    for word, advice in (("clear", NEAR), ("singular", SINGULAR), ("branch", SINGULAR), ("range", STOPS)):
        if word in check.name:
            return advice
    return BUSY if "joint" in check.name else ""


def _near(each: Approach) -> ReportPlace:
    value = f"{each.distance * 1e3:.1f} mm apart, {each.need * 1e3:g} mm to be kept"
    return ReportPlace("", "near", f"{each.a} – {each.b}", value, each.sample, NEAR, (each.a, each.b))


def _of_dip(plan: Plan, sample: int) -> str:
    """Why it is slow there, and what would avoid it."""
    t = plan.trajectory.t[sample]
    dip = next((dip for dip in plan.dips if abs(dip.t - t) < SAME_DIP), None)
    if dip is None:
        return BUSY
    remedies = "; or ".join(remedy.words for remedy in followable(dip, float(plan.commanded[dip.bead])))
    return f"Because of: {dip.cause}." + (f" Would avoid it: {remedies}." if remedies else "")


def _letter(k: int) -> str:
    return chr(ord("A") + k % 26)


def _stop(plan: Plan, sample: int) -> str:
    """Name of the joint that is nearest to its end stop."""
    limits, q = plan.cell.limits, plan.trajectory.q[sample]
    margin = np.minimum(q - limits.q_min, limits.q_max - q)
    return f" ({plan.cell.joint_names[int(margin.argmin())]})"
