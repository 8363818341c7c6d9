"""The print, measured against the problem's files and figures instead of the toolpath made from them.

The executed tip is projected onto the part by the formulas of its surface and into the plane of the drawing, and print
and drawing are compared both ways: nothing is printed that is not drawn, and no more of the drawing is left out than
allowed. Beads must have the problem's dimensions, and obstacles must be where part and print are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from planner.base.arrays import Array, Flags, Ints
from planner.base.geometry import angles_between
from planner.collision.print_body import CLEARANCE, PART
from planner.plan import Check
from planner.problem.drawings import (
    DxfSpec,
    LayersSpec,
    PatternSpec,
    ProjectedLayersSpec,
    WrappedDxfSpec,
    WrappedLayersSpec,
)
from planner.problem.layers import FaceLayersSpec, GcodeLayersSpec, WaypointLayersSpec
from planner.problem.part import PartSpec, ScanSpec
from planner.verify.checks import EVERYWHERE, Findings, Judged, lines_around
from planner.verify.reread.core import core
from planner.verify.reread.faces import faces
from planner.verify.reread.facets import facets_of
from planner.verify.reread.lines import between_ends, distances_from_lines, dots_of_lines
from planner.verify.reread.part_surface import distances_from_facets, feet, level_of, nearest_on
from planner.verify.reread.places import (
    APART,
    AXIS,
    DRAWN,
    NORMAL,
    OFF_LEVEL,
    ON_PART,
    SHORT,
    WHOLE,
    Places,
    begun_layers,
    between,
    beyond_limits,
    by_number,
    may_be_left,
    places_of,
    worst_of,
)
from planner.verify.reread.plane_curves import NotRead, read_again
from planner.verify.reread.points import Segments, distances_from, dots_along, segments_of
from planner.verify.reread.scan import sheets_at
from planner.verify.reread.skirt import skirt
from planner.verify.reread.slopes import axis_along, normals_over, off_facets
from planner.verify.reread.volume import volume
from planner.verify.reread.wing import wing
from planner.verify.scanned import asked_height

OFF_SCAN = 0.05e-3  # m: beads may lie this far off a scan's points, beyond the points' uncertainty
TURNED_SCAN = np.radians(1.5)  # the same for normals
_SEEN = 1500  # places of the whole print at which distances from facets are measured
_CHORDS = 2.0  # chord tolerances: one for the planner's reading, one for this
_LAXER = 1.25  # corner tolerances: a file's points may be thinned out before its corners are rounded
_BENT = 0.1  # × a layer's height above facets: tolerance, as a smooth surface's normal differs from a facet's
_BEAD = 1e-9  # m: rounding of widths and heights
_MAPPED = 1e-5  # m: tolerance of heights interpolated in a map
_WIDTHS_AGO = 3.0  # bead widths: a bead may lie on itself only at least this far back along it
_STRAY = 0.3e-3  # m that obstacles may be off, on top of their own radius and spread
_LEVEL = 10.0  # weight of heights where layers are level: anything beneath belongs to another layer
_SAME_LEVEL = 5e-6  # m: rounded heights of one layer may differ by this much
_NEAREST = 3  # nearest places on a file's path whose pieces are tried
_MOST = 1_000_000  # most places on a file's path
_AT_ONCE = 100_000  # places whose distances from it are found at once: bounds the memory


def as_the_problem_says(judged: Judged) -> Findings:
    """All checks of the print against the problem itself."""
    if not judged.trajectory.deposit.any():
        return Findings()  # another check reports that nothing is laid
    every = places_of(judged)
    around = every.bead < lines_around(judged.problem, judged.toolpath)
    places = every.some(~around)
    if not len(places.tip):
        return Findings()
    checks = [
        *skirt(judged, every, around),
        *_measures(judged),
        *_on_the_part(judged, places),
        *_on_the_drawing(judged, places),
        *_on_the_points(judged, places),
        *wing(judged, places),
        *core(judged, places),
        *volume(judged, places),
        *faces(judged, places),
    ]
    return Findings((*checks, _obstacles(judged, every)))


def _measures(judged: Judged) -> Iterator[Check]:
    """Beads have the width and height that the problem sets, where it sets them."""
    layers, bead, spec = judged.problem.layers, judged.problem.process.bead, judged.problem.as_printed
    if not isinstance(layers, (WrappedLayersSpec, ProjectedLayersSpec, FaceLayersSpec)):
        return
    slanted = isinstance(layers, ProjectedLayersSpec) and layers.offset == "z"  # heights along the normal are less
    worst, where = 0.0, EVERYWHERE
    for i, each in enumerate(judged.toolpath.beads):
        off = np.abs(each.width - bead.width)
        if not slanted and spec is None:
            off = np.maximum(off, np.abs(each.height - bead.height))
        elif not slanted and spec is not None:
            some, asked = asked_height(spec, each, bead.height)
            off = np.maximum(off.max(), np.abs(each.height[some] - asked))
        if not (most := float(off.max())) <= worst:
            worst, where = most, f"bead {i}"
    limit = _BEAD if spec is None else _MAPPED
    yield Check("beads as wide and high as asked", worst * 1e3, limit * 1e3, "mm", worst <= limit, where)


def _on_the_part(judged: Judged, places: Places) -> Iterator[Check]:
    """Layers lie at their height above the part, and the nozzle is normal to its surface."""
    layers, part = judged.problem.layers, judged.problem.part
    if part is None or not isinstance(layers, (WrappedLayersSpec, ProjectedLayersSpec)):
        return
    rise = np.asarray((places.layer + 1.0) * layers.height, dtype=float)
    level = level_of(part)
    along_z = isinstance(layers, ProjectedLayersSpec) and layers.offset == "z"
    if level is not None:
        if along_z:
            value, gradient = level(places.tip - rise[:, None] * [0.0, 0.0, 1.0])
            size = np.linalg.norm(gradient, axis=1)
            off, normal = value / size, gradient / size[:, None]
        else:
            _, off, normal = feet(level, places.tip, rise)
        yield worst_of(judged, places, ON_PART, np.abs(off) * 1e3, OFF_LEVEL * 1e3, "mm")
        lean = np.arccos(np.clip((normal * places.up).sum(axis=1), -1.0, 1.0))
        most = np.degrees(judged.problem.process.cones.tilt + AXIS)
        yield worst_of(judged, places, NORMAL, np.degrees(lean), most, "deg")
    elif part.scan is not None:
        yield from _on_the_scan(judged, places, part.scan, along_z)
    elif part.mesh is not None:
        some = places.few(_SEEN)
        height = np.asarray((some.layer + 1.0) * layers.height, dtype=float)
        if along_z:
            off = distances_from_facets(part.mesh, some.tip - height[:, None] * [0.0, 0.0, 1.0])
        else:
            off = np.abs(distances_from_facets(part.mesh, some.tip) - height)
        bound = off_facets(judged) + OFF_LEVEL
        off = np.maximum(off - _BENT * height, 0.0)
        yield worst_of(judged, some, ON_PART, off * 1e3, bound * 1e3, "mm")
        if judged.toolpath.told.off > 0.0:
            return  # coarse or noisy facets were smoothed: their slopes are not the surface's
        foot = some.tip[:, :2] - (0.0 if along_z else height[:, None] * some.up[:, :2])
        facets = facets_of(part.mesh)
        yield axis_along(judged, some, normals_over(lambda plane: facets.top(plane)[0], foot))


def _on_the_scan(judged: Judged, places: Places, scan: ScanSpec, along_z: bool) -> Iterator[Check]:
    """The same for a scan, within the uncertainty of sheets through its own points."""
    layers = judged.problem.layers
    if not isinstance(layers, ProjectedLayersSpec):
        return
    some = places.few(_SEEN)
    rise = np.asarray((some.layer + 1.0) * layers.height, dtype=float)
    way = np.broadcast_to([0.0, 0.0, 1.0], some.up.shape) if along_z else some.up
    foot = some.tip - rise[:, None] * way
    sheet = sheets_at(scan, foot[:, :2])
    off = np.abs((foot[:, 2] - sheet.z) * sheet.normals[:, 2])
    beyond = np.maximum(off - _BENT * rise - sheet.unsure, 0.0)
    yield worst_of(judged, some, ON_PART, beyond * 1e3, (OFF_SCAN + OFF_LEVEL) * 1e3, "mm")
    lean = angles_between(sheet.normals, some.up)
    limits = judged.problem.process.cones.tilt + AXIS + TURNED_SCAN + sheet.turn
    yield beyond_limits(judged, some, NORMAL, np.degrees(lean), np.degrees(limits), "deg")


def _on_the_drawing(judged: Judged, places: Places) -> Iterator[Check]:
    """Nothing is printed that is not drawn, and everything drawn is printed."""
    layers, part, process = judged.problem.layers, judged.problem.part, judged.problem.process
    if part is None or not isinstance(layers, (LayersSpec, WrappedDxfSpec, ProjectedLayersSpec)):
        return
    source = layers.source  # type: ignore[union-attr]
    drawn = read_again(source)
    if isinstance(drawn, NotRead):
        yield Check(DRAWN, 0.0, 0.0, "mm", True, f"not read again: {drawn.why}")
        return
    lines = [line for line in drawn if len(line) > 1]
    count = len(lines)
    limit = process.corner_tolerance + _CHORDS * process.chord_tolerance + OFF_LEVEL
    if isinstance(source, PatternSpec):  # walls shared by two ribbons lie side by side
        limit += 0.5 * process.bead.width + process.corner_tolerance
    if level_of(part) is None and isinstance(layers, ProjectedLayersSpec):
        limit += _BENT * layers.height * layers.count
    if isinstance(source, DxfSpec):  # ends that were joined
        lines += between_ends(lines, source.join, 2.0 * limit)
    if isinstance(layers, ProjectedLayersSpec) and (layers.project != "z" or any(len(line.T) == 3 for line in lines)):
        lines, plane = _fallen(layers, part, lines, _feet_of(judged, layers, part, places))
    else:
        plane = _in_the_plane(judged, part, places)
    off = distances_from_lines(lines, plane)
    yield worst_of(judged, places, DRAWN, off * 1e3, limit * 1e3, "mm")
    yield _whole(judged, places, plane, lines[:count], limit + between(judged), layers.count)


def _on_the_points(judged: Judged, places: Places) -> Iterator[Check]:
    """Everything in a file of waypoints or G-code is printed, and nothing else."""
    layers, process = judged.problem.layers, judged.problem.process
    if not isinstance(layers, (WaypointLayersSpec, GcodeLayersSpec)):
        return
    found = segments_of(layers.source)
    if isinstance(found, NotRead):
        yield Check(DRAWN, 0.0, 0.0, "mm", True, f"not read again: {found.why}")
        return
    length = np.linalg.norm(found.end - found.start, axis=1)
    dots, which = dots_along(found, max(APART, float(length.sum()) / _MOST))
    off = _off_pieces(found, places.tip, dots, which)
    limit = _LAXER * process.corner_tolerance + _CHORDS * process.chord_tolerance + OFF_LEVEL
    yield worst_of(judged, places, DRAWN, off * 1e3, limit * 1e3, "mm")
    resumed = judged.trajectory.first_bead > 0
    if found.needed is None or not found.needed.any() or resumed:
        why = "a print that is resumed" if resumed else "its comments name no features to be printed"
        yield Check(WHOLE, 0.0, 0.0, "of its length", True, f"not asked: {why}")
        return
    if found.bend > 0.0:  # only the waypoints themselves must be passed
        dots, which = found.start, np.arange(len(length))
    weight = (length / np.bincount(which))[which]
    if found.bend > 0.0:  # a waypoint represents the shorter of its two steps: one may lead to the next path
        weight = np.minimum(weight, np.append(weight[:1], weight[:-1]))
        weight = np.minimum(weight, float(np.median(length)))
    wanted, most = found.needed[which], may_be_left(judged, layers.source.crumbs)
    if isinstance(layers, GcodeLayersSpec) and layers.count is not None:
        low = wanted & _level_up_to(found, float(places.tip[:, 2].max()))[which]
        if not low.any():
            yield Check(WHOLE, 0.0, 0.0, "of its length", True, "not asked: nothing level is to be printed")
            return
        # the notes' share refers to all layers
        wanted, most = low, SHORT + (most - SHORT) * float(weight[wanted].sum() / weight[low].sum())
    dots, weight = dots[wanted], weight[wanted]
    sense = np.array([1.0, 1.0, 1.0 if found.bend > 0.0 else _LEVEL])
    lost = cKDTree(places.tip * sense).query(dots * sense)[0] > limit + between(judged)
    share = float(weight[lost].sum() / weight.sum())
    where = EVERYWHERE
    if lost.any():
        where = "at {:.1f}, {:.1f}, {:.1f} mm".format(*(dots[np.argmax(lost)] * 1e3))
    yield Check(WHOLE, share, most, "of its length", share <= most, where)


def _level_up_to(found: Segments, top: float) -> Flags:
    """Whether pieces (n) of G-code are level, and no higher than the layer at a height [m]. A spiral counts at its
    final height, and may be left out as a whole."""
    level = np.abs(found.end[:, 2] - found.start[:, 2]) <= _SAME_LEVEL
    return np.asarray(level & (found.end[:, 2] <= top + _SAME_LEVEL))


def _off_pieces(found: Segments, points: Array, dots: Array, which: Ints) -> Array:
    """Distances (n) [m] of points (n, 3) from the nearest of all pieces, less what these may bend; which (m): the piece
    that each dot (m, 3) is on.

    Where pieces may bend, the nearest ones of each octave of lengths are tried, so that nearer short ones cannot hide a
    long one; points at distance 0 are not tried again.
    """
    length = np.linalg.norm(found.end - found.start, axis=1)
    octave, counts = np.zeros(len(dots), dtype=np.int64), [_NEAREST]
    if found.bend > 0.0:
        octave = np.log2(np.maximum(length / max(float(np.median(length)), 1e-9), 1.0)).astype(np.int64)[which]
        counts = [1, _NEAREST]
    off = np.full(len(points), np.inf)
    for each in np.unique(octave):
        own, tree = which[octave == each], cKDTree(dots[octave == each])
        for most in counts:
            left, count = np.flatnonzero(off > 0.0), min(most, len(own))
            for some in np.array_split(left, len(left) // _AT_ONCE + 1):
                near = tree.query(points[some], k=count)[1].reshape(len(some), count)
                off[some] = np.minimum(off[some], distances_from(found, points[some], [own[k] for k in near.T]))
    return off


def _in_the_plane(judged: Judged, part: PartSpec, places: Places) -> Array:
    """Positions (n, 2) [m] of tips in the plane of the drawing."""
    layers = judged.problem.layers
    if isinstance(layers, ProjectedLayersSpec):
        c, s = np.cos(layers.turn), np.sin(layers.turn)
        foot = _feet_of(judged, layers, part, places)[:, :2]
        return np.asarray((foot - np.asarray(layers.centre)) @ np.array([[c, -s], [s, c]]))
    cylinder = part.cylinder
    if cylinder is None:
        raise TypeError("only cylinders are wrapped around")
    x, y, z = (places.tip - [*cylinder.centre, 0.5 * cylinder.height]).T
    return np.column_stack([cylinder.radius * np.arctan2(y, x), z])


def _feet_of(judged: Judged, layers: ProjectedLayersSpec, part: PartSpec, places: Places) -> Array:
    """Places (n, 3) [m] of the part below tips, against the direction in which layers grow."""
    rise = np.asarray((places.layer + 1.0) * layers.height, dtype=float)
    level = level_of(part)
    if layers.offset == "z":
        return np.asarray(places.tip - rise[:, None] * [0.0, 0.0, 1.0])
    if level is not None:
        return feet(level, places.tip, rise)[0]
    foot = np.empty_like(places.tip)  # for files, layers grow along the toolpath's own normals
    for bead, own in by_number(places.bead):
        laid, at = judged.toolpath.beads[bead], judged.trajectory.s[places.sample[own]]
        normal = np.column_stack([np.interp(at, laid.s, laid.normals[:, k]) for k in range(3)])
        foot[own] = places.tip[own] - rise[own, None] * normal
    return foot


def _fallen(
    layers: ProjectedLayersSpec, part: PartSpec, lines: Sequence[Array], foot: Array
) -> tuple[list[Array], Array]:
    """Lines of curves (k, 3), or (k, 2) at z = 0, and feet of tips (n, 3), all projected into one plane (., 2).

    That plane is perpendicular to the direction of projection. Curves projected along normals are moved to their
    nearest places on the part first, then seen from above.
    """
    c, s = np.cos(layers.turn), np.sin(layers.turn)
    there = []
    for line in lines:
        z = line[:, 2] if line.shape[1] == 3 else np.zeros(len(line))
        there.append(np.column_stack([line[:, :2] @ np.array([[c, s], [-s, c]]) + np.asarray(layers.centre), z]))
    level = level_of(part)
    if layers.project == "normal" and level is not None:
        there = [nearest_on(level, line) for line in there]
    axes = np.eye(3)[:2]
    if layers.direction is not None:
        axes = np.linalg.svd(np.array([layers.direction]))[2][1:]
    return [line @ axes.T for line in there], foot @ axes.T


def _whole(judged: Judged, places: Places, plane: Array, lines: Sequence[Array], near: float, count: int) -> Check:
    """The share of the drawing that no bead of a layer comes near to, in the worst of the layers printed as a whole."""
    begun = begun_layers(judged)
    dots, weight = dots_of_lines(lines)
    where, worst = EVERYWHERE, 0.0
    printed = dict(by_number(places.layer))
    for layer in range(count):
        if layer in begun:
            continue
        own = printed.get(layer, np.zeros(0, dtype=np.int64))
        pieces = np.split(plane[own], np.flatnonzero(np.diff(places.bead[own])) + 1)
        lost = distances_from_lines([piece for piece in pieces if len(piece) > 1], dots) > near
        share = float(weight[lost].sum() / weight.sum())
        if share > worst:
            worst, spot = share, dots[np.argmax(lost)] * 1e3
            where = f"layer {layer + 1}, {spot[0]:.1f}, {spot[1]:.1f} mm from the drawing's middle"
    limit = may_be_left(judged, judged.problem.layers.source.crumbs)  # type: ignore[union-attr]
    return Check(WHOLE, worst, limit, "of its length", worst <= limit, where)


def _obstacles(judged: Judged, places: Places) -> Check:
    """Obstacles are where beads are laid, and where the part is beneath the lowest layer."""
    some, beads, body = places.few(_SEEN), judged.toolpath.beads, judged.body
    width, height, least = np.array([(b.width.max(), b.height.max(), b.height.min()) for b in beads])[some.bead].T
    thing = np.searchsorted(body.first, body.tree.number, side="right") - 1
    number = np.array([_bead_of(name) for name in body.names])[thing]
    laid = number >= 0
    off = np.full(len(some.tip), np.inf)
    if laid.any():
        apart = cKDTree(np.column_stack([body.tree.points[laid], number[laid]]))  # 4th axis: beads are 1 m apart
        middle = judged.motion.tip[some.sample] - 0.5 * height[:, None] * some.up
        # a ball is no farther from a bead's middle line than 0.8 of its width or height, whichever is smaller
        lean = height * np.sin(0.5 * judged.problem.process.cones.tilt)
        room = np.minimum(width, height) + 0.5 * (height - least) + lean
        off = apart.query(np.column_stack([middle, some.bead]))[0] - room
    part = np.array([name == PART for name in body.names])[thing]
    lowest = some.layer == min(bead.layer for bead in beads)
    if part.any() and lowest.any():
        away, at = cKDTree(body.tree.points[part]).query(some.tip[lowest])
        spread = np.sqrt((body.tree.radius[part][at] + CLEARANCE) ** 2 - CLEARANCE**2)
        bare = away - height[lowest] - spread
        on_turns = _on_turns(judged, some, height, np.flatnonzero(lowest)[bare > _STRAY], number)
        bare[np.flatnonzero(bare > _STRAY)[on_turns]] = 0.0
        off[lowest] = np.maximum(off[lowest], bare)
    return worst_of(judged, some, "obstacles where the print is", np.maximum(off, 0.0) * 1e3, _STRAY * 1e3, "mm")


def _on_turns(judged: Judged, places: Places, height: Array, which: Ints, number: Ints) -> NDArray[np.bool_]:
    """Whether the places `which` (n) of the lowest layer lie, half to one and a half of their bead's height above it,
    on an obstacle present by then: an earlier bead of that layer, or the same one a few widths before, as in a spiral.
    number: the bead of each point of the body."""
    beads, body, s = judged.toolpath.beads, judged.body, judged.trajectory.s
    layer = min(bead.layer for bead in beads)
    own = np.flatnonzero(np.isin(number, [i for i, bead in enumerate(beads) if bead.layer == layer]))
    balls, out = cKDTree(body.tree.points[own]), np.zeros(len(which), dtype=bool)
    for k, i in enumerate(which):
        bead, tip = int(places.bead[i]), places.tip[i]
        width = float(beads[bead].width.max())
        before = bead + (float(s[places.sample[i]]) - _WIDTHS_AGO * width) / beads[bead].length
        near = own[balls.query_ball_point(tip, 2.0 * height[i] + width)]
        near = near[(number[near] < bead) | ((number[near] == bead) & (body.tree.time[near] < before))]
        way = tip - body.tree.points[near]
        up = way @ places.up[i]
        beside = np.linalg.norm(way - up[:, None] * places.up[i], axis=1) <= body.tree.radius[near] + _STRAY
        gap = up - body.tree.radius[near]
        out[k] = bool((beside & (gap > 0.5 * height[i] - _STRAY) & (gap < 1.5 * height[i] + _STRAY)).any())
    return out


def _bead_of(name: str) -> int:
    """The number of the bead that an obstacle is, from its name; -1 for others."""
    head, _, tail = name.partition(" ")
    return int(tail) if head == "bead" and tail.isdecimal() else -1
