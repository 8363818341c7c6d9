"""Wings whose section changes along the span, and wings in level layers: surfaces, spacing, coverage, solid, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from test_reread import found

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.base.nearest import distance_to_polyline
from planner.problem import Problem, load_problem
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.bead import Bead, Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.wing.scanlines import linked
from planner.toolpath.wing.section import naca_section, section_through
from planner.toolpath.wing.sheet_solid import SheetSolid
from planner.toolpath.wing.sheets import CurvedSheet, FlatSheet, LoftedSide, SpanIntervals
from planner.toolpath.wing.support import check_support
from planner.verify.reread.places import FILLED

HEIGHT = WIDTH = 0.5e-3
SPAN = 10e-3
JOINED = "layers.passes=joined"
SHORT = ("layers.source.span_mm=10", "layers.source.tip={chord_mm: 70, sweep_mm: 4, washout_deg: 1, naca: '2412'}")


def problem(*changes: str) -> Problem:
    return load_problem("naca0015_wing_tapered", (*SHORT, JOINED, *changes))


@pytest.fixture(scope="module")
def toolpath() -> Toolpath:
    return build_toolpath(problem("layers.support=null"))


def level() -> Problem:
    return load_problem(
        "naca0015_wing", ("layers.source.method=planar", "layers.support.curved=0", "layers.source.span_mm=4", JOINED)
    )


@pytest.fixture(scope="module")
def planar() -> Toolpath:
    return build_toolpath(level())


# The surface


def placed(digits: str, chord: float, x: float, washout: float) -> Array:
    """Points (n, 2) of a section at its place, from NACA's formula: upper side from tail to nose, lower side back."""
    points = naca_section(digits)
    turn = np.radians(washout)
    away = points - [0.25, 0.0]
    turned = np.column_stack(
        [away[:, 0] * np.cos(turn) - away[:, 1] * np.sin(turn), away[:, 0] * np.sin(turn) + away[:, 1] * np.cos(turn)]
    )
    return chord * (turned + [0.25, 0.0]) + [x, 8.7016e-3]


def sides_of(toolpath: Toolpath) -> dict[str, LoftedSide]:
    """The lower and the upper side, those of the first and of the last layer."""
    solid = toolpath.surface
    assert isinstance(solid, SheetSolid)
    found = [solid.sheets[solid.laid[k]] for k in (0, -1)]
    assert isinstance(found[0], CurvedSheet)
    assert isinstance(found[1], CurvedSheet)
    return {"lower": found[0].side, "upper": found[1].side}


@pytest.mark.slow
def test_the_wing_ends_in_the_two_sections(toolpath: Toolpath) -> None:
    """The tip's place, chord, sweep and washout by hand; the root is that of the straight wing."""
    tip = placed("2412", 70e-3, 19e-3, 1.0)
    nose = int(np.argmin(np.linalg.norm(naca_section("2412"), axis=1)))
    for name, points in (("upper", tip[: nose + 1]), ("lower", tip[nose:])):
        side = sides_of(toolpath)[name]
        space = np.column_stack([points[:, 0], np.full(len(points), SPAN), points[:, 1]])
        assert side.distance(space[1:-1]).max() < 1e-9
    root = placed("0015", 80e-3, 15e-3, 0.0)
    space = np.column_stack([root[:, 0], np.zeros(len(root)), root[:, 1]])
    nearest = np.minimum(*(side.distance(space) for side in sides_of(toolpath).values()))
    assert nearest.max() < 12e-6, "the paper gives 18 points a side"


@pytest.mark.slow
def test_nearest_places_are_nearest(toolpath: Toolpath) -> None:
    """Against a general minimiser, and with the way there along the normal."""
    rng = np.random.default_rng(3)
    side = sides_of(toolpath)["lower"]
    points, inward = side.parallel(rng.uniform(0.1, 0.9, 12), rng.uniform(1e-3, 9e-3, 12), 2.5e-3)
    u, v = side.nearest(points)
    foot = side.points(u, v)
    assert np.linalg.norm(points - foot, axis=1) == pytest.approx(2.5e-3, abs=1e-10)
    assert points - foot == pytest.approx(2.5e-3 * inward, abs=1e-8)
    for point, place in zip(points, np.column_stack([u, v]), strict=True):

        def far(w: Array, point: Array = point) -> float:
            return float(np.linalg.norm(side.points(w[:1], w[1:])[0] - point)) * 1e3

        best = minimize(far, place + [0.02, 0.1], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10})
        assert best.fun == pytest.approx(2.5, abs=1e-6)


@pytest.mark.slow
def test_normals_are_those_of_the_surface(toolpath: Toolpath) -> None:
    side, step = sides_of(toolpath)["upper"], 1e-6
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0.1, 0.9, 9), np.linspace(0.0, 1.0, 4)))
    by = [
        side.points(u + step * a, v + step * b) - side.points(u - step * a, v - step * b) for a, b in ((1, 0), (0, 1))
    ]
    normals = np.cross(by[0], by[1])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    assert side.inward(u, v) == pytest.approx(normals, abs=1e-7)
    assert (side.inward(u, v)[:, 2] < 0.0).all()
    assert np.abs(side.inward(u, v)[:, 1]).max() > 0.05, "the taper leans along the span"


@pytest.mark.slow
def test_a_wing_without_taper_is_the_straight_one() -> None:
    """The lofted layers of the paper's wing lie on its straight ones: two ways to the same surfaces."""
    short = ("layers.support=null", "layers.source.span_mm=4", JOINED)
    straight = build_toolpath(load_problem("naca0015_wing", short))
    lofted = build_toolpath(load_problem("naca0015_wing", (*short, "layers.source.tip={chord_mm: 80}")))
    assert lofted.layers == straight.layers
    for one, other in zip(lofted.beads, straight.beads, strict=True):
        assert other.layer == one.layer
        low, high = other.points[:, 0].min() + 2e-4, other.points[:, 0].max() - 2e-4
        inner = (one.points[:, 0] > low) & (one.points[:, 0] < high)
        curve = other.points[np.argsort(other.points[:, 0])]
        assert distance_to_polyline(one.points[inner] * [1, 0, 1], _even(curve * [1, 0, 1])).max() < 1e-6
        assert one.length * one.width[0] == pytest.approx(other.length * other.width[0], rel=0.02)


def _even(curve: Array) -> Array:
    """A curve (n, 3) by rising x, without what lies less than 2 um behind the last."""
    kept = [0]
    for k in range(1, len(curve)):
        if curve[k, 0] - curve[kept[-1], 0] > 2e-6:
            kept.append(k)
    return np.asarray(curve[kept])


# Layers


@pytest.mark.slow
def test_layers_lie_at_their_depth_below_the_true_surface(toolpath: Toolpath) -> None:
    """Spacing along the normal: each layer one height further in, exactly, by the surface's own nearest places."""
    sides = sides_of(toolpath)
    depths: dict[str, list[float]] = {"lower": [], "upper": []}
    for i, bead in enumerate(toolpath.beads):
        sheet = toolpath.surface.sheets[toolpath.surface.laid[i]]  # type: ignore[attr-defined]
        name = "lower" if sheet.side is sides["lower"] else "upper"
        away = sides[name].distance(bead.points)
        assert np.ptp(away) < 1e-8
        depths[name].append(float(away.mean()))
        other = sides["upper" if name == "lower" else "lower"].distance(bead.points)
        assert (other > away - 1e-9).all(), "on its own half"
        assert bead.normals[:, 2].min() > np.cos(np.radians(45.0)) - 1e-9
        assert toolpath.surface.normals_on(i, bead.s, bead.points) == pytest.approx(bead.normals, abs=1e-7)
    lower, upper = np.unique(np.round(depths["lower"], 9)), np.unique(np.round(depths["upper"], 9))
    assert lower == pytest.approx(HEIGHT * np.arange(1, len(lower) + 1), abs=1e-9)
    assert upper == pytest.approx(HEIGHT * np.arange(len(upper)), abs=1e-9)
    assert len(lower) >= 10
    assert len(upper) >= 10


@pytest.mark.slow
def test_beads_stay_within_the_span(toolpath: Toolpath) -> None:
    for bead in toolpath.beads:
        assert bead.points[:, 1].min() >= 0.0
        assert bead.points[:, 1].max() <= SPAN


@pytest.mark.slow
def test_beads_are_smooth_without_loops(toolpath: Toolpath) -> None:
    """No spikes: at the sharpest of the rounded corners, where passes end at slanting edges, two samples turn by 104 deg."""
    for bead in toolpath.beads:
        along = np.diff(bead.points, axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        turn = np.degrees(np.arccos(np.clip((along[1:] * along[:-1]).sum(axis=1), -1.0, 1.0)))
        assert turn.max() < 130.0
        assert np.degrees(np.linalg.norm(np.diff(bead.normals, axis=0), axis=1)).max() < 4.0


@pytest.mark.slow
def test_passes_leave_no_gaps(toolpath: Toolpath) -> None:
    """Away from edges (2 bead widths) no place of a layer is farther than half a width and a twentieth from a pass."""
    looked = 0
    for layer in range(toolpath.layers):
        beads = [(i, bead) for i, bead in enumerate(toolpath.beads) if bead.layer == layer]
        sheet = toolpath.surface.sheets[toolpath.surface.laid[beads[0][0]]]  # type: ignore[attr-defined]
        y = np.linspace(0.0, SPAN, 61)
        edges = sheet.area.at(y)
        u, along = (grid.ravel() for grid in np.meshgrid(np.linspace(np.nanmin(edges), np.nanmax(edges), 500), y))
        inside = sheet.area.holds(u, along)
        places, _ = sheet.tips(u[inside], along[inside])
        ends = np.isin(along[inside], y[[0, -1]])
        border = [places[ends]]
        for k in range(edges.shape[1]):
            there = ~np.isnan(edges[:, k, 0])
            border += [sheet.tips(edges[there, k, end], y[there])[0] for end in (0, 1)]
            last = np.flatnonzero(there)[[0, -1]]
            border += [sheet.tips(np.linspace(*edges[j, k], 200), np.full(200, y[j]))[0] for j in last]
        inner = places[cKDTree(np.vstack(border)).query(places)[0] > 2.0 * WIDTH]
        if len(inner):
            gap = np.min([distance_to_polyline(inner, bead.source) for _, bead in beads], axis=0)
            assert gap.max() < 0.525 * WIDTH, layer
            assert {round(float(bead.width[0] / WIDTH), 1) for _, bead in beads} == {1.0}
            looked += 1
    assert looked >= 18


@pytest.mark.slow
def test_types_alternate_and_outer_layers_run_across(toolpath: Toolpath) -> None:
    def runs_across(bead: Bead) -> bool:
        steps = np.abs(np.diff(bead.points, axis=0)).sum(axis=0)
        return bool(steps[0] > steps[1])

    by_layer = [runs_across(next(b for b in toolpath.beads if b.layer == k)) for k in range(toolpath.layers)]
    assert by_layer[0]
    assert by_layer[-1]
    changes = np.diff(np.array(by_layer, dtype=int))
    assert np.count_nonzero(changes == 0) <= 1, "where the halves meet, two alike may follow each other"


@pytest.mark.slow
def test_each_layer_lies_on_what_is_printed() -> None:
    toolpath = build_toolpath(problem())
    for i, bead in enumerate(toolpath.beads):
        gap = toolpath.surface.before(i + 1).signed_distance(bead.points)
        # past the edges of layers below the solid is judged up to a fifth of a millimetre nearer than it is
        assert gap.min() > 0.3 * HEIGHT, bead.name
        assert gap.max() < 2.3 * HEIGHT, bead.name
    names = {bead.name.split()[0] for bead in toolpath.beads}
    assert names == {"support", "layer"}
    level = [bead for bead in toolpath.beads if np.ptp(bead.points[:, 2]) == 0.0]
    assert len({float(bead.points[0, 2]) for bead in level}) == 16


@pytest.mark.slow
def test_the_solids_distance_agrees_with_brute_force(toolpath: Toolpath) -> None:
    """Against a fine grid of places that are inside by the sides' own distances."""
    solid = toolpath.surface.before(len(toolpath.beads))
    rng = np.random.default_rng(4)
    points = np.column_stack(
        [rng.uniform(20e-3, 75e-3, 300), rng.uniform(1e-3, 9e-3, 300), rng.uniform(9e-3, 22e-3, 300)]
    )
    got = solid.signed_distance(points)
    upper = sides_of(toolpath)["upper"]
    u, v = upper.nearest(points)
    out = -((points - upper.points(u, v)) * upper.inward(u, v)).sum(axis=1)
    last = HEIGHT  # the last layer is not there yet
    above = (out > last) & (out < 5e-3)
    assert above.sum() > 50
    assert got[above] == pytest.approx(out[above] + last, abs=3e-5)
    inside = (out < -1.1 * last) & (points[:, 2] > 11e-3)  # where both halves meet there are steps, and none lower down
    assert inside.sum() > 20
    assert (got[inside] < 0.0).all()
    beside = points[above] * [1.0, 0.0, 1.0] + [0.0, SPAN + 2e-3, 0.0]
    assert (solid.signed_distance(beside) >= 2e-3 - 1e-9).all()


# Level layers


@pytest.mark.slow
def test_level_layers_reach_as_far_as_the_wing_does_at_half_their_height(planar: Toolpath) -> None:
    section = section_through(placed("0015", 80e-3, 15e-3, 0.0), 79)
    for i, bead in enumerate(planar.beads):
        assert (bead.normals == [0.0, 0.0, 1.0]).all()
        assert np.ptp(bead.points[:, 2]) == 0.0
        if not bead.name.startswith("layer"):
            continue
        sheet = planar.surface.sheets[planar.surface.laid[i]]  # type: ignore[attr-defined]
        assert isinstance(sheet, FlatSheet)
        low, high = sheet.area.edges[3, 0]
        for x, inner in ((low, low + 1e-3), (high, high - 1e-3)):
            point = np.array([[x, sheet.tip - 0.5 * HEIGHT]])
            assert min(section.upper.distance(point)[0], section.lower.distance(point)[0]) < 15e-6 or x > 94e-3
            assert bead.points[:, 0].min() - 1e-9 <= max(inner, bead.points[:, 0].min())
    named = [bead.name for bead in planar.beads if bead.name.startswith("layer")]
    assert len(named) == 24, "12 mm in layers of half a millimetre"


@pytest.mark.slow
def test_support_and_wing_share_a_level(planar: Toolpath) -> None:
    z = np.array([bead.points[0, 2] for bead in planar.beads])
    assert (np.diff(z) >= 0.0).all()
    for i, bead in enumerate(planar.beads):
        gap = planar.surface.before(i + 1).signed_distance(bead.points)
        assert gap.min() > 0.4 * HEIGHT, bead.name


def test_beads_are_as_high_as_the_process_says() -> None:
    given = ("layers.support=null", "layers.count=1", "layers.source.span_mm=4", "process.bead.height_mm=0.4")
    toolpath = build_toolpath(load_problem("naca0015_wing", ("layers.source.method=planar", JOINED, *given)))
    assert {float(height) for bead in toolpath.beads for height in bead.height} == {0.4e-3}


@pytest.mark.slow
def test_a_support_is_of_its_own_material(planar: Toolpath) -> None:
    """naca0015_wing names them: yellow and black, as in the paper."""
    found = {bead.name.split()[0]: bead.material for bead in planar.beads}
    assert found == {"support": "yellow_pla", "layer": "black_pla"}


@pytest.mark.slow
def test_a_rest_that_begins_with_a_support_asks_for_no_section_beside_it(planar: Toolpath) -> None:
    """Where sections are laid before their supports, as an order that lets them cool may have it."""
    beads = sorted(planar.beads, key=lambda bead: (bead.layer, bead.name.startswith("support")))
    kinds = [bead.name.split()[0] for bead in beads]
    first = next(i for i in range(len(beads) // 4, len(beads)) if kinds[i - 1 : i + 1] == ["layer", "support"])
    assert beads[first - 1].layer == beads[first].layer
    checks = {check.name: check for check in found(level(), planar, beads, first=first).checks}
    assert checks[FILLED].ok, checks[FILLED]


# Scan lines


@pytest.mark.slow
def test_passes_apart_are_those_of_a_zigzag(toolpath: Toolpath) -> None:
    """Of sheets, too: the same passes without the turns, under the names of the zig-zags that they make up."""
    apart = build_toolpath(problem("layers.support=null", "layers.passes=apart"))
    assert apart.layers == toolpath.layers
    for bead in toolpath.beads:
        own = [each for each in apart.beads if each.name.partition(" pass ")[0] == bead.name]
        assert len(own) > 1
        assert 0.9 < sum(each.length for each in own) / bead.length < 1.1
        assert all(each.layer == bead.layer and each.material == bead.material for each in own)
        middle = np.array([each.points[len(each.points) // 2] for each in own])
        assert distance_to_polyline(middle, bead.points).max() < 0.2e-3, "the tolerance of corners"


def test_rows_are_linked_where_one_faces_one() -> None:
    rows = [[(0.0, 4.0)], [(0.0, 1.0), (2.0, 4.0)], [(0.0, 1.0), (2.0, 4.0)], [(0.5, 3.0)], [], [(0.0, 1.0)]]
    chains = linked(rows)
    assert [[row for row, _, _ in chain] for chain in chains] == [[0], [1, 2], [1, 2], [3], [5]]


def test_areas_are_straight_between_stations() -> None:
    area = SpanIntervals.of(np.array([0.0, 1.0, 2.0]), [[(0.0, 4.0)], [(1.0, 3.0)], []])
    assert area.at(np.array([0.5, 1.4, 1.6]))[:, 0] == pytest.approx(
        np.array([[0.5, 3.5], [1.0, 3.0], [np.nan, np.nan]]), nan_ok=True
    )
    assert area.holds(np.array([0.6, 0.4, 2.0]), np.array([0.5, 0.5, 2.0])).tolist() == [True, False, False]


# Problems

_FOLDER: list[Path] = []


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path) -> None:
    _FOLDER[:] = [tmp_path]


TIP = 'tip: {naca: "2412", chord_mm: 66, sweep_mm: 15, washout_deg: 1.5}'
MISTAKES = [
    (TIP, 'tip: {naca: "2412", aerofoil: a.dat, chord_mm: 60}', "layers.source.tip", "both", "one of them, or none"),
    (TIP, 'tip: {naca: "2412"}', "layers.source.tip.chord_mm", "is missing", "[mm]"),
    (TIP, "tip: {chord_mm: 60, washout_deg: 31}", "layers.source.tip.washout_deg", "too large", "-30 to 30"),
    (TIP, "tip: {chord_mm: 60, twist_deg: 3}", "layers.source.tip.twist_deg", "unknown key", ""),
    (TIP, "tip: 60", "layers.source.tip", "", ""),
    (TIP, "method: flat", "layers.source.method", "unknown name 'flat'", "curved, planar"),
]


@pytest.mark.parametrize(("old", "new", "field", "reason", "hint"), MISTAKES)
def test_mistakes_are_told(old: str, new: str, field: str, reason: str, hint: str) -> None:
    text = load_problem("naca0015_wing_tapered").file.read_text("utf-8")
    assert text.count(old) == 1
    path = _FOLDER[0] / "wing.yaml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_problem(path)
    assert (caught.value.field or "").startswith(field)
    assert caught.value.line is not None
    assert reason in caught.value.reason
    assert hint in (caught.value.hint or "")


def test_a_level_wing_needs_no_room_for_curved_layers() -> None:
    for method in ("curved", "planar"):
        given = load_problem("naca0015_wing", (f"layers.source.method={method}", "layers.support.curved=9"))
        spec = given.layers
        assert isinstance(spec, AerofoilLayersSpec) and spec.support is not None
        if method == "planar":
            check_support(given, spec, spec.support, 1e-3)
        else:
            with pytest.raises(InputError, match="less than its curved layers are high"):
                check_support(given, spec, spec.support, 1e-3)


UNPRINTABLE = [
    ("layers.source.tip={chord_mm: 60, aerofoil: none.dat}", "layers.source.tip.aerofoil", "no file"),
    ("layers.source.tip={chord_mm: 80, naca: '0030'}", "layers.source.origin_mm", "below"),
    ("layers.source.tip={chord_mm: 70, sweep_mm: 60}", "layers.support.length_mm", "beyond the support"),
    ("layers.source.tip={chord_mm: 60, washout_deg: 8}", "layers.support.height_mm", "leading edge of the tip"),
    ("layers.source.tip={chord_mm: 20, sweep_mm: 30, washout_deg: -20}", "layers.source.tip", "farther apart"),
    ("layers.source.span_mm=1.2", "layers.source.span_mm", "too short"),
    ("layers.support.length_mm=79", "layers.support.length_mm", "less than the chord"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("change", "field", "reason"), UNPRINTABLE)
def test_wings_that_cannot_be_printed_are_refused(change: str, field: str, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        build_toolpath(problem(change))
    assert field in (caught.value.field or "")
    assert reason in caught.value.reason
    assert caught.value.hint or reason == "no file"


@pytest.mark.slow
def test_sides_that_never_meet_are_refused_at_once() -> None:
    wing = "layers.source.span_mm=14", "layers.source.tip={chord_mm: 6, sweep_mm: 5, naca: '2412'}"
    with pytest.raises(InputError, match="lean so much") as caught:
        build_toolpath(problem(*wing, "layers.source.tilt_deg=45"))  # less, and its passes are too far apart
    assert caught.value.field == "--set layers.source.tip"
