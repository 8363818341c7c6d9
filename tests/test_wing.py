"""Wings in layers: spacing, trimming, order, what each layer lies on; curves parallel to a section."""

from __future__ import annotations

import itertools
import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from benchmarks.wing import CASES
from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import Problem, load_problem
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.wing.section import AerofoilSection, TooUneven, naca_section, parallels, section_through
from planner.toolpath.wing.strips import CurvedStrip, FlatStrip, LayeredSolid

HEIGHT = 0.5e-3
CHORD_LINE = 8.7016e-3


def problem(*changes: str) -> Problem:
    return load_problem("naca0015_wing", ("layers.passes=joined", *changes))


@pytest.fixture(scope="module")
def toolpath() -> Toolpath:
    return build_toolpath(problem("layers.source.span_mm=4", "layers.support=null"))


@pytest.fixture(scope="module")
def supported() -> Toolpath:
    return build_toolpath(problem("layers.source.span_mm=4", "layers.count=20"))


def section_of(digits: str, chord: float) -> AerofoilSection:
    points = naca_section(digits)
    return section_through(chord * points, int(np.argmin(np.linalg.norm(points, axis=1))))


def test_material_and_heat_are_the_papers() -> None:
    """Arigela et al., table 3: black PLA on yellow PLA, at 195 and 70 deg C, by motors that are on or off."""
    layers, process = load_problem("naca0015_wing").layers, load_problem("naca0015_wing").process
    assert isinstance(layers, AerofoilLayersSpec) and layers.support is not None
    assert (layers.material, layers.support.material) == ("black_pla", "yellow_pla")
    assert {process.nozzle_c(material) for material in process.materials} == {195.0}
    assert (process.start.bed_c, process.start.heat, process.extruder.motor) == (70.0, "wait", "on_off")
    assert process.fan is not None and process.fan.from_layer == 1


# Sections and their parallels


def formula(x: Array) -> Array:
    """Half the thickness of NACA 0015 at x, both in chords."""
    return 0.75 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)


@pytest.mark.slow
def test_the_curve_through_the_papers_points_is_naca_0015(toolpath: Toolpath) -> None:
    """18 points a side: the curve between them stays within 0.01 mm of the formula, at the nose too."""
    outer = toolpath.beads[-1].points[:, ::2] * 1e3 - [15.0, 8.7016]
    x = np.linspace(0.0, 1.0, 20001) ** 2
    distance, _ = cKDTree(80.0 * np.column_stack([x, formula(x)])).query(outer)
    assert distance.max() < 0.012


def test_normals_and_curvature_are_those_of_the_formula() -> None:
    section = section_of("0015", 80e-3)
    t = np.linspace(section.lower.first, section.lower.last, 50)[1:-1]
    x = section.lower.points(t)[:, 0] / 80e-3
    slope = (formula(x + 1e-6) - formula(x - 1e-6)) / 2e-6
    wanted = np.column_stack([slope, np.ones(len(x))]) / np.hypot(slope, 1.0)[:, None]
    assert section.lower.inward(t) == pytest.approx(wanted, abs=1e-4)


def crossings(points: Array) -> int:
    """How many pairs of segments of a polyline (n, 2) cross."""
    a, b = points[:-1], points[1:]

    def side(p: Array, q: Array, r: Array) -> Array:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    one = side(a[:, None], b[:, None], a[None]) * side(a[:, None], b[:, None], b[None]) < 0.0
    apart = np.abs(np.subtract.outer(np.arange(len(a)), np.arange(len(a)))) > 1
    return int((one & one.T & apart).sum()) // 2


def test_crossings_are_counted() -> None:
    t = np.linspace(0.3, 2.0 * np.pi - 0.3, 200)
    assert crossings(np.column_stack([np.sin(2.0 * t), np.cos(t)])) == 1
    assert crossings(np.column_stack([np.cos(t), np.sin(t)])) == 0


def test_untrimmed_parallels_of_the_nose_do_cross() -> None:
    """What the trimming is for: farther in than its radius, a parallel of the whole nose has a loop."""
    points = naca_section("0015")
    both = section_through(80e-3 * points, len(points) // 2)
    curve = both.upper.curve
    t = np.linspace(both.lower.first - 20e-3, both.lower.first + 20e-3, 1500)
    for depth, crossed in ((1e-3, False), (4e-3, True)):
        along = curve(t, 1) / np.linalg.norm(curve(t, 1), axis=1)[:, None]
        points = curve(t) + depth * np.column_stack([-along[:, 1], along[:, 0]])
        assert (crossings(points) > 0) == crossed


digits = st.builds(
    lambda camber, place, thick: f"{camber}{place if camber else 0}{thick:02d}",
    st.integers(0, 6),
    st.integers(2, 6),
    st.integers(6, 30),
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(digits=digits, chord=st.floats(0.03, 1.0), share=st.floats(0.02, 0.98), tilt=st.floats(0.3, np.pi / 2))
def test_parallels_neither_cross_nor_leave_their_half(digits: str, chord: float, share: float, tilt: float) -> None:
    section = section_of(digits, chord)
    depth = share * 0.5 * int(digits[2:]) / 100.0 * chord
    for side, other in ((section.lower, section.upper), (section.upper, section.lower)):
        for first, last in parallels(side, other, depth, depth + 1e-5, tilt):
            strip = CurvedStrip(side, depth, depth - HEIGHT, first, last)
            points, normals = strip.tips(np.linspace(0.0, strip.length, 400))
            assert crossings(points) == 0
            assert side.distance(points) == pytest.approx(depth, rel=1e-6, abs=1e-7)
            assert other.distance(points).min() >= depth
            assert np.degrees(np.arccos(np.abs(normals[:, 1]).min())) <= np.degrees(tilt) + 1e-3
            step = np.linalg.norm(np.diff(points, axis=0), axis=1)
            assert step == pytest.approx(strip.length / 399, rel=0.02), "no spikes: even in length"


def test_points_that_swing_are_refused() -> None:
    points = naca_section("0015")[::10]
    points[3, 0] += 1e-4  # two points a step apart, then far apart: the curve between must turn back
    points[4] = points[3] + [1e-5, -3e-5]
    with pytest.raises(TooUneven):
        section_through(points, 8)


# Layers


@pytest.mark.slow
def test_layers_lie_their_height_above_each_other(toolpath: Toolpath) -> None:
    """Along the normal, within 2 per cent, on either half: from any place of a layer to the one that is one further in."""
    deepest = 0
    for bead in toolpath.beads:
        for other in toolpath.beads:
            lower = bead.layer < 11
            if other.layer - bead.layer != 1 or (other.layer < 11) != lower:
                continue
            inner, outer = (other, bead) if lower else (bead, other)
            way = HEIGHT if lower else -HEIGHT
            inner_up = inner.points[:, ::2] - way * inner.normals[:, ::2]
            curve = curve_of(outer)
            distance, _ = cKDTree(curve).query(inner_up)
            beside = (inner_up[:, 0] > curve[0, 0]) & (inner_up[:, 0] < curve[-1, 0])  # some end a hair further out
            assert beside.mean() > 0.99
            assert distance[beside].max() < 0.02 * HEIGHT
            deepest += 1
    assert deepest == 21


def curve_of(bead: object) -> Array:
    """The tip curve of a bead's layer, densely, whatever the order of its passes."""
    points = bead.source[:, ::2]  # type: ignore[attr-defined]
    points = points[np.argsort(points[:, 0])]
    x = np.linspace(points[0, 0], points[-1, 0], 40_000)
    keep = np.concatenate([[True], np.diff(points[:, 0]) > 1e-7])
    return np.column_stack([x, np.interp(x, *points[keep].T)])


@pytest.mark.slow
def test_halves_meet_at_the_chord_line(toolpath: Toolpath) -> None:
    assert toolpath.layers == 23
    for bead in toolpath.beads:
        z = bead.points[:, 2]
        assert (z.max() < CHORD_LINE) if bead.layer < 11 else (z.min() > CHORD_LINE)
        assert bead.normals[:, 2].min() >= np.cos(np.radians(45.0))
    upper, lower = toolpath.beads[-1], toolpath.beads[0]
    assert upper.points[:, 2].max() == pytest.approx(14.7032e-3, abs=1e-6), "the last layer's tip is the surface"
    assert lower.points[:, 2].min() == pytest.approx(2.7000e-3 + HEIGHT, abs=1e-6)


def test_types_alternate_and_outer_layers_run_along_the_curve(toolpath: Toolpath) -> None:
    def runs_along(bead: object) -> bool:
        steps = np.abs(np.diff(bead.points, axis=0)).sum(axis=0)  # type: ignore[attr-defined]
        return bool(steps[0] > steps[1])

    along = [runs_along(bead) for bead in toolpath.beads]
    assert along[0]
    assert along[-1]
    assert along[:11] == [k % 2 == 0 for k in range(11)]
    assert along[11:] == [k % 2 == 0 for k in range(12)][::-1]


@pytest.mark.slow
def test_each_layer_lies_on_what_is_printed(toolpath: Toolpath) -> None:
    """In the lower half exactly; the upper half fills the steps of the lower one, up to two heights deep."""
    for i, bead in enumerate(toolpath.beads):
        gap = toolpath.surface.before(i + 1).signed_distance(bead.points)
        if bead.layer < 11:
            assert gap == pytest.approx(HEIGHT, abs=1e-6)
        else:
            assert gap.min() > 0.5 * HEIGHT
            assert gap.max() < 2.05 * HEIGHT
        assert toolpath.surface.normals_on(i, bead.s, bead.points) == pytest.approx(bead.normals, abs=1e-9)
        assert bead.points[:, 1].min() >= 0.0
        assert bead.points[:, 1].max() <= 4e-3


@pytest.mark.slow
def test_beads_fill_the_wing() -> None:
    """Volume of all beads against the section's area times the span: what is missing is nose, tail and half passes."""
    toolpath = build_toolpath(problem("layers.support=null"))
    volume = sum(float(bead.width[0] * bead.height[0] * bead.length) for bead in toolpath.beads)
    area = 80e-3**2 * 2.0 * np.trapezoid(formula(np.linspace(0.0, 1.0, 10_001)), dx=1e-4)
    assert 0.92 * area * 20e-3 < volume < 1.02 * area * 20e-3
    assert all(bead.width[0] == pytest.approx(0.5e-3, rel=0.02) for bead in toolpath.beads)


def test_a_layer_begins_at_the_corner_nearest_to_the_last_end(toolpath: Toolpath) -> None:
    for before, bead in zip(toolpath.beads[:-1], toolpath.beads[1:], strict=True):
        x, y = bead.points[:, 0], bead.points[:, 1]
        corners = np.array([[x.min(), y.min()], [x.min(), y.max()], [x.max(), y.min()], [x.max(), y.max()]])
        nearest = np.linalg.norm(corners - before.points[-1, :2], axis=1).min()
        assert np.linalg.norm(bead.points[0, :2] - before.points[-1, :2]) <= nearest + 0.4e-3


@pytest.mark.slow
@pytest.mark.parametrize("digits", ["0006", "2412", "6409", "4415"])
def test_other_sections_are_laid(digits: str) -> None:
    text = problem().file.read_text("utf-8").replace("aerofoil: naca0015_arigela.dat", f'naca: "{digits}"')
    toolpath = build_toolpath(
        load_text(text, "layers.source.span_mm=2", "layers.source.origin_mm=[0, 0, 9]", "layers.support=null")
    )
    assert toolpath.layers >= 8
    for i, bead in enumerate(toolpath.beads):
        assert toolpath.surface.before(i + 1).signed_distance(bead.points).min() > 0.0
        assert bead.normals[:, 2].min() > 0.7


_FOLDER: list[Path] = []


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path) -> None:
    _FOLDER[:] = [tmp_path]


def load_text(text: str, *changes: str) -> Problem:
    path = _FOLDER[0] / "wing.yaml"
    path.write_text(text, encoding="utf-8")
    return load_problem(path, changes)


# Supports


@pytest.mark.slow
def test_level_layers_stand_on_the_bed_and_stay_below_the_curved_ones(supported: Toolpath) -> None:
    level = [bead for bead in supported.beads if bead.layer < 17]
    assert {round(float(z) * 1e6) for bead in level for z in bead.points[:, 2]} == {500 * k for k in range(1, 18)}
    assert min(bead.points[:, 0].min() for bead in level) == pytest.approx(0.25e-3, abs=0.2e-3)
    assert max(bead.points[:, 0].max() for bead in level) == pytest.approx(109.75e-3, abs=0.2e-3)
    curved, surface = (next(bead for bead in supported.beads if bead.layer == layer) for layer in (17, 18))
    tree = cKDTree(curved.points[:, ::2] - HEIGHT * curved.normals[:, ::2])
    for bead in level:
        under = (bead.points[:, 0] > curved.points[:, 0].min()) & (bead.points[:, 0] < curved.points[:, 0].max())
        _, k = tree.query(bead.points[under][:, ::2])
        away = bead.points[under][:, ::2] - tree.data[k]
        assert ((away * curved.normals[k][:, ::2]).sum(axis=1) < 2e-5).all()
    assert surface.points[:, 2].min() == pytest.approx(2.7000e-3, abs=1e-6), "the wing's own lower surface"


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [20.0, 45.0])
def test_level_layers_rise_beside_curved_ones_no_steeper_than_these_lean(tilt: float) -> None:
    """So that a nozzle that stands on the rim of a curved layer, and leans with it, meets no wall."""
    toolpath = build_toolpath(problem("layers.source.span_mm=4", "layers.count=18", f"layers.source.tilt_deg={tilt}"))
    curved = next(bead for bead in toolpath.beads if bead.layer == 17)
    under = curved.points - HEIGHT * curved.normals
    for rim, outwards in ((under[np.argmin(under[:, 0])], -1.0), (under[np.argmax(under[:, 0])], 1.0)):
        above = [bead for bead in toolpath.beads if bead.layer < 17 and bead.points[0, 2] > rim[2] + HEIGHT]
        away = {}
        for bead in above:
            beside = outwards * (bead.points[:, 0] - rim[0])
            away[bead.layer] = min(away.get(bead.layer, np.inf), float(beside[beside > 0.0].min(initial=np.inf)))
        assert away, "there is some support beside the wing"
        for layer, at in away.items():
            rises = (layer + 1) * HEIGHT - rim[2]
            assert at >= rises / np.tan(np.radians(tilt))
            assert at < rises / np.tan(np.radians(tilt)) + 2e-3, "nor leave more room than that"


def test_level_layers_are_half_filled_and_curved_ones_whole(supported: Toolpath) -> None:
    for bead in supported.beads:
        if bead.layer >= 17:
            continue
        sizes = np.ptp(bead.points, axis=0)
        if sizes[0] > 20e-3:
            filled = bead.length * bead.width[0] / ((sizes[0] + 0.5e-3) * 4e-3)
            assert 0.45 < filled < 0.62, "the turns add a little to the half"
    curved = [bead for bead in supported.beads if bead.layer in (17, 18)]
    for bead in curved:
        assert bead.length * bead.width[0] / (np.ptp(bead.points[:, 0]) * 4e-3) > 0.9


def test_a_supported_wing_lies_on_its_support(supported: Toolpath) -> None:
    for i, bead in enumerate(supported.beads):
        gap = supported.surface.before(i + 1).signed_distance(bead.points)
        assert gap.min() > 0.9 * HEIGHT
        assert gap.max() < 2.0 * HEIGHT
        if bead.layer != 17:
            assert gap == pytest.approx(HEIGHT, abs=1e-6)


@pytest.mark.slow
def test_passes_apart_are_those_of_a_zigzag() -> None:
    """Each is a bead, in the same order and direction: the next begins beside the end of the last, one pass away."""
    short = ("layers.source.span_mm=4", "layers.support=null", "layers.count=2")
    apart, whole = build_toolpath(problem(*short, "layers.passes=apart")), build_toolpath(problem(*short))
    for layer, bead in enumerate(whole.beads):
        own = [each for each in apart.beads if each.layer == layer]
        assert [each.name for each in own] == [f"{bead.name} pass {k}" for k in range(1, len(own) + 1)]
        assert own[0].points[0] == pytest.approx(bead.points[0], abs=1e-9)
        assert own[-1].points[-1] == pytest.approx(bead.points[-1], abs=1e-9)
        gaps = [np.linalg.norm(b.points[0] - a.points[-1]) for a, b in zip(own[:-1], own[1:], strict=True)]
        assert gaps == pytest.approx([own[0].width[0]] * len(gaps), rel=1e-3)
        assert 0.85 < bead.length / (sum(each.length for each in own) + sum(gaps)) < 1.0, "but for rounded corners"
    assert apart.surface.before(len(apart.beads)).signed_distance(np.array([[0.05, 2e-3, 0.0]])) == pytest.approx([0.0])


def test_pieces_of_a_layer_are_laid_from_the_near_end_on(supported: Toolpath) -> None:
    way = sum(
        float(np.linalg.norm(bead.points[0] - before.points[-1]))
        for before, bead in zip(supported.beads[:-1], supported.beads[1:], strict=True)
    )
    assert len(supported.beads) > 25
    assert way / (len(supported.beads) - 1) < 40e-3


# The solid


@pytest.mark.slow
def test_distance_from_the_solid_agrees_with_brute_force(toolpath: Toolpath) -> None:
    """Sign by polygons of the strips, size by the distance from a dense outline of their union."""
    rng = np.random.default_rng(5)
    points = np.column_stack([rng.uniform(5e-3, 105e-3, 400), np.full(400, 2e-3), rng.uniform(0.1e-3, 20e-3, 400)])
    solid = toolpath.surface
    assert isinstance(solid, LayeredSolid)
    for bead in (0, 5, 12, 23):
        surface = solid.before(bead)
        got = surface.signed_distance(points)
        grid = np.stack(np.meshgrid(np.arange(10e-3, 100e-3, 1e-4), np.arange(0.1e-3, 16e-3, 1e-4)), axis=-1)
        flat = grid.reshape(-1, 2)
        three = np.column_stack([flat[:, 0], np.full(len(flat), 2e-3), flat[:, 1]])
        inside = surface.signed_distance(three) < 0.0
        away, _ = cKDTree(flat[inside]).query(points[:, ::2])
        outside = got > 0.3e-3
        wanted = np.minimum(away, points[:, 2])
        assert got[outside] == pytest.approx(wanted[outside], abs=1.5e-4)  # the grid's diagonal
        assert (away[got < 0.0] < 1e-4).all()


@pytest.mark.slow
def test_beside_the_span_is_outside(toolpath: Toolpath) -> None:
    solid = toolpath.surface.before(23)
    points = np.array([[0.05, -1e-3, 8e-3], [0.05, 7e-3, 8e-3], [0.05, 2e-3, 5e-3], [0.05, 2e-3, -1e-3]])
    assert solid.signed_distance(points) == pytest.approx([1e-3, 3e-3, -2e-3, -1e-3], abs=1e-5)


def test_flat_strips_cover_what_they_say() -> None:
    strip = FlatStrip(1e-3, 3e-3, 2e-3, 1.5e-3)
    solid = LayeredSolid((strip,), (0,), (0,), (0.0, 1e-3), 1)
    points = np.array([[2e-3, 0.5e-3, 3e-3], [2e-3, 0.5e-3, 1.9e-3], [4e-3, 0.5e-3, 1.75e-3]])
    assert solid.signed_distance(points) == pytest.approx([1e-3, -1e-4, 1e-3], abs=1e-6)
    assert solid.normals_on(0, np.zeros(3), points) == pytest.approx(np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert solid.normals(points) == pytest.approx(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))


# Problems

MISTAKES = [
    ("aerofoil: naca0015_arigela.dat", 'naca: "15"', "layers.source.naca", "not a four-digit section", '"0015"'),
    ("aerofoil: naca0015_arigela.dat", "naca: 2412", "layers.source.naca", "in quotes", '"0015"'),
    ("aerofoil: naca0015_arigela.dat", 'naca: "0400"', "layers.source.naca", "no thickness", '"0015"'),
    ("aerofoil: naca0015_arigela.dat", 'naca: "2012"', "layers.source.naca", "camber without its place", "both 0"),
    ("aerofoil: naca0015_arigela.dat", 'aerofoil: a.dat, naca: "0015"', "layers.source", "both", "exactly one"),
    ("aerofoil: naca0015_arigela.dat, ", "", "layers.source", "neither aerofoil nor naca", "exactly one"),
    ("aerofoil:", "airfoil:", "layers.source.airfoil", "unknown key", "did you mean aerofoil?"),
    ("span_mm: 20, ", "", "layers.source.span_mm", "is missing", "span [mm]"),
    ("tilt_deg: 45", "tilt_deg: 91", "layers.source.tilt_deg", "too large", "5 to 90"),
    ("curved: 2", "curved: 1.5", "layers.support.curved", "whole number", "0 to 20"),
    ("length_mm: 110, ", "", "layers.support.length_mm", "is missing", "[mm]"),
    ("layers:", "part: {cylinder: {radius_mm: 9, height_mm: 9}}\nlayers:", "part", "its own body", "leave out part"),
]


@pytest.mark.parametrize(("old", "new", "field", "reason", "hint"), MISTAKES)
def test_mistakes_are_told(old: str, new: str, field: str, reason: str, hint: str) -> None:
    text = problem().file.read_text("utf-8")
    assert text.count(old) == 1
    with pytest.raises(InputError) as caught:
        load_text(text.replace(old, new))
    assert (caught.value.field or "").startswith(field)
    assert caught.value.line is not None
    assert reason in caught.value.reason
    assert hint in (caught.value.hint or "")
    assert "more" not in (caught.value.hint or "")


UNPRINTABLE = [
    ("layers.source.origin_mm=[15, 0, 5]", "layers.source.origin_mm", "1.00 mm below"),
    ("layers.source.chord_mm=2", "layers.height_mm", "too small for a single layer"),
    ("layers.source.span_mm=1.2", "layers.source.span_mm", "too short"),
    ("layers.support.curved=6", "layers.support.curved", "2.70 mm above the bed"),
    ("layers.support.length_mm=79", "layers.support.length_mm", "less than the chord"),
    ("layers.support.height_mm=9", "layers.support.height_mm", "above the leading edge"),
    ("layers.source.aerofoil=none.dat", "layers.source.aerofoil", "no file"),
]


@pytest.mark.slow(cases=("layers.support*",))
@pytest.mark.parametrize(("change", "field", "reason"), UNPRINTABLE)
def test_wings_that_cannot_be_printed_are_refused(change: str, field: str, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        build_toolpath(problem(change))
    assert field in (caught.value.field or "")
    assert reason in caught.value.reason


@pytest.mark.parametrize("case", CASES)
def test_a_conventional_case_is_a_problem_and_stands_on_the_page(case: str) -> None:
    """As the command plans it, so the page says it: the settings are the same, and the problem takes them."""
    wing = load_problem("naca0015_wing", CASES[case])
    assert wing.process.extruder.motor == ("on_off" if case == "curved layers" else "e_axis")
    page = (Path(__file__).parents[1] / "docs" / "problems" / "naca0015_wing.md").read_text(encoding="utf-8")
    lines = [
        shlex.split(line) for line in page.splitlines() if line.startswith("    .venv/bin/python -m planner.solve")
    ]
    named = [[value for word, value in itertools.pairwise(line) if word == "--set"] for line in lines]
    assert list(CASES[case]) in named
