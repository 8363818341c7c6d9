"""Rows of runs → results: what repeats of one run have in common, which rows belong together, ours next to the peers'."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.rows import BETWEEN, Row, key_of

OURS = "beadwise"
CHOSEN = "sqp"  # the strategy of ours that is set beside the peers: the default one
ALONE = "sqp, no bodies"  # the same without collision, as peers plan: it races them where there is such a row
PATHS_ALONE = ("resolve",)
ALIKE = ("timing", "travel", "verify")  # our work for both sides
COMMON = (*PATHS_ALONE, *ALIKE)  # stages of both sides: peers are given cell and toolpath
DEGREES = 57.29577951308232
LONGEST_REASON = 90  # characters of why a file has no verified plan
FILES_ON = "cell="  # how the settings of rows begin whose problem is a file of others, see `benchmarks.published`


@dataclass(frozen=True)
class Measure:
    """A figure of a row: its name, how it is found (None where the row has none), and how it is written."""

    name: str
    of: Callable[[Row], float | None]
    form: Callable[[float], str]


@dataclass(frozen=True)
class Spread:
    """Median of repeats, and their least and greatest."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Result:
    """Repeats of one run, and what they share; the reason is the first one's."""

    problem: str
    set: str
    strategy: str
    planner: str
    reason: str
    rows: tuple[Row, ...]

    @property
    def ours(self) -> bool:
        """Whether it is this planner's."""
        return self.planner.startswith(OURS)

    @property
    def found(self) -> bool:
        """Whether every repeat gave a plan."""
        return all(bool(row["found"]) for row in self.rows)

    @property
    def verified(self) -> bool:
        """Whether every repeat gave one that holds all checks."""
        return all(bool(row["verified"]) for row in self.rows)

    @property
    def label(self) -> str:
        """The strategy; of a peer that has but one way its own name."""
        return self.strategy or self.planner

    def spread(self, measure: Measure) -> Spread | None:
        """A measure over the repeats; None where any repeat has none."""
        values = [measure.of(row) for row in self.rows]
        known = [value for value in values if value is not None]
        if len(known) < len(values):
            return None
        return Spread(statistics.median(known), min(known), max(known))


def number(row: Row, name: str) -> float | None:
    """A column's number, None where the cell is empty."""
    value = row[name]
    return None if value == "" else float(value)


def _column(name: str, factor: float = 1.0) -> Callable[[Row], float | None]:
    def value(row: Row) -> float | None:
        found = number(row, name)
        return None if found is None else factor * found

    return value


def _ratio(above: str, below: str) -> Callable[[Row], float | None]:
    def value(row: Row) -> float | None:
        a, b = number(row, above), number(row, below)
        return None if a is None or not b else a / b

    return value


def _per_second(stages: Sequence[str]) -> Callable[[Row], float | None]:
    """Waypoints per second of some stages; those that a row lacks count nothing."""

    def value(row: Row) -> float | None:
        waypoints = number(row, "waypoints")
        seconds = sum(number(row, f"seconds_{stage}") or 0.0 for stage in stages)
        return None if waypoints is None or not seconds else waypoints / seconds

    return value


AT_SPEED = Measure("at speed", _column("at_speed_fraction"), lambda x: f"{100 * x:.1f} %")
OVER_IDEAL = Measure("deposition / ideal", _ratio("deposition_time_s", "ideal_deposition_time_s"), lambda x: f"{x:.3f}")
OVER_BOUND = Measure("deposition / bound", _ratio("deposition_time_s", "bound_deposition_time_s"), lambda x: f"{x:.3f}")
BOUND = Measure("bound / ideal", _ratio("bound_deposition_time_s", "ideal_deposition_time_s"), lambda x: f"{x:.3f}")
SIGMA = Measure("σ min", _column("sigma_min"), lambda x: f"{x:.3f}")
JERK = Measure("jerk / limit", _column("jerk_ratio_max"), lambda x: f"{x:.3f}")
MARGIN = Measure("limit margin °", _column("limit_margin_rad", DEGREES), lambda x: f"{x:.1f}")
STEP = Measure("joint step °", _column("joint_step_max_rad", DEGREES), lambda x: f"{x:.2f}")
OFF = Measure("off the path mm", _column("position_error_max_mm"), lambda x: f"{x:.4f}")
RATE = Measure("waypoints/s", _column("waypoints_per_s"), lambda x: f"{x:,.0f}")
PATHS = Measure("joint paths/s", _per_second(PATHS_ALONE), lambda x: f"{x:,.0f}")
PLANS = Measure("plans/s", _per_second(COMMON), lambda x: f"{x:,.0f}")
NO_SEARCH = Measure("plans/s if joint paths took no time", _per_second(ALIKE), lambda x: f"{x:,.0f}")
SECONDS = Measure("whole run s", _column("seconds_total"), lambda x: f"{x:,.1f}")
WHOLE = Measure("print s", _column("print_time_s"), lambda x: f"{x:,.1f}")
RESOLVE = Measure("resolve s", _column("seconds_resolve"), lambda x: f"{x:,.2f}")
CPU = Measure("processor s", _column("cpu_s"), lambda x: f"{x:,.1f}")
MEMORY = Measure("MB", _column("peak_mb"), lambda x: f"{x:,.0f}")


def of_one_commit(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """The last row of every run of that commit and machine whose row is the newest, and all rows of others."""
    if not rows:
        return [], []
    newest = max(rows, key=lambda row: str(row["date"]))
    here = (newest["commit"], newest["machine"])
    ours = {key_of(row): row for row in rows if (row["commit"], row["machine"]) == here}
    return list(ours.values()), [row for row in rows if (row["commit"], row["machine"]) != here]


def is_file(row: Row) -> bool:
    """Whether a row is of a file that others published, on a cell of ours."""
    return str(row["set"]).startswith(FILES_ON)


@dataclass(frozen=True)
class OfFiles:
    """What became of files of others that were planned alike."""

    on: str
    strategy: str
    rows: tuple[Row, ...]

    @property
    def verified(self) -> list[Row]:
        """Those whose plan holds all checks."""
        return [row for row in self.rows if row["verified"] is True]

    @property
    def failed(self) -> int:
        """How many have a plan of which not all checks hold."""
        return sum(row["found"] is True for row in self.rows) - len(self.verified)

    @property
    def without_plan(self) -> int:
        """How many have none."""
        return len(self.rows) - len(self.verified) - self.failed

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """Why plans are not there, or not verified, cut where they are long, and of how many; the most frequent first."""
        bad = (str(row["reason"])[:LONGEST_REASON] for row in self.rows if row["verified"] is not True)
        return Counter(bad).most_common()

    def values(self, measure: Measure) -> list[float]:
        """A measure of the verified ones, sorted; empty where any of them has none."""
        known = [measure.of(row) for row in self.verified]
        return [] if None in known else sorted(value for value in known if value is not None)


def files_of(rows: Sequence[Row]) -> list[OfFiles]:
    """Rows of files by the cell and the settings they were planned with."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in filter(is_file, rows):
        groups.setdefault((str(row["set"]).partition(BETWEEN)[0], str(row["strategy"])), []).append(row)
    return [OfFiles(*planned, tuple(group)) for planned, group in groups.items()]


def results_of(rows: Sequence[Row]) -> list[Result]:
    """Rows by run, repeats together; ours first, in order of problems, then of what the rows begin with."""
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in rows:
        shared = (str(row["problem"]), str(row["set"]), str(row["strategy"]), str(row["planner"]))
        groups.setdefault(shared, []).append(row)
    results = [Result(*shared, str(group[0]["reason"]), tuple(group)) for shared, group in groups.items()]
    return sorted(results, key=lambda result: (not result.ours, result.problem, result.set))


@dataclass(frozen=True)
class Race:
    """Ours beside the peer that is fastest at something: who that is, and both by waypoints per second.

    ours, theirs  both for the poses that the peer was given; a bead of ours may have more points
    """

    peer: Result
    ours: float
    theirs: float

    @property
    def ratio(self) -> float:
        """How many times as fast ours is."""
        return self.ours / self.theirs


@dataclass(frozen=True)
class Versus:
    """Ours on a problem, by the strategy that counts and by others, beside the peers that were given it.

    plans      timed and verified, which is our work for peers; None where no peer verifies, or ours does not
    joints     joint paths alone; both without collision on our side too, where that was run
    ceiling    what the ratio of `plans` would be if our joint paths took no time: the rest is the same work on both sides
    no_worse   measure → whether ours is at least as good as the best of the peers that verify
    best       measure → that peer
    """

    ours: Result
    beside: tuple[Result, ...]
    plans: Race | None
    joints: Race | None
    ceiling: float | None
    no_worse: dict[str, bool]
    best: dict[str, Result]


NOT_WORSE = (SIGMA, MARGIN, AT_SPEED)  # more is better
_AS_GOOD = 1e-3  # relative: less is below what the figures show


def against_peers(results: Sequence[Result]) -> list[Versus]:
    """Every problem that peers were given too, with the same settings."""
    found = []
    for ours in results:
        same = [r for r in results if r is not ours and (r.problem, r.set) == (ours.problem, ours.set)]
        if ours.ours and ours.strategy == CHOSEN and any(not r.ours for r in same):
            found.append(_versus(ours, same))
    return found


def _versus(ours: Result, beside: Sequence[Result]) -> Versus:
    good = [peer for peer in beside if not peer.ours and peer.verified]
    racing = next((r for r in beside if r.ours and r.strategy == ALONE), ours)
    no_worse, best = {}, {}
    for measure in NOT_WORSE:
        known = [(spread.median, peer) for peer in good if (spread := peer.spread(measure)) is not None]
        own = ours.spread(measure)
        if known:
            most, peer = max(known, key=lambda each: each[0])
            best[measure.name] = peer
            no_worse[measure.name] = own is not None and ours.verified and own.median >= most * (1.0 - _AS_GOOD)
    plans = race(racing, good, PLANS)
    own, alike = racing.spread(PLANS), racing.spread(NO_SEARCH)
    ceiling = plans.ratio * alike.median / own.median if plans and own and alike else None
    return Versus(ours, tuple(beside), plans, race(racing, good, PATHS), ceiling, no_worse, best)


def race(ours: Result, peers: Sequence[Result], measure: Measure) -> Race | None:
    """Ours beside the one of some peers that is fastest; None where there is none, or ours is not verified."""
    own = ours.spread(measure)
    known = [(spread.median, peer) for peer in peers if (spread := peer.spread(measure)) is not None]
    if not known or own is None or not ours.verified:
        return None
    theirs, peer = max(known, key=lambda each: each[0])
    return Race(peer, own.median * float(peer.rows[0]["waypoints"]) / float(ours.rows[0]["waypoints"]), theirs)
