"""The single list of the report: each row is one thing that is judged, with its value, limit and tightest place.

A figure has one name, whether it comes from a check, a metric or a place: if a metric's label is the name of a check
and both have the same value, they share a row.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from planner.plan.measures import CHECKS
from planner.plan.measures import METRICS as MEASURES
from planner.report.places import (
    MOST_ROWS,
    ReportPlace,
    Worst,
    check_advice,
    dip_place,
    letter,
    near_place,
    where_shortly,
    without_stops,
    worst_first,
    worst_samples,
)
from planner.report.wording import (
    CHECK_NAMES,
    GROUPS,
    METRICS,
    MISSING,
    RECORD,
    MetricLabel,
    distance,
    duration,
    number,
    significant,
    with_ratios,
)

if TYPE_CHECKING:
    from planner.plan import Approach, Check, Plan

# The rows at the top, one for each entry: of several names, the one that uses most of its limit.
HEADLINES = (
    ("length at commanded speed (±2 %)",),
    ("slowest in deposition",),
    ("print time",),
    ("joint velocity", "joint acceleration", "joint jerk"),
    ("singularity margin",),
    ("joint range",),
    ("nozzle clear of part and print", "arm clear of part and print", "robots clear of each other and of fixtures"),
)
# Checks whose share of the limit says how much margin is left; others keep to a required value.
MARGINS = frozenset(
    {
        *(name for names in HEADLINES for name in names),
        "rail range",
        "axis near the file's normals",
        "nozzle to gravity",
        "layer to gravity",
        "path within corner tolerance",
        "flow per millimetre",
        "print pressed by the nozzle",
        "layers on the part",
        "nozzle normal to the part",
        "beads within the part",
        "layers filled",
        "print on the drawn path",
        "drawn path left out",
    }
)
DEAREST = 3  # dips in the list; their table has all of them
TIGHTEST = 4  # margins that are not folded, at most
TIGHT = 0.5  # share of the limit: if less is used, nothing is tight
SAME = 1e-3  # relative difference within which a check and a metric have the same value
NOTHING = 1e-9  # of any unit
SAME_DISTANCE = 1e-3  # mm: difference within which a check and a pair of bodies have the same distance
UNITS = {"deg": "°"}  # of checks, as they are shown
# These are shown next to the value, others next to the name.
SHORT_UNITS = frozenset({"%", "°", "mm", "mm/s", "s", "s lost", "m", "mm³", "cm³", "×"})
SPANS = ("print_time_s",)  # shown in hours, minutes and seconds
LEAST_OF = {"clearance_min_mm": ("nozzle_clearance_min_mm", "arm_clearance_min_mm", "robot_clearance_min_mm")}
PAIRS = "bodies that come near"


@dataclass(frozen=True)
class JudgedRow:
    """One thing that is judged.

    value, limit  as they are shown; `limit` is empty if there is none
    share  of the limit that is used; None if that is meaningless
    ok     None if nothing is checked
    rivals (text, whether beyond the limit, whether better than this plan) for each other strategy
    better whether this plan is better than all of them
    place  where to go in the scene; None without one
    key    number of the place on the page
    """

    name: str
    unit: str
    value: str
    limit: str = ""
    share: float | None = None
    ok: bool | None = None
    rivals: tuple[tuple[str, bool, bool], ...] = ()
    better: bool = False
    where: str = ""
    text: str = ""
    place: ReportPlace | None = None
    key: int = -1

    @property
    def units(self) -> tuple[str, str]:
        """The units next to the name and next to the value: one of them is empty."""
        return ("", self.unit) if self.unit in SHORT_UNITS else (self.unit, "")


@dataclass(frozen=True)
class JudgedList:
    """The rows of a plan: failures, headlines, where speed is lost and margins are tight, and the rest by groups.

    dips  those of the table of dips that are not in `tight`
    """

    failed: tuple[JudgedRow, ...]
    headlines: tuple[JudgedRow, ...]
    tight: tuple[JudgedRow, ...]
    rest: tuple[tuple[str, tuple[JudgedRow, ...]], ...]
    dips: tuple[JudgedRow, ...]

    @property
    def rows(self) -> Iterator[JudgedRow]:
        """All rows, in the order of the page."""
        yield from (*self.failed, *self.headlines, *self.tight)
        for _, rows in self.rest:
            yield from rows
        yield from self.dips

    @property
    def places(self) -> list[ReportPlace]:
        """All places; the first ones, which are visible without unfolding the list, have letters."""
        return [row.place for row in self.rows if row.place is not None]

    @property
    def dips_places(self) -> list[int]:
        """Numbers of the dips' places, the costliest first."""
        return [row.key for row in self.rows if row.place is not None and row.place.kind == "slow"]


def judged(plan: Plan) -> JudgedList:
    """The list of a plan."""
    others = [values for name, values in plan.baseline.items() if name != plan.strategy]
    worst = worst_samples(plan)
    checks = {row.name: row for row in _checked(plan, others, worst)}
    found = checks | {row.name: row for row in _measured(plan, others, worst) if row.name not in checks}
    found |= {row.name: row for row in _pairs(plan)}
    failed = [row for row in found.values() if row.ok is False]
    holds = {name: row for name, row in found.items() if row.ok is not False}
    headlines = [_tightest([holds[n] for n in names if n in holds]) for names in HEADLINES if holds.keys() & {*names}]
    above = {row.name for row in headlines}
    margins = [row for name, row in holds.items() if name in MARGINS - above and (row.share or 0.0) >= TIGHT]
    margins.sort(key=lambda row: -(row.share or 0.0))
    dips = _dips(plan)
    above |= {row.name for row in margins[:TIGHTEST]}
    folded = {name: row for name, row in holds.items() if name not in above}
    group_of = {name: group for group, names in GROUPS.items() for name in names}
    groups: dict[str, list[JudgedRow]] = {group: [] for group in (*GROUPS, PAIRS)}
    for name, row in folded.items():
        groups[group_of.get(name, PAIRS if row.place is not None and row.place.pair else RECORD)].append(row)
    return _numbered(
        JudgedList(
            tuple(failed),
            tuple(headlines),
            (*dips[:DEAREST], *margins[:TIGHTEST]),
            tuple((group, tuple(rows)) for group, rows in groups.items() if rows),
            tuple(dips[DEAREST:]),
        )
    )


def _tightest(rows: Sequence[JudgedRow]) -> JudgedRow:
    """The row that uses most of its limit."""
    return max(rows, key=lambda row: row.share or 0.0)


def _checked(plan: Plan, others: Sequence[Mapping[str, float]], worst: Mapping[str, Worst]) -> Iterator[JudgedRow]:
    """A row for each check, with the figures of the metric of the same name."""
    metrics = {metric.label: metric for metric in METRICS}
    for check in plan.checks:
        name = check.name.translate(CHECK_NAMES)
        metric = metrics.get(name)
        same = metric is not None and _same(check, metric, plan.metrics)
        place = worst.get(metric.key) if metric is not None else None
        sample = check.sample if check.sample >= 0 or place is None else place.sample
        odd = not check.ok or check.least or check.worst != 0.0
        sample = sample if odd else -1
        if metric is not None and same:
            row = _figure(metric, plan.metrics, others)
            scale = metric.scale
        else:
            row, scale = JudgedRow(name, UNITS.get(check.unit, check.unit), significant(check.worst)), 1.0
        limit = f"{'≥' if check.least else '≤'}\u2009{significant(check.limit * scale)}"
        pair = next(((each.a, each.b) for each in plan.approaches if _is_pair(check, each)), ())
        unit = check.worst_unit if row.unit == check.unit else row.unit
        told = (
            f"{row.value} {unit}".strip() + f", limit {limit}" + (f"; {place.joint}" if place and place.joint else "")
        )
        advice = check_advice(name, plan, sample)
        yield replace(
            row,
            limit=limit,
            share=_share(check),
            ok=bool(check.ok),
            where=", ".join(word for word in (place.joint if place else "", check.where) if odd and word),
            text=CHECKS[check.name].text if check.name in CHECKS else "",
            place=ReportPlace("", "worst" if check.ok else "fail", name, told, sample, advice, pair)
            if sample >= 0
            else None,
        )


def _same(check: Check, metric: MetricLabel, metrics: Mapping[str, float]) -> bool:
    """Whether a check and the metric of its name have the same value, in the same unit or both as a share."""
    unit = UNITS.get(check.unit, check.unit)
    if unit != metric.unit and (unit in SHORT_UNITS or metric.unit != "%"):
        return False
    return math.isclose(metrics.get(metric.key, math.nan), check.worst, rel_tol=SAME, abs_tol=NOTHING)


def _is_pair(check: Check, each: Approach) -> bool:
    """Whether a check gives the distance of a pair of bodies, and names them."""
    named = check.where.startswith(f"{each.a} and {each.b}")
    return named and abs(each.distance * 1e3 - check.worst) < SAME_DISTANCE


def _share(check: Check) -> float | None:
    """Share of its limit that a check's worst value uses; None if the limit is 0, or the worst value no number."""
    if not (math.isfinite(check.worst) and check.limit > 0.0):
        return None
    if not check.least:
        return max(check.worst, 0.0) / check.limit
    return check.limit / check.worst if check.worst > 0.0 else None


def _figure(metric: MetricLabel, mine: Mapping[str, float], others: Sequence[Mapping[str, float]]) -> JudgedRow:
    """A metric next to those of the other strategies."""
    value, *theirs = (_scaled(each.get(metric.key), metric) for each in (mine, *others))
    ahead = [_ahead(value, other, metric) for other in theirs]
    rivals = tuple(
        (_shown(metric, other), other is not None and round(other, 6) > metric.limit, k < 0)
        for other, k in zip(theirs, ahead, strict=True)
    )
    unit = "" if metric.key in SPANS else metric.unit
    text = MEASURES[metric.key].text if metric.key in MEASURES else ""
    return JudgedRow(
        metric.label, unit, _shown(metric, value), rivals=rivals, better=bool(ahead) and min(ahead) > 0, text=text
    )


def _ahead(value: float | None, other: float | None, metric: MetricLabel) -> int:
    """1 if a value is better than another one, -1 if it is worse, both as shown; 0 if equal or not comparable."""
    if value is None or other is None or not metric.better:
        return 0
    mine, its = round(value, metric.digits), round(other, metric.digits)
    return ((mine > its) - (mine < its)) * (1 if metric.better == "up" else -1)


def _scaled(value: float | None, metric: MetricLabel) -> float | None:
    return None if value is None or math.isnan(value) else float(value) * metric.scale


def _shown(metric: MetricLabel, value: float | None) -> str:
    if value is None:
        return MISSING
    return duration(value) if metric.key in SPANS else distance(metric.key, value, metric.digits)


def _measured(plan: Plan, others: Sequence[Mapping[str, float]], worst: Mapping[str, Worst]) -> Iterator[JudgedRow]:
    """A row for each metric that a strategy has."""
    mine, theirs = with_ratios(plan.metrics), [with_ratios(values) for values in others]
    for metric in METRICS:
        if metric.key in LEAST_OF and any(key in mine for key in LEAST_OF[metric.key]):
            continue
        if all(_scaled(values.get(metric.key), metric) is None for values in (mine, *theirs)):
            continue
        row, at = _figure(metric, mine, theirs), worst.get(metric.key)
        if at is None:
            yield row
            continue
        told = f"{row.value} {row.unit}".strip()
        place = ReportPlace("", "worst", row.name, told, at.sample, at.help)
        yield replace(row, where=", ".join(filter(None, (at.joint, where_shortly(plan, at.sample)))), place=place)


def _pairs(plan: Plan) -> Iterator[JudgedRow]:
    """A row for each pair of bodies that come near each other, except those that a check covers."""
    for each in plan.approaches:
        if any(_is_pair(check, each) for check in plan.checks):
            continue
        place = near_place(each)
        ok = None if each.distance >= each.need - NOTHING else False
        share = each.need / each.distance if each.distance > 0.0 else None
        value, limit = number(each.distance * 1e3, 1), f"≥\u2009{significant(each.need * 1e3)}"
        yield JudgedRow(place.what, "mm", value, limit, share, ok, where=where_shortly(plan, each.sample), place=place)


def _dips(plan: Plan) -> list[JudgedRow]:
    """A row for each of the dips that cost most."""
    rows = []
    for dip in worst_first(without_stops(plan.dips))[:MOST_ROWS]:
        place = dip_place(plan, dip)
        rows.append(
            JudgedRow(
                place.what,
                "s lost",
                number(dip.lost, 3),
                where=f"{dip.speed * 1e3:.1f} mm/s; {where_shortly(plan, place.sample)}",
                place=place,
            )
        )
    return rows


def _numbered(found: JudgedList) -> JudgedList:
    """The list with its places numbered, and lettered if they are not folded."""
    numbers, letters = itertools.count(), itertools.count()

    def placed(rows: Sequence[JudgedRow], lettered: bool = False) -> tuple[JudgedRow, ...]:
        out = []
        for row in rows:
            if row.place is not None:
                name = letter(next(letters)) if lettered else ""
                row = replace(row, place=replace(row.place, letter=name), key=next(numbers))
            out.append(row)
        return tuple(out)

    return JudgedList(
        placed(found.failed, True),
        placed(found.headlines, True),
        placed(found.tight, True),
        tuple((group, placed(rows)) for group, rows in found.rest),
        placed(found.dips),
    )
