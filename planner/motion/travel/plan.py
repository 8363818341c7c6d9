"""Travel between beads: the quickest way that is clear of the part and within all limits."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from types import MappingProxyType

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import Refusal
from planner.cell.cell import Cell
from planner.collision.scene import NOTHING, Obstacles
from planner.motion.cubics import Cubics, JointState, add, extremes, rest
from planner.motion.timing.profile import HEADROOM
from planner.motion.timing.timed_path import TimedPath
from planner.motion.travel import ways
from planner.motion.travel.clearance import TravelClearance, fine, glance, track, travel_clearance
from planner.motion.travel.detours import FITS, ClearSpace, along_tips, arc, around, shorter
from planner.motion.travel.moves import between
from planner.motion.travel.ways import Built, Caps, Ends, at_rest, reaching
from planner.motion.visits import visits
from planner.problem.process import ProcessSpec
from planner.toolpath.bead import Bead, Surface, Toolpath
from planner.toolpath.runs import least_travel_time

LOW_HUMPS = (0.6, 0.35)  # × the least lift: how far the nozzle is raised where little is enough, as for beads close by
HIGH_HUMPS = (1.6, 2.5)  # × the least lift, where the lift alone is not enough
LIFTS = (1.0, 2.0, 4.0, 8.0, 16.0)  # × the least lift, for ways that rest once they are lifted
_OVER = 2.0  # × its height: a bead that stands out by more than this is over a gap, and not just a layer higher
_SPARE = 2e-5  # m kept in addition to a travel's clearance, since it is checked in steps
_SLIGHT = 1e-4  # m of clearance that it may lack if there is no other way, as next to an end that has just enough
_DEEP = 1e-3  # m: if there is no way, an end that lacks more clearance than this is reported as the reason
_SLOWER_TRIES = 12  # each brings the tip's speed down to the limit or close to it
_AIM, _FAST = 0.98, 0.995  # shares of the tip's greatest speed: the target, and what is slow enough between instants
_ARC = 1.5  # × the straight move's time: an arc is rarely faster than this
_MUCH = 0.5  # s: a way with rests that takes this much more than the least time is shortened
_EQUAL = 1e-3  # s by which a way may be slower than one that is less preferred
_ROUNDING = 1e-6  # s that a travel lasts longer than it has to
_LIMIT_ROUNDING = 1e-9  # share of a limit
_PLACES = 31  # tip positions on a straight line along the normal
_LEAST = 1e-6  # m: a lower lift counts as none
_HOLDER_STEP = 5e-3  # m: greatest motion of what the holder carries between two postures that are checked
_ROUNDED = 1e-9  # m of clearance, for rounding
# Position, velocity and acceleration after three equal phases of constant jerk, per jerk of each (in h^3, h^2, h).
_REACHED = np.array([[19.0 / 6.0, 7.0 / 6.0, 1.0 / 6.0], [2.5, 1.5, 0.5], [1.0, 1.0, 1.0]])
NO_WAITS: Mapping[int, float] = MappingProxyType({})
_LONGER = 1.0 + 1e-9  # × the duration that keeps a limit, for rounding


@dataclass(frozen=True)
class TravelTask:
    """One travel: its ends, what it keeps clear of, how fast the tip may move over the part [m/s].

    obstacles, now   what bodies keep clear of, at this progress of the print [beads]
    margin           how much they keep beyond their clearance [m]; negative if an end of the travel itself lacks some
    """

    cell: Cell
    ends: Ends
    room: TravelClearance
    speed: float
    obstacles: Obstacles = NOTHING
    now: float = 0.0
    margin: float = 0.0

    @property
    def space(self) -> ClearSpace:
        """Where the travel may be."""
        return ClearSpace(self.cell, self.room, self.speed, self.obstacles, self.now, self.margin)

    def hit(self, motion: Cubics) -> int:
        """Number of a pair of bodies that come too close along a motion, or -1."""
        if not self.obstacles.any:
            return -1
        return self.obstacles.hit(fine(motion, self.obstacles.swing), self.now, self.margin)


@dataclass(frozen=True)
class ViaRest:
    """Travel to and from a place to rest, which is home, or lifted above the previous bead."""

    out: Cubics
    back: Cubics

    @property
    def duration(self) -> float:
        """Duration of both ways together, without the rest [s]."""
        return self.out.duration + self.back.duration


Travel = Cubics | ViaRest


def plan_travels(
    cell: Cell,
    timed: Sequence[TimedPath],
    toolpath: Toolpath,
    process: ProcessSpec,
    which: Sequence[int] | None = None,
    obstacles: Obstacles = NOTHING,
    within: Mapping[int, float] = NO_WAITS,
) -> list[Travel]:
    """Plan travel from home to the first bead, between beads, and home: one more than are timed; or `which` of them.

    timed: all beads of the toolpath, or the last ones, if those before are there from the beginning.

    within: travels, by number, that leave time for a rest, and how long they may take [s]. They rest at home or, where
    that would take longer, lifted; if neither place can be reached, they spend all of that time on their way.

    With the adjacent runs, each travel leaves the extruder time to retract and prime. Where there is something to wait
    for (see `visits`), it goes by way of home. Raises Refusal if no way is clear of the part, the print and obstacles.
    """
    beads, before = toolpath.beads, len(toolpath.beads) - len(timed)
    surfaces = [toolpath.surface.before(i) for i in range(len(beads) + 1)]
    printed = _grown(beads, surfaces)
    travels: list[Travel] = []
    by_home = visits(process, beads, timed)
    bounds = ways.bounds_of(cell)

    around = {
        name: (own := cell.at(name), obstacles.for_nozzle(cell, own))
        for name in dict.fromkeys(bead.material for bead in beads)
    }

    def home_beside(i: int, state: JointState | None, material: str) -> JointState:
        """Home with the holder where it is at a bead's end, or at its own home if only that is clear."""
        beside = _home_beside(cell, state)
        both = np.stack([beside.q, cell.home])
        margins, _ = around[material][1].margins(both, np.full(2, float(i)), _SPARE)
        return at_rest(cell.home.copy()) if margins[0] < 0.0 <= margins[1] else beside

    def way(
        i: int, start: JointState, end: JointState, leave: TimedPath | None, reach: TimedPath | None, lasts: float = 0.0
    ) -> Cubics:
        cell, obstacles = around[_material(leave, reach)]
        space = travel_clearance(cell, surfaces[i], printed[i], process.lift, start, end)
        ends = Ends(start, end, max(lasts, _least(process, toolpath, leave, reach)), bounds)
        find = upright if process.travels_upright else with_time
        margins, _ = obstacles.margins(np.stack([start.q, end.q]), np.full(2, float(i)), _SPARE)
        least = float(margins.min(initial=_SPARE))
        at_home = [leave is None, reach is None]
        if least < -_DEEP and least == margins[at_home].min(initial=np.inf):
            task = TravelTask(cell, ends, space, process.travel_speed, obstacles, float(i))
            beside = leave if reach is None else reach
            raise Refusal(
                too_near(task, "at home"),
                bead=None if beside is None else beside.path.task.bead,
                hints=("choose a cell.home_deg that is clear of part and print",),
            )
        task = TravelTask(cell, ends, space, process.travel_speed, obstacles, float(i), least - _ROUNDED)
        motion = find(task)
        if motion is None and obstacles.any:
            task = replace(task, margin=min(least, 0.0) - _SLIGHT)
            motion = find(task)
        if motion is None:
            beside = leave if reach is None else reach
            reason = too_near(task) if least < -_DEEP else no_way(task, find)
            raise Refusal(reason, bead=None if beside is None else beside.path.task.bead)
        return motion

    def by_way_of(i: int, rest: JointState, leave: TimedPath, reach: TimedPath) -> ViaRest:
        return ViaRest(way(i, leave.end, rest, leave, None), way(i, rest, reach.start, None, reach))

    def with_rest(i: int, longest: float, leave: TimedPath, reach: TimedPath) -> Travel:
        found: list[ViaRest] = []
        material = _material(leave, reach)
        cell, _ = around[material]
        space = travel_clearance(cell, surfaces[i], printed[i], process.lift, leave.end, reach.start)
        lifted, _ = above(cell, Ends(leave.end, reach.start, 0.0, bounds), space, space.lift)
        for place in (home_beside(i, leave.end, material), lifted):
            if not (found and found[0].duration <= longest):
                with suppress(Refusal):
                    found.append(by_way_of(i, place, leave, reach))
        if not found:
            return way(i, leave.end, reach.start, leave, reach, longest)
        return min(found, key=attrgetter("duration"))

    for k in range(len(timed) + 1) if which is None else which:
        i = before + k
        leave = timed[k - 1] if k > 0 else None
        reach = timed[k] if k < len(timed) else None
        material = _material(leave, reach)
        start = home_beside(i, None if reach is None else reach.start, material) if leave is None else leave.end
        end = home_beside(i, None if leave is None else leave.end, material) if reach is None else reach.start
        if leave is None or reach is None or (i not in by_home and k not in within):
            travels.append(way(i, start, end, leave, reach))
        elif i in by_home:
            travels.append(by_way_of(i, home_beside(i, start, material), leave, reach))
        else:
            travels.append(with_rest(i, within[k], leave, reach))
    return travels


def _grown(beads: Sequence[Bead], surfaces: Sequence[Surface]) -> list[float]:
    """How far the print stands out of the surface before each bead, and after the last one (n + 1) [m].

    surfaces: those before each bead and after the last one. A bead over a gap stands out by half its width until its
    layer becomes part of the surface, and is then measured again.
    """
    lasting, most, out = 0.0, 0.0, [0.0]
    layer, over = -1, list[tuple[float, Bead, Surface]]()
    for bead, surface in zip(beads, surfaces[1:], strict=True):
        if bead.layer != layer:
            for height, below, before in over:
                if below.layer < bead.layer:
                    lasting = max(lasting, height if surface is before else _stands_out(below, surface))
            over = [each for each in over if each[1].layer >= bead.layer]
            layer, most = bead.layer, max((height for height, *_ in over), default=0.0)
        height = _stands_out(bead, surface)
        if height > _OVER * float(bead.height.max()):
            most = max(most, height)
            over.append((height, bead, surface))
        else:
            lasting = max(lasting, height)
        out.append(max(lasting, most))
    return out


def _stands_out(bead: Bead, surface: Surface) -> float:
    return float(surface.signed_distance(bead.points).max())


def no_way(task: TravelTask, find: Callable[[TravelTask], Cubics | None]) -> str:
    """Why there is no way: what a way planned without obstacles would run into, if there is one."""
    motion = find(replace(task, obstacles=NOTHING)) if task.obstacles.any else None
    if motion is None:
        return "no way to or from this bead is clear of the part, and within the limits of joints and travel speed"
    one, other = task.obstacles.names(task.hit(motion))
    return f"collision of {one} with {other} on the way to or from this bead, and no way round was found"


def too_near(task: TravelTask, place: str = "") -> str:
    """Which bodies lack clearance where a travel starts or ends, and how much.

    place: where that is, in words, if it is not a bead's end
    """
    both = np.stack([task.ends.start.q, task.ends.end.q])
    margins, which = task.obstacles.margins(both, np.full(2, task.now), _SPARE)
    k = int(margins.argmin())
    one, other = task.obstacles.names(int(which[k]))
    where = place or f"where this bead {'begins' if k else 'ends'}, and no way from there is clear"
    return f"{one} and {other} lack {-1e3 * margins[k]:.1f} mm of clearance {where}"


def _least(process: ProcessSpec, toolpath: Toolpath, leave: TimedPath | None, reach: TimedPath | None) -> float:
    """Least duration of the travel between two beads [s]: the time the extruder needs, less that of the runs."""
    left, reached = (None if end is None else toolpath.beads[end.path.task.bead].material for end in (leave, reach))
    least = least_travel_time(process, left, reached)
    if least > 0.0 and leave is not None:
        task = leave.path.task
        least -= leave.duration - leave.when(float(task.s[task.last]))
    if least > 0.0 and reach is not None:
        least -= reach.when(0.0)
    return least + _ROUNDING if least > 0.0 else 0.0


def _material(leave: TimedPath | None, reach: TimedPath | None) -> str:
    """The material whose nozzle is in use between two beads; it changes only when the arm is at home."""
    beside = leave if reach is None else reach
    if beside is None:
        raise ValueError("a travel starts or ends at a bead")
    return beside.path.task.material


def _home_beside(cell: Cell, state: JointState | None) -> JointState:
    """At rest with the arm at home; the holder stays where it is at the bead's end."""
    home = cell.home.copy()
    if state is not None:
        home[len(cell.arm) :] = state.q[len(cell.arm) :]
    return JointState(home, np.zeros_like(home), np.zeros_like(home))


@dataclass(frozen=True)
class TravelWay:
    """One way to travel: how to build it below velocity caps, and a lower bound, or nearly one, of its duration [s].

    instead  what to try if it is not clear of the part
    vias     postures (nj) at which it rests, for ways of that kind
    """

    build: Callable[[Caps], Built | None]
    bound: float
    instead: tuple[TravelWay, ...] = ()
    vias: Callable[[], Sequence[Array]] | None = None


def quickest(task: TravelTask) -> Cubics | None:
    """The quickest of all ways that are clear and within limits; None if there is none.

    A way's duration is cheap to compute, its clearance is more expensive. So ways are built in the order of their lower
    bounds, and checked in the order of their durations; a way whose tip is too fast goes back into the queue, slowed
    down, unless a glance shows that it is not clear.
    """
    cell = task.cell
    if _holder_is_barred(task):
        return None
    free = free_caps(cell)
    number = itertools.count()
    queue: list[tuple[float, int, TravelWay, Caps, Built | None, int]] = []

    def push(bound: float, way: TravelWay, caps: Caps, built: Built | None = None, tries: int = 0) -> None:
        heapq.heappush(queue, (bound, next(number), way, caps, built, tries))

    for way in _ways(task, free):
        push(way.bound, way, free)
    roundabout: Iterator[list[Array]] = iter(())
    if task.obstacles.any:
        roundabout = around(task.space, task.ends)
    while True:
        if not queue:
            vias = next(roundabout, None)
            if vias is None:
                return None
            push(0.0, _resting(task, partial(list, vias), 0.0), free)
            continue
        bound, _, way, caps, built, tries = heapq.heappop(queue)
        if built is None:
            built = way.build(caps)
            if built is not None and queue and built.motion.duration > queue[0][0] + _EQUAL:
                push(built.motion.duration, way, caps, built, tries)
                continue
        clear = built is not None and within_limits(cell, built.motion)
        if built is not None and clear:
            clear, tip_speed = _look(task, built.motion)
            if clear and tip_speed <= _FAST * task.speed:
                return built.motion if way.vias is None else cut_short(task, way.vias(), built.motion)
            if clear and tries < _SLOWER_TRIES:
                slower = _slower(built, _AIM * task.speed / tip_speed)
                push(built.motion.duration, way, slower, tries=tries + 1)
        if not clear:
            for other in way.instead:
                push(max(bound, other.bound), other, free)


def free_caps(cell: Cell) -> Caps:
    """Caps without effect."""
    return Caps(np.full(len(cell.home), np.inf), np.full(len(cell.arm), np.inf))


def _resting(
    task: TravelTask, vias: Callable[[], Sequence[Array]], bound: float, instead: tuple[TravelWay, ...] = ()
) -> TravelWay:
    """The way that rests at postures (nj)."""

    def build(caps: Caps) -> Built | None:
        return ways.resting_at(task.cell, task.ends, vias(), _AIM * task.speed, caps)

    return TravelWay(build, bound, instead, vias)


def cut_short(task: TravelTask, vias: Sequence[Array], resting: Cubics) -> Cubics:
    """A clear way that rests at postures (nj), or a shorter one that is clear and quicker, if that may save much.

    If no obstacles are known, nothing is cut: a wide detour is more likely to be clear of unknown ones.
    """
    direct = ways.straight(task.cell, replace(task.ends, least=0.0), free_caps(task.cell))
    chord = float(np.linalg.norm(task.room.tips[1] - task.room.tips[0])) / task.speed
    least = max(chord, task.ends.least, 0.0 if direct is None else direct.motion.duration)
    if not task.obstacles.any or len(vias) < 3 or resting.duration < least + _MUCH:
        return resting
    built = ways.resting_at(task.cell, task.ends, shorter(task.space, vias), _AIM * task.speed, free_caps(task.cell))
    if built is None or built.motion.duration >= resting.duration or not within_limits(task.cell, built.motion):
        return resting
    clear, tip_speed = _look(task, built.motion)
    return built.motion if clear and tip_speed <= _FAST * task.speed else resting


def _holder_is_barred(task: TravelTask) -> bool:
    """Whether the holder's only axis, on its way, brings its load too close to bodies that the arm does not move.

    Then no motion of the arm helps. A holder with more than one axis can go around.
    """
    na, start, end = len(task.cell.arm), task.ends.start.q, task.ends.end.q
    if not task.obstacles.any or len(start) != na + 1:
        return False
    still = task.obstacles.but_arm
    if not still.any:
        return False
    steps = 2 + int(abs(end[na] - start[na]) * still.swing[na] / _HOLDER_STEP)
    q = np.tile(start, (steps, 1))
    q[:, na] = np.linspace(start[na], end[na], steps)
    return still.hit(q, task.now, task.margin) >= 0


def _look(task: TravelTask, motion: Cubics) -> tuple[bool, float]:
    """Whether a motion is clear, and how fast its tip is [m/s].

    If it is too fast, it is only glanced at, which reveals collisions with the part: it will be checked once it is
    slowed down, if it is still the quickest then.
    """
    rough = glance(task.cell, motion)
    if task.room.lacking(rough.points) > 0.0:
        return False, rough.tip_speed
    if rough.tip_speed > _FAST * task.speed:
        return True, rough.tip_speed
    looked = track(task.cell, motion, rough)
    return task.room.lacking(looked.points) <= 0.0 and task.hit(motion) < 0, looked.tip_speed


def with_time(task: TravelTask) -> Cubics | None:
    """The quickest way; if it has to last longer, the robot waits with the nozzle lifted, or at home.

    If it has to last only a little longer, less than lifting takes, it is slowed down instead.
    """
    ends, space = task.ends, task.room
    motion = quickest(replace(task, ends=replace(ends, least=0.0)))
    if motion is None or motion.duration >= ends.least:
        return motion
    a, _ = above(task.cell, ends, space, space.lift)
    up = between(ends.bounds, ends.start, a)
    if up is not None and _is_clear(task, up):
        after = travel_clearance(task.cell, space.surface, space.height, space.lift, a, ends.end)
        onward = quickest(replace(task, ends=replace(ends, start=a, least=0.0), room=after))
        if onward is not None and up.duration + onward.duration <= ends.least:
            return ways.waiting([up, onward], ends.least)
    return quickest(task)


def upright(task: TravelTask) -> Cubics | None:
    """Up along the normal, the quickest way across, and down along the normal, at rest in between; None if not clear.

    The way across keeps clear by the whole lift; spare time is spent waiting above the start. Both ends are at rest.
    """
    cell, ends, space = task.cell, task.ends, task.room
    for factor in LIFTS:
        a, b = above(cell, ends, space, factor * space.lift)
        climbs = [
            along_normal(cell, replace(ends, start=start, end=end), _AIM * task.speed)
            for start, end in ((ends.start, a), (b, ends.end))
        ]
        if not all(climb is not None and _is_clear(task, climb) for climb in climbs):
            continue
        across = Ends(a, b, 0.0, ends.bounds)
        high = travel_clearance(cell, space.surface, space.height, space.lift, a, b)
        motion = ways.waiting([climbs[0], quickest(replace(task, ends=across, room=high)), climbs[1]], ends.least)
        if motion is not None:
            return motion
    return None


def above(cell: Cell, ends: Ends, room: TravelClearance, raised: float) -> tuple[JointState, JointState]:
    """At rest `raised` [m] above both ends, along the part's normal; an end already that high, such as home, stays."""
    near = room.gaps[:, 0] < room.gaps[:, 0].min() + raised
    tips = room.tips + np.where(near, raised, 0.0)[:, None] * room.surface.normals(room.tips)
    q = np.stack([ends.start.q, ends.end.q])
    q[near, : len(cell.arm)] = reaching(cell, q[near], tips[near])
    return at_rest(q[0]), at_rest(q[1])


def along_normal(cell: Cell, ends: Ends, speed: float) -> Cubics | None:
    """From end to end, both at rest, the tip on the straight line between them, no faster than `speed` [m/s]."""
    tips = cell.T_part_nozzle(np.stack([ends.start.q, ends.end.q]))[:, :3, 3]
    if np.linalg.norm(tips[1] - tips[0]) < _LEAST:
        return rest(ends.start.q, 0.0)
    built = along_tips(cell, replace(ends, least=0.0), np.linspace(tips[0], tips[1], _PLACES), speed)
    return None if built is None else built.motion


def _is_clear(task: TravelTask, motion: Cubics) -> bool:
    """Whether a motion is clear of the part, and within the limits of joints and tip."""
    if not within_limits(task.cell, motion):
        return False
    looked = track(task.cell, motion)
    slow = looked.tip_speed <= _FAST * task.speed
    return slow and task.room.lacking(looked.points) <= 0.0 and task.hit(motion) < 0


def _ways(task: TravelTask, free: Caps) -> Iterator[TravelWay]:
    """All ways, the preferred one first among those that take equally long."""
    cell, ends, room = task.cell, task.ends, task.room
    lift = room.lift
    direct = ways.straight(cell, ends, free)
    least = ends.least if direct is None else direct.motion.duration
    yield TravelWay(partial(ways.straight, cell, ends), least)
    higher: tuple[TravelWay, ...] = ()
    for factor in reversed(HIGH_HUMPS):
        higher = (TravelWay(partial(ways.hump, cell, ends, room, factor * lift, 3), least, higher),)
    yield TravelWay(partial(ways.hump, cell, ends, room, lift, 1), least)
    yield TravelWay(partial(ways.hump, cell, ends, room, lift, 3), least, higher)
    for factor in LOW_HUMPS:
        yield TravelWay(partial(ways.hump, cell, ends, room, factor * lift, 1), least)
    chord = float(np.linalg.norm(room.tips[1] - room.tips[0]))
    other: tuple[TravelWay, ...] = ()
    for fit in reversed(FITS):
        build = partial(_uncapped, partial(arc, cell, ends, room, _AIM * task.speed, fit))
        other = (TravelWay(build, max(_ARC * least, chord / task.speed), other),)
    yield from other
    straight = ways.lifted_over(cell, ends, room, lift, "straight")
    resting = ways.resting_at(cell, ends, straight, np.inf, free)
    least = least if resting is None else resting.motion.duration
    other = ()
    for factor in reversed(LIFTS):
        heights = [partial(ways.lifted_over, cell, ends, room, factor * lift, name) for name in ways.POSTURES]
        other = tuple(_resting(task, vias, least, other if vias is heights[-1] else ()) for vias in heights)
    yield from other


def _uncapped(build: Callable[[], Built | None], caps: Caps) -> Built | None:
    """Build a way that keeps the tip's speed by itself: caps are ignored."""
    return build()


def _slower(built: Built, factor: float) -> Caps:
    """Caps on the velocities of a way's parts: `factor` times those that they reached."""
    along = built.motion if built.along is None else built.along
    caps = np.maximum(factor * extremes(along).velocity, ways.SLOWEST)
    over = (
        np.inf * np.ones(0) if built.over is None else np.maximum(factor * extremes(built.over).velocity, ways.SLOWEST)
    )
    return Caps(caps, over)


def within_limits(cell: Cell, motion: Cubics) -> bool:
    """Whether a motion keeps all joint limits, between its breakpoints too."""
    found, limits, wide = extremes(motion), cell.limits, 1.0 + _LIMIT_ROUNDING
    return bool(
        (found.low >= limits.q_min).all()
        and (found.high <= limits.q_max).all()
        and (found.velocity <= limits.velocity * wide).all()
        and (found.acceleration <= limits.acceleration * wide).all()
        and (found.jerk <= limits.jerk * wide).all()
    )


def carried_travels(
    cell: Cell, travels: Sequence[Travel], timed: Sequence[TimedPath], toolpath: Toolpath, process: ProcessSpec
) -> list[Travel | None]:
    """Travel as planned, but between the ends of these beads; home stays at home.

    A controller visits the targets of its program wherever the work object is, and joins them as before. So the change
    of a travel's joints blends from that at one end to that at the other. Where it would be too fast for a joint or for
    the tip, or the runs leave the extruder too little time to retract and prime, it takes longer; None if it cannot,
    because a bead's end is in motion.
    """

    def carried(way: Cubics, leave: TimedPath | None, reach: TimedPath | None) -> Cubics | None:
        start = at_rest(way.start.q) if leave is None else leave.end
        end = at_rest(way.end.q) if reach is None else reach.start
        least = _least(process, toolpath, leave, reach)
        return _carried(cell.at(_material(leave, reach)), way, start, end, least, process.travel_speed)

    out: list[Travel | None] = []
    for i, travel in enumerate(travels):
        leave = None if i == 0 else timed[i - 1]
        reach = None if i == len(timed) else timed[i]
        if not isinstance(travel, ViaRest):
            out.append(carried(travel, leave, reach))
            continue
        away, back = carried(travel.out, leave, None), carried(travel.back, None, reach)
        out.append(None if away is None or back is None else ViaRest(away, back))
    return out


def _carried(cell: Cell, way: Cubics, start: JointState, end: JointState, least: float, speed: float) -> Cubics | None:
    """A way moved to other ends, lasting at least `least` [s], the tip no faster than `speed` [m/s].

    None if it would have to be slower, but cannot.
    """
    moved, resting = between_ends(way, start, end), start.resting and end.resting
    lasts = moved.duration > 0.0
    if moved.duration < least - _ROUNDING and not (resting and lasts):
        return None
    found, limits = extremes(moved), cell.limits
    times = max(
        1.0,
        least / moved.duration if lasts else 1.0,
        float((found.velocity / limits.velocity).max()) / HEADROOM,
        float(np.sqrt((found.acceleration / limits.acceleration).max() / HEADROOM)),
        float(np.cbrt((found.jerk / limits.jerk).max() / HEADROOM)),
        track(cell, moved).tip_speed / (_FAST * speed),
    )
    if resting:
        return moved if times <= _LONGER else slower(moved, times * _LONGER)
    return moved if within_limits(cell, moved) and track(cell, moved).tip_speed <= speed else None


def between_ends(way: Cubics, start: JointState, end: JointState) -> Cubics:
    """A motion changed so that it leads from one state to another, in the same time, and as smooth as before.

    The change has constant jerk in each third of the time: six conditions at the ends determine it. A motion of zero
    duration stays as it is.
    """
    if way.duration == 0.0:
        return way
    T = way.duration
    h = T / 3.0
    q0, v0, a0 = (ours - theirs for ours, theirs in zip(start, way.start, strict=True))
    q1, v1, a1 = (ours - theirs for ours, theirs in zip(end, way.end, strict=True))
    left = np.stack([(q1 - q0 - T * (v0 + 0.5 * T * a0)) / h**3, (v1 - v0 - T * a0) / h**2, (a1 - a0) / h])
    jerks = np.linalg.solve(_REACHED, left)
    coefficients = np.empty((4, 3, len(q0)))
    for k, jerk in enumerate(jerks):
        coefficients[:, k] = jerk / 6.0, a0 / 2.0, v0, q0
        q0 = q0 + h * (v0 + h * (a0 / 2.0 + h * jerk / 6.0))
        v0 = v0 + h * (a0 + h * jerk / 2.0)
        a0 = a0 + h * jerk
    return add(way, Cubics(np.array([0.0, h, 2.0 * h, T]), coefficients))


def slower(motion: Cubics, times: float) -> Cubics:
    """The same motion, taking `times` times as long."""
    powers = times ** np.arange(3.0, -1.0, -1.0)
    return Cubics(motion.times * times, motion.coefficients / powers[:, None, None])
