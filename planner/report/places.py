"""Places to go to in the scene: failed checks, the worst of the plan, and where bodies come near; and dips beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from planner.report.wording import CHECK_NAMES, significant

if TYPE_CHECKING:
    from planner.plan import Approach, Check, Plan

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
class Place:
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


def places_of(plan: Plan) -> list[Place]:
    """All places, those of failed checks first; those of the list have letters, in this order, the others none."""
    near = [_near(each) for each in plan.approaches]
    listed = [*_failed(plan), *worst_places(plan), *near[:NEAREST]]
    return [replace(place, letter=_letter(k)) for k, place in enumerate(listed)] + near[NEAREST:]


def worst_places(plan: Plan) -> list[Place]:
    """The worst places, with the values that the metrics tell.

    While depositing: slowest, nearest to a singularity, leaning most. In the whole motion: nearest to an end stop, hardest
    on the joints.
    """
    traj, series = plan.trajectory, plan.series
    printing, anywhere = np.flatnonzero(traj.deposit), np.arange(len(traj))
    if not len(printing):
        return []
    found: list[tuple[str, str, int, str]] = []
    commanded = plan.problem.process.speed * 1e3
    speed = traj.speed * 1e3
    i = int(printing[speed[printing].argmin()])
    if speed[i] < AT_SPEED * commanded:
        found.append(("Slowest", f"{speed[i]:.2f} mm/s of {commanded:g} mm/s", i, _of_dip(plan, i)))
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
    return [Place(_letter(k), "worst", what, value, i, advice) for k, (what, value, i, advice) in enumerate(found)]


def where_words(plan: Plan, sample: int) -> str:
    """A sample's whereabouts in words: bead, layer, how far along, and the point in the part frame."""
    traj = plan.trajectory
    x, y, z = traj.tip[sample] * 1e3
    line = f"bead {traj.bead[sample]}, layer {traj.layer[sample] + 1}, {traj.s[sample] * 1e3:.1f} mm along it"
    line = line if traj.bead[sample] >= 0 else "in travel"
    return f"{line}; x {x:.1f}, y {y:.1f}, z {z:.1f} mm".replace("-", "−")


def places_data(plan: Plan, places: Sequence[Place]) -> list[dict[str, Any]]:
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


def _failed(plan: Plan) -> list[Place]:
    """The places of checks that fail, where they have one."""
    return [
        Place("", "fail", check.name.translate(CHECK_NAMES), _value(check), check.sample, _advice(check))
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


def _near(each: Approach) -> Place:
    value = f"{each.distance * 1e3:.1f} mm apart, {each.need * 1e3:g} mm to be kept"
    return Place("", "near", f"{each.a} – {each.b}", value, each.sample, NEAR, (each.a, each.b))


def _of_dip(plan: Plan, sample: int) -> str:
    """Why it is slow there, and what would avoid it."""
    t = plan.trajectory.t[sample]
    dip = next((dip for dip in plan.dips if abs(dip.t - t) < SAME_DIP), None)
    if dip is None:
        return BUSY
    remedies = "; or ".join(remedy.words for remedy in dip.remedies)
    return f"Because of: {dip.cause}." + (f" Would avoid it: {remedies}." if remedies else "")


def _letter(k: int) -> str:
    return chr(ord("A") + k % 26)


def _stop(plan: Plan, sample: int) -> str:
    """Name of the joint that is nearest to its end stop."""
    limits, q = plan.cell.limits, plan.trajectory.q[sample]
    margin = np.minimum(q - limits.q_min, limits.q_max - q)
    return f" ({plan.cell.joint_names[int(margin.argmin())]})"
