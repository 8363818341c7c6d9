"""Clip paths and masks: by hand, against sampled points, and every refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.toolpath.svg.outlines import PlanePath, read_svg

SVG = "http://www.w3.org/2000/svg"
# At a width of 0.1 m one unit is one millimetre, and a point (x, y) of the drawing comes out at (x - 50, 50 - y) mm.
FRAME = '<rect x="0" y="0" width="100" height="100"/>'
RIGHT = '<clipPath id="right"><rect x="50" y="0" width="50" height="100"/></clipPath>'


def read(folder: Path, content: str, flatness: float = 1e-5) -> list[PlanePath]:
    """The paths of a drawing but for the frame around it."""
    file = folder / "drawing.svg"
    file.write_text(f'<svg xmlns="{SVG}">\n{FRAME}\n{content}\n</svg>', encoding="utf-8")
    return list(read_svg(file, 0.1, flatness)[1:])


def units(path: PlanePath) -> Array:
    """Points of a path in the drawing's own units."""
    return np.asarray(path.points * [1e3, -1e3] + 50)


def area(points: Array) -> float:
    x, y = points[:-1].T, points[1:].T
    return abs(float((x[0] * y[1] - y[0] * x[1]).sum())) / 2


def test_of_a_filled_shape_the_outline_of_what_is_left(tmp_path: Path) -> None:
    (half,) = read(tmp_path, RIGHT + '<circle id="c" cx="50" cy="50" r="20" clip-path="url(#right)"/>')
    points = units(half)
    assert half.closed and half.name == "c"
    np.testing.assert_allclose([points.min(0), points.max(0)], [[50, 30], [70, 70]], atol=1e-9)
    assert area(points) == pytest.approx(200 * np.pi, rel=1e-3)
    arc = points[points[:, 0] > 50 + 1e-9]
    assert np.abs(np.hypot(*(arc - 50).T) - 20).max() < 1e-9  # chords have their ends on the circle


def test_of_a_line_what_lies_inside(tmp_path: Path) -> None:
    content = '<circle cx="50" cy="50" r="20" fill="none" stroke="red" clip-path="url(#right)"/>'
    (arc,) = read(tmp_path, RIGHT + content)
    assert not arc.closed
    points = units(arc)
    assert np.abs(np.hypot(*(points - 50).T) - 20).max() < 0.01
    assert abs(np.abs(points[[0, -1], 1] - 50) - 20).max() < 0.01
    (line,) = read(tmp_path, RIGHT + '<line x1="30" y1="10" x2="70" y2="10" clip-path="url(#right)"/>')
    np.testing.assert_allclose(np.sort(units(line), axis=0), [(50, 10), (70, 10)], atol=1e-9)


def test_what_is_not_cut_keeps_its_curves(tmp_path: Path) -> None:
    shape = '<path d="M60 50C60 20 90 20 90 50z"/>'
    (free,) = read(tmp_path, shape)
    (inside,) = read(tmp_path, f'{RIGHT}<g clip-path="url(#right)">{shape}</g>')
    np.testing.assert_array_equal(free.points, inside.points)
    twin = '<defs><circle id="a" cx="40" cy="40" r="30"/><mask id="m" fill="#fff"><use href="#a"/></mask></defs>'
    paths = read(tmp_path, twin + '<use href="#a"/><use href="#a" mask="url(#m)"/>')
    np.testing.assert_array_equal(paths[0].points, paths[1].points)  # cut by itself


def test_what_lies_outside_is_not_drawn(tmp_path: Path) -> None:
    assert read(tmp_path, RIGHT + '<g clip-path="url(#right)"><circle cx="20" cy="50" r="20"/></g>') == []
    file = tmp_path / "drawing.svg"
    file.write_text(f'<svg xmlns="{SVG}">{RIGHT}<circle cx="20" cy="50" r="20" clip-path="url(#right)"/></svg>')
    with pytest.raises(InputError, match="draws nothing"):
        read_svg(file, 0.1, 1e-5)


def test_the_width_is_that_of_what_is_left(tmp_path: Path) -> None:
    """A circle of radius 20 cut to a sliver of 5: ten times as large as it would be uncut, and as exact."""
    file = tmp_path / "drawing.svg"
    clip = '<clipPath id="c"><rect x="65" y="0" width="50" height="100"/></clipPath>'
    file.write_text(f'<svg xmlns="{SVG}">{clip}<circle cx="50" cy="50" r="20" clip-path="url(#c)"/></svg>')
    (path,) = read_svg(file, 0.1, 1e-5)
    assert np.ptp(path.points[:, 0]) == pytest.approx(0.1, abs=1e-9)
    arc = path.points[path.points[:, 0] > path.points[:, 0].min() + 1e-9]
    centre = np.array([arc[:, 0].max() - 0.4, 0.0])  # 5 units are 100 mm: a radius of 400 mm
    middles = (0.5 * (arc[1:] + arc[:-1]))[np.hypot(*np.diff(arc, axis=0).T) < 0.02]  # without the step along the cut
    assert np.abs(np.linalg.norm(arc - centre, axis=1) - 0.4).max() < 1e-6
    assert 0.4 - np.linalg.norm(middles - centre, axis=1).min() < 1.1e-5


def test_fill_rules_and_holes(tmp_path: Path) -> None:
    rings = 'd="M10 10H90V90H10zM30 30H70V70H30z"'  # both the same way round
    (whole,) = read(tmp_path, f'{RIGHT}<path {rings} clip-path="url(#right)"/>')
    assert area(units(whole)) == pytest.approx(40 * 80)  # nonzero: the inner one bounds nothing
    (bent,) = read(tmp_path, f'{RIGHT}<g fill-rule="evenodd"><path {rings} clip-path="url(#right)"/></g>')
    assert area(units(bent)) == pytest.approx(40 * 80 - 20 * 40)
    clip = f'<clipPath id="c"><path {rings} clip-rule="evenodd"/></clipPath>'
    outer, inner = read(tmp_path, clip + '<rect x="5" y="5" width="80" height="80" clip-path="url(#c)"/>')
    assert sorted([area(units(outer)), area(units(inner))]) == pytest.approx([40 * 40, 75 * 75])


@pytest.mark.parametrize(
    ("mask", "left"),
    [
        ('<rect fill="#fff" x="10" y="10" width="40" height="40"/>', [40 * 40]),
        ('<rect fill="#833bff" x="10" y="10" width="40" height="40"/>', [40 * 40]),  # opacity does not matter
        (
            '<rect fill="#fff" x="10" y="10" width="40" height="40"/><rect x="20" y="20" width="9" height="9"/>',
            [1600, 81],
        ),
        ('<rect x="20" y="20" width="9" height="9"/><rect fill="#fff" x="10" y="10" width="40" height="40"/>', [1600]),
        ('<g fill="white"><rect x="10" y="10" width="40" height="40"/></g>', [1600]),
        ('<rect fill="none" x="10" y="10" width="40" height="40"/>', []),
        ('<rect x="10" y="10" width="40" height="40"/>', []),  # black shows nothing
        ('<rect fill="url(#g)" x="10" y="10" width="40" height="40"/>', [1600]),
    ],
)
def test_masks_show_and_hide_in_painting_order(tmp_path: Path, mask: str, left: list[float]) -> None:
    gradient = '<linearGradient id="g"><stop stop-color="#fff"/><stop offset="1" stop-color="red"/></linearGradient>'
    content = f'{gradient}<mask id="m">{mask}</mask><rect x="5" y="5" width="80" height="80" mask="url(#m)"/>'
    assert [area(units(path)) for path in read(tmp_path, content)] == pytest.approx(left)


def test_masks_by_alpha_and_with_a_box(tmp_path: Path) -> None:
    box = 'maskUnits="userSpaceOnUse" x="20" y="0" width="100" height="100"'
    mask = f'<mask id="m" style="mask-type:alpha" {box}><rect x="10" y="10" width="40" height="40"/></mask>'
    (path,) = read(tmp_path, mask + '<rect x="5" y="5" width="80" height="80" style="mask:url(#m)"/>')
    assert area(units(path)) == pytest.approx(30 * 40)
    whole = '<mask id="n" x="-5%" y="0" width="1.1" height="100%"><rect fill="#fff" width="40" height="40"/></mask>'
    (path,) = read(tmp_path, whole + '<rect width="80" height="80" mask="url(#n)"/>')
    assert area(units(path)) == pytest.approx(40 * 40)


def test_cuts_nest_and_stand_in_the_units_of_what_they_cut(tmp_path: Path) -> None:
    clips = (
        '<clipPath id="a"><rect width="20" height="20"/></clipPath>'
        '<clipPath id="b" transform="translate(5 0)" clip-path="url(#a)"><use href="#r"/></clipPath>'
        '<defs><rect id="r" y="10" width="30" height="30"/></defs>'
    )
    (path,) = read(tmp_path, clips + '<g transform="scale(2)" clip-path="url(#b)"><rect width="40" height="40"/></g>')
    points = units(path)  # x from 5 to 25, y from 10 to 20, all doubled: the inner clip is moved along
    np.testing.assert_allclose([points.min(0), points.max(0)], [[10, 20], [50, 40]], atol=1e-9)
    content = '<g clip-path="url(#a)"><g transform="translate(10 0)" clip-path="url(#a)"><rect width="40" height="40"/></g></g>'
    (path,) = read(tmp_path, clips + content)
    points = units(path)
    np.testing.assert_allclose([points.min(0), points.max(0)], [[10, 0], [20, 20]], atol=1e-9)


def test_an_unstroked_point_beside_other_subpaths_draws_nothing(tmp_path: Path) -> None:
    (path,) = read(tmp_path, '<path d="M5 5z M10 10L20 20 M7 7l0 0z"/>')
    np.testing.assert_allclose(units(path), [(10, 10), (20, 20)], atol=1e-12)


LINE = '<path d="M60 0L70 9"/>'
REFUSALS = [
    ('<path clip-path="url(#c)" d="M0 0L1 1"/>', 1, "there is no element 'c'"),
    ('<path clip-path="inset(5px)" d="M0 0L1 1"/>', 1, "clip-path is not supported: 'inset"),
    (f'<g mask="url(#right)">{LINE}</g>\n{RIGHT}', 1, "mask names <clipPath> 'right', not a <mask>"),
    (f'<clipPath id="c" clip-path="url(#c)">{LINE}</clipPath><g clip-path="url(#c)">{LINE}</g>', 1, "cut by itself"),
    (
        f'<mask id="m"><g mask="url(#n)"/></mask><mask id="n"><g mask="url(#m)"/></mask><g mask="url(#m)">{LINE}</g>',
        1,
        "cut by itself",
    ),
    (f'<clipPath id="c"><g>{LINE}</g></clipPath><g clip-path="url(#c)">{LINE}</g>', 1, "<g> is not allowed in"),
    (
        f'<clipPath id="c" clipPathUnits="objectBoundingBox">{LINE}</clipPath>\n<g clip-path="url(#c)">{LINE}</g>',
        1,
        "clipPathUnits other than userSpaceOnUse",
    ),
    (f'<mask id="m" x="10%">{LINE}</mask><g mask="url(#m)">{LINE}</g>', 1, "smaller than what it masks"),
    (f'<mask id="m" x="1" maskUnits="userSpaceOnUse"/><g mask="url(#m)">{LINE}</g>', 1, "x, y, width and height"),
    (
        '<mask id="m">\n<rect opacity=".5" width="9" height="9"/></mask><rect mask="url(#m)" width="5" height="5"/>',
        2,
        "partly",
    ),
    (
        '<mask id="m"><rect stroke="red" width="9" height="9"/></mask><rect mask="url(#m)" width="5" height="5"/>',
        1,
        "stroke",
    ),
    (
        '<linearGradient id="g"><stop stop-color="#fff" stop-opacity="0"/></linearGradient>'
        '<mask id="m"><rect fill="url(#g)" width="9" height="9"/></mask><rect mask="url(#m)" width="5" height="5"/>',
        1,
        "may be transparent",
    ),
    (
        '<mask id="m"><rect fill="#ffffff00" width="9" height="9"/></mask><rect mask="url(#m)" width="5" height="5"/>',
        1,
        "may be transparent",
    ),
    (f'<style>g > path{{fill:none}}</style>\n{RIGHT}<g clip-path="url(#right)">{LINE}</g>', 2, "how it is filled"),
    (
        f'<style>path{{fill:none!important}}</style>\n{RIGHT}<g clip-path="url(#right)">{LINE}</g>',
        2,
        "how it is filled",
    ),
]


@pytest.mark.parametrize(("content", "line", "reason"), REFUSALS)
def test_refusals_name_the_line(tmp_path: Path, content: str, line: int, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, content)
    assert reason in caught.value.reason
    assert caught.value.line == line + 2
    assert caught.value.exit_code == 2


def test_paint_that_is_not_read_matters_only_where_something_is_cut(tmp_path: Path) -> None:
    assert len(read(tmp_path, f"<style>g > path{{fill:none!important}}</style><g>{LINE}</g>")) == 1


# ---- random shapes --------------------------------------------------------------------------------------------------

corner = st.tuples(st.integers(5, 95), st.integers(5, 95))
polygon = st.lists(corner, min_size=3, max_size=7, unique=True)
SAMPLES = np.random.default_rng(0).uniform(2, 98, (2000, 2))


def within(rings: list[Array], rule: str, points: Array) -> NDArray[np.bool_]:
    """Which points lie in rings: by the sum of the angles, so by another way than the reader's."""
    turns = np.zeros(len(points))
    for ring in rings:
        z = (ring[:, 0] + 1j * ring[:, 1])[None, :] - (points[:, 0] + 1j * points[:, 1])[:, None]
        turns += np.angle(z[:, 1:] / z[:, :-1]).sum(axis=1) / (2 * np.pi)
    count = np.round(turns).astype(int)
    return count % 2 == 1 if rule == "evenodd" else count != 0


def distance(rings: list[Array], points: Array) -> Array:
    """Distances of points from the lines of rings."""
    best = np.full(len(points), np.inf)
    for ring in rings:
        for a, b in zip(ring[:-1], ring[1:], strict=True):
            t = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0, 1)
            best = np.minimum(best, np.linalg.norm(a + t[:, None] * (b - a) - points, axis=1))
    return best


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shape=st.lists(polygon, min_size=1, max_size=2),
    clip=polygon,
    rules=st.tuples(*[st.sampled_from(["nonzero", "evenodd"])] * 2),
    kind=st.sampled_from(["clipPath", "mask"]),
)
def test_random_polygons_are_cut_where_points_say(
    tmp_path: Path, shape: list[list[tuple[int, int]]], clip: list[tuple[int, int]], rules: tuple[str, str], kind: str
) -> None:
    """The printed outlines part the points that are seen from those that are not."""

    def data(rings: list[list[tuple[int, int]]]) -> str:
        return "".join("M" + "L".join(f"{x} {y}" for x, y in ring) + "z" for ring in rings)

    name = {"clipPath": "clip-path", "mask": "mask"}[kind]
    rule = {"clipPath": "clip-rule", "mask": "fill-rule"}[kind]
    content = (
        f'<{kind} id="k" fill="#fff"><path {rule}="{rules[1]}" d="{data([clip])}"/></{kind}>'
        f'<path fill-rule="{rules[0]}" d="{data(shape)}" {name}="url(#k)"/>'
    )
    found = [units(path) for path in read(tmp_path, content) if path.closed]
    rings = [np.array([*ring, ring[0]], dtype=float) for ring in shape]
    cutter = [np.array([*clip, clip[0]], dtype=float)]
    filled = within(rings, rules[0], SAMPLES)
    if not filled.any():
        return  # a shape without area is cut as lines are
    seen = filled & within(cutter, rules[1], SAMPLES)
    clear = distance(rings + cutter, SAMPLES) > 0.05
    whole = [any(a.shape == b.shape and np.allclose(a, b) for b in rings) for a in found]
    # what is not cut keeps its own outlines, and then its own rule
    printed = within(found, rules[0] if len(found) == len(rings) and all(whole) else "evenodd", SAMPLES)
    np.testing.assert_array_equal(printed[clear], seen[clear])
