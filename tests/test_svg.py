"""The SVG reader: geometry against closed forms and an independent evaluation, structure by hand, and every refusal."""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.problem import load_problem
from planner.toolpath.build import build_toolpath
from planner.toolpath.svg import drawing
from planner.toolpath.svg.drawing import Drawing
from planner.toolpath.svg.outlines import PlanePath, read_svg, read_svg_once

ROOT = Path(__file__).resolve().parents[1]
BRISTOL = ROOT.parent / "shared/data/bristol/uob_logo.svg"
LOGO = ROOT / "problems/logo.svg"
SVG = "http://www.w3.org/2000/svg"
Read = Callable[..., tuple[PlanePath, ...]]
# A frame of 100 x 100 units around the geometry under test: at a width of 0.1 m one unit is one millimetre, and a point
# (x, y) of the drawing comes out at (x - 50, 50 - y) mm.
FRAME = '<rect x="0" y="0" width="100" height="100"/>'


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Read a drawing given by its content; the paths' points come back in millimetres of the drawing, y down."""

    def run(content: str, width: float = 0.1, flatness: float = 1e-5, root: str = "") -> tuple[PlanePath, ...]:
        file = tmp_path / "drawing.svg"
        file.write_text(
            f'<svg xmlns="{SVG}" xmlns:xlink="http://www.w3.org/1999/xlink" {root}>\n{content}\n</svg>',
            encoding="utf-8",
        )
        return read_svg(file, width, flatness)

    return run


def framed(read: Read, content: str, flatness: float = 1e-5) -> list[Array]:
    """Points of what is drawn inside of the frame, in the drawing's own units."""
    frame, *paths = read(FRAME + content, flatness=flatness)
    assert np.allclose(np.ptp(frame.points, axis=0), 0.1, atol=1e-15)
    return [path.points * [1e3, -1e3] + 50 for path in paths]


def length(points: Array) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


# ---- commands and shapes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "vertices"),
    [
        ("M10 10L20 10 20 30", [(10, 10), (20, 10), (20, 30)]),
        ("M10,10 20,10 20,30", [(10, 10), (20, 10), (20, 30)]),
        ("m10 10 10 0 0 20", [(10, 10), (20, 10), (20, 30)]),
        ("m10 10l10 0 0 20", [(10, 10), (20, 10), (20, 30)]),
        ("M10 10H20V30h-5v-5", [(10, 10), (20, 10), (20, 30), (15, 30), (15, 25)]),
        ("M10 10H20 30V40 50", [(10, 10), (20, 10), (30, 10), (30, 40), (30, 50)]),
        ("M10 10L20 10L20 30Z", [(10, 10), (20, 10), (20, 30), (10, 10)]),
        ("M1e1 1.E+1L20+.5.5.5-0-0", [(10, 10), (20, 0.5), (0.5, 0.5), (0, 0)]),
        ("M 10. 10. L 20. 30.", [(10, 10), (20, 30)]),
        ("M10 10A0 5 0 0 1 20 20", [(10, 10), (20, 20)]),  # no radius: a line
        ("M10 10C10 10 20 20 20 20", [(10, 10), (20, 20)]),  # a straight curve
        ("M10 10L20 10L20 10L20 30", [(10, 10), (20, 10), (20, 30)]),  # no repeated points
    ],
)
def test_straight_commands_give_their_vertices(read: Read, data: str, vertices: list[tuple[float, float]]) -> None:
    (points,) = framed(read, f'<path d="{data}"/>')
    np.testing.assert_allclose(points, vertices, atol=1e-12)


def bezier(*controls: tuple[float, float], n: int = 4001) -> Array:
    """Dense points of a Bézier curve by de Casteljau, so by another way than the reader's."""
    t = np.linspace(0, 1, n)[:, None]
    rows = [np.broadcast_to(np.array(c, dtype=float), (n, 2)) for c in controls]
    while len(rows) > 1:
        rows = [(1 - t) * a + t * b for a, b in pairwise(rows)]
    return rows[0]


def distance_to_chords(dense: Array, chords: Array) -> float:
    """Largest distance of dense points from a polyline."""
    a, d = chords[:-1], np.diff(chords, axis=0)
    worst = 0.0
    for block in np.array_split(dense, max(1, len(dense) * len(a) // 400_000)):
        t = np.clip(((block[:, None] - a) * d).sum(-1) / np.maximum((d * d).sum(-1), 1e-300), 0, 1)
        worst = max(worst, float(np.hypot(*np.moveaxis(a + t[..., None] * d - block[:, None], -1, 0)).min(1).max()))
    return worst


CURVES = [
    ("M20 50C20 20 80 20 80 50", [bezier((20, 50), (20, 20), (80, 20), (80, 50))]),
    ("m20 50c0-30 60-30 60 0", [bezier((20, 50), (20, 20), (80, 20), (80, 50))]),
    ("M20 50Q50 10 80 50", [bezier((20, 50), (50, 10), (80, 50))]),
    ("M20 50q30-40 60 0", [bezier((20, 50), (50, 10), (80, 50))]),
    (
        "M10 50C10 30 40 30 40 50S70 70 80 50",
        [bezier((10, 50), (10, 30), (40, 30), (40, 50)), bezier((40, 50), (40, 70), (70, 70), (80, 50))],
    ),
    (
        "M10 50c0-20 30-20 30 0s30 20 40 0",
        [bezier((10, 50), (10, 30), (40, 30), (40, 50)), bezier((40, 50), (40, 70), (70, 70), (80, 50))],
    ),
    (
        "M10 50Q25 20 40 50T70 50T90 40",
        [
            bezier((10, 50), (25, 20), (40, 50)),
            bezier((40, 50), (55, 80), (70, 50)),
            bezier((70, 50), (85, 20), (90, 40)),
        ],
    ),
    ("M10 50q15-30 30 0t30 0", [bezier((10, 50), (25, 20), (40, 50)), bezier((40, 50), (55, 80), (70, 50))]),
    # Reflection only of the same kind of curve: otherwise the control is the current point (SVG 1.1, 8.3.6 and 8.3.7).
    ("M10 50S40 30 40 50", [bezier((10, 50), (10, 50), (40, 30), (40, 50))]),
    (
        "M10 50Q25 20 40 50S70 70 80 50",
        [bezier((10, 50), (25, 20), (40, 50)), bezier((40, 50), (40, 50), (70, 70), (80, 50))],
    ),
    (
        "M10 50C10 30 30 30 40 50T60 60T70 40",
        [
            bezier((10, 50), (10, 30), (30, 30), (40, 50)),
            bezier((40, 50), (40, 50), (60, 60)),
            bezier((60, 60), (80, 70), (70, 40)),
        ],
    ),
]


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize(("data", "dense"), CURVES, ids=[data for data, _ in CURVES])
@pytest.mark.parametrize("flatness", [1e-3, 1e-5])
def test_curves_stay_within_the_flatness(read: Read, data: str, dense: list[Array], flatness: float) -> None:
    (points,) = framed(read, f'<path d="{data}"/>', flatness)
    curve = np.vstack(dense)
    assert distance_to_chords(curve, points) <= 1e3 * flatness * (1 + 1e-9)
    assert cKDTree(curve).query(points)[0].max() < 0.05  # every vertex lies on the curve
    for piece in dense:  # and the ends of the segments are vertices
        assert np.abs(points - piece[-1]).max(axis=1).min() < 1e-9
    assert len(points) < 12 * len(dense) * max(1.0, math.sqrt(1e-3 / flatness))


def arc(a: complex, rx: float, ry: float, turn: float, large: int, sweep: int, b: complex, n: int = 4001) -> Array:
    """Dense points of an arc from its end points (SVG 1.1, F.6.5 and F.6.6), in the complex plane."""
    phi = np.exp(1j * math.radians(turn))
    half = (a - b) / 2 / phi
    rx, ry = abs(rx), abs(ry)
    grow = math.sqrt(max(1.0, (half.real / rx) ** 2 + (half.imag / ry) ** 2))
    rx, ry = rx * grow, ry * grow
    u = complex(half.real / rx, half.imag / ry)  # the circle's frame: radius 1
    height = math.sqrt(max(0.0, 1 / abs(u) ** 2 - 1)) * (1 if large != sweep else -1)
    c = -1j * u * height
    first = np.angle(u - c)
    span = np.angle((-u - c) / (u - c)) % (2 * math.pi)
    if not sweep and span > 0:
        span -= 2 * math.pi
    w = c + np.exp(1j * (first + np.linspace(0, span, n)))
    z = (a + b) / 2 + phi * (w.real * rx + 1j * w.imag * ry)
    return np.column_stack([z.real, z.imag])


@pytest.mark.parametrize("large", [0, 1])
@pytest.mark.parametrize("sweep", [0, 1])
@pytest.mark.parametrize(("rx", "ry", "turn"), [(20, 20, 0), (30, 15, 0), (30, 15, 40), (5, 3, 70), (-30, 15, 40)])
def test_arcs_follow_the_standard(read: Read, rx: float, ry: float, turn: float, large: int, sweep: int) -> None:
    (points,) = framed(read, f'<path d="M40 45A{rx} {ry} {turn} {large}{sweep}60 50"/>')
    dense = arc(40 + 45j, rx, ry, turn, large, sweep, 60 + 50j)
    assert np.abs(dense[[0, -1]] - [[40, 45], [60, 50]]).max() < 1e-6  # the test's own arithmetic
    np.testing.assert_allclose(points[[0, -1]], [[40, 45], [60, 50]], atol=1e-9)
    assert distance_to_chords(dense, points) <= 0.01 * (1 + 1e-9)
    assert length(points) == pytest.approx(length(dense), rel=1e-3)


def test_round_shapes(read: Read) -> None:
    circle, ellipse, box = framed(
        read,
        '<circle cx="30" cy="40" r="20"/><ellipse cx="50" cy="50" rx="30" ry="10"/>'
        '<rect x="10" y="20" width="60" height="40" rx="8" ry="50"/>',
    )
    assert np.abs(np.hypot(*(circle - [30, 40]).T) - 20).max() < 1e-9
    assert length(circle) == pytest.approx(40 * math.pi, rel=5e-4)
    assert np.abs(((ellipse - 50) / [30, 10]) ** 2 @ [1, 1] - 1).max() < 1e-9
    # ry is cut to half of the height: two straight sides of 44, and two half ellipses of 8 x 20.
    np.testing.assert_allclose([box.min(0), box.max(0)], [[10, 20], [70, 60]], atol=1e-2)
    corner = box[box[:, 0] < 18 - 1e-9]
    assert np.abs(((corner - [18, 40]) / [8, 20]) ** 2 @ [1, 1] - 1).max() < 1e-9


def test_straight_shapes(read: Read) -> None:
    frame, line, polyline, polygon, box = read(
        FRAME + '<line x1="10" y1="20" x2="30" y2="40"/><polyline points="10,10 20,10,20 30"/>'
        '<polygon points="10-10 20-10 20 30"/><rect x="5" y="6" width="7" height="8"/>'
    )
    del frame
    for path, vertices, closed in [
        (line, [(10, 20), (30, 40)], False),
        (polyline, [(10, 10), (20, 10), (20, 30)], False),
        (polygon, [(10, -10), (20, -10), (20, 30), (10, -10)], True),
        (box, [(5, 6), (12, 6), (12, 14), (5, 14), (5, 6)], True),
    ]:
        assert path.closed is closed
        shift = np.array([50, 45])  # the polygon reaches to y = -10
        np.testing.assert_allclose(path.points * [1e3, -1e3] + shift, vertices, atol=1e-12)


def test_subpaths_and_what_follows_a_close(read: Read) -> None:
    paths = read(FRAME + '<path id="p" d="M10 10H20V20ZL5 5M30 30H40m5 5h5zl2 2h9zm1 1v3"/>')[1:]
    assert [path.name for path in paths] == ["p.1", "p.2", "p.3", "p.4", "p.5", "p.6"]
    assert [path.closed for path in paths] == [True, False, False, True, True, False]
    starts = [path.points[0] * [1e3, -1e3] + 50 for path in paths]
    np.testing.assert_allclose(starts, [(10, 10), (10, 10), (30, 30), (45, 35), (45, 35), (46, 36)], atol=1e-12)


def test_ends_that_meet_make_a_closed_path(read: Read) -> None:
    """Within rounding too, and then without a tiny last segment that would look like a corner."""
    (_, path) = read(FRAME + '<path d="M10 10H20V20L10.00000001 10"/>')
    assert path.closed and len(path.points) == 4 and (path.points[0] == path.points[-1]).all()
    (_, path) = read(FRAME + '<path d="M10 10H20V20L10.00000001 10Z"/>')
    assert path.closed and len(path.points) == 4


def test_points_nearer_than_a_hundredth_of_the_flatness_are_one(read: Read) -> None:
    many = " ".join(f"{10 + 1e-5 * k:.5f} 10" for k in range(1, 1001))
    (points,) = framed(read, f'<path d="M10 10 {many} 10.01 20"/>')
    steps = np.hypot(*np.diff(points, axis=0).T)
    assert steps.min() > 0.9e-4 and np.abs(points[[0, -1]] - [[10, 10], [10.01, 20]]).max() < 1e-9
    assert np.abs(points - [10.01, 10]).max(axis=1).min() < 1.1e-4


# ---- fit ----------------------------------------------------------------------------------------------------------


def test_fit_is_uniform_centred_and_y_points_up(read: Read) -> None:
    (path,) = read('<polygon points="100,200 300,200 100,260"/>', width=0.05)
    np.testing.assert_allclose(path.points * 1e3, [(-25, 7.5), (25, 7.5), (-25, -7.5), (-25, 7.5)], atol=1e-12)
    assert path.points.dtype == np.float64 and not path.points.flags.writeable


def test_fit_goes_by_the_curves_not_by_their_controls(read: Read) -> None:
    """Width of this cubic: x(t) = 3t(1-t)² · 100 has its largest value 400/9 at t = 1/3; of the arc: half a circle."""
    (path,) = read('<path d="M0 0C100 0 0 50 0 90"/>', width=0.04, flatness=1e-7)
    assert np.ptp(path.points[:, 0]) == pytest.approx(0.04, abs=2e-7)
    assert np.ptp(path.points[:, 1]) == pytest.approx(0.04 * 90 / (400 / 9), rel=1e-4)
    (path,) = read('<path d="M0 0A30 30 0 0 1 0 60"/>', width=0.03, flatness=1e-7)
    assert np.ptp(path.points[:, 1]) == pytest.approx(0.06, abs=1e-6)


# ---- structure ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        ("translate(3)", (13, 20)),
        ("translate(3,-4)", (13, 16)),
        ("scale(2)", (20, 40)),
        ("scale(2 .5)", (20, 10)),
        ("rotate(90)", (-20, 10)),
        ("rotate(90 10 10)", (0, 10)),
        ("skewX(45)", (30, 20)),
        ("skewY(45)", (10, 30)),
        ("matrix(1 2 3 4 5 6)", (75, 106)),
        ("translate(50 50) scale(2) rotate(90)", (10, 70)),
        ("scale(2),translate(5 5)", (30, 50)),
    ],
)
def test_transforms(read: Read, transform: str, expected: tuple[float, float]) -> None:
    """The frame is twice as wide as the point's image, so that it stays the bounding box."""
    frame = '<rect x="-200" y="-200" width="400" height="400"/>'
    _, path = read(frame + f'<g transform="{transform}"><path d="M0 0L10 20"/></g>', width=0.4)
    origin, point = path.points * [1e3, -1e3]
    _, own = read(frame + f'<path transform="{transform}" d="M0 0L10 20"/>', width=0.4)
    np.testing.assert_allclose(point, expected, atol=1e-10)
    np.testing.assert_array_equal(path.points, own.points)
    del origin


def test_an_arc_under_skew_is_exact(read: Read) -> None:
    """A sheared circle: undo the shear and the radius must be there again, also in the bounding box."""
    (points,) = framed(
        read, '<g transform="translate(10 10) skewX(30) scale(1 2)"><circle cx="20" cy="15" r="10"/></g>'
    )
    y = (points[:, 1] - 10) / 2
    x = points[:, 0] - 10 - 2 * y * math.tan(math.radians(30))
    assert np.abs(np.hypot(x - 20, y - 15) - 10).max() < 1e-9
    (alone,) = read('<circle r="10" transform="skewX(30)"/>', flatness=1e-8)
    wide, high = np.ptp(alone.points, axis=0)
    # x = 10 cos t + 10 tan 30° sin t reaches 10 / cos 30°
    assert high / wide == pytest.approx(math.cos(math.radians(30)), rel=1e-6)


def test_use_nests_transforms_and_offsets(read: Read) -> None:
    content = (
        '<defs><path id="tick" d="M0 0L2 0"/><g id="pair"><use href="#tick" y="1"/><use href="#tick" y="3"/></g></defs>'
        '<use xlink:href="#pair" x="10" transform="translate(5 5) scale(2)"/>'
    )
    points = framed(read, content)
    np.testing.assert_allclose(points[0], [(25, 7), (29, 7)], atol=1e-12)
    np.testing.assert_allclose(points[1], [(25, 11), (29, 11)], atol=1e-12)


def test_what_is_drawn_twice_is_printed_once(tmp_path: Path) -> None:
    """Either way round; but not what is drawn beside it."""
    file = tmp_path / "twice.svg"
    content = (
        '<path d="M0 0L30 0L30 9"/><path d="M30 9L30 0L0 0"/><path d="M0 1L30 1L30 10"/><circle r="4"/><circle r="4"/>'
    )
    file.write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{content}</svg>')
    paths, told = read_svg_once(file, 0.1, 1e-5)
    assert [path.name for path in paths] == ["path 1", "path 3", "circle 1"]
    assert told == ("layers.source.svg: 2 paths drawn twice left out",)
    assert len(read_svg(file, 0.1, 1e-5)) == 5
    problem = load_problem("cylinder_logo", [f"layers.source={{svg: {file}, width_mm: 30}}", "layers.count=1"])
    toolpath = build_toolpath(problem)
    assert len(toolpath.beads) == 3 and "layers.source.svg: 2 paths drawn twice left out" in toolpath.notes


def test_what_no_one_sees_is_left_out_and_told(tmp_path: Path) -> None:
    """Frames without fill and stroke, as around icons, unless all is like that, and points that were left behind."""
    file = tmp_path / "icon.svg"

    def read(content: str) -> tuple[list[str], tuple[str, ...]]:
        file.write_text(f'<svg xmlns="{SVG}">{content}</svg>')
        paths, told = read_svg_once(file, 0.1, 1e-5)
        assert np.ptp(np.vstack([path.points for path in paths])[:, 0]) == pytest.approx(0.1)
        return [path.name for path in paths], tuple(each.removeprefix("layers.source.svg: ") for each in told)

    frame = '<path id="frame" fill="none" d="M-9-9h99v99h-99z"/>'
    line = '<path id="line" stroke="red" d="M0 0L30 0L30 9"/><rect class="a" width="70" height="70"/>'
    line = f'<g fill="none">{line}</g>'
    unseen = "with neither fill nor stroke, hence invisible, left out"
    style = "<style>.a{stroke:transparent}</style>"
    assert read(frame + line + style) == (["line"], (f"2 shapes {unseen}",))
    assert read(frame) == (["frame"], ())
    assert read(f"<style>g > path{{stroke:red}}</style>{frame}{line}") == (["frame", "line", "rect 1"], ())
    dots = '<path d="M500 5"/><path stroke="red" d="M700 5Z"/><line x1="3" x2="3"/><polyline points="1 1"/>'
    assert read(dots + '<path d=""/>' + line) == (["line"], (f"1 shape {unseen}", "4 single points left out"))
    assert read('<path id="x" stroke="red" d="M5 5M0 0L1 1"/>') == (["x"], ("1 single point left out",))


@pytest.mark.parametrize(
    ("root", "off"),
    [
        ('viewBox="0 0 20 20"', 1),
        ('viewBox="-50 0 70 20" width="7mm" height="9mm"', 1),
        ('width="20" height="20"', 1),
        ('viewBox="0 0 20 60"', 0),
        ("", 0),
    ],
)
def test_what_lies_outside_of_the_page_is_told(tmp_path: Path, root: str, off: int) -> None:
    """Not what only reaches beyond its edge."""
    file = tmp_path / "page.svg"
    drawn = '<path d="M1 1L30 9"/><circle cx="15" cy="15" r="9"/><path d="M0 40L9 50 9 40z"/>'
    file.write_text(f'<svg xmlns="{SVG}" {root}>{drawn}</svg>')
    told = read_svg_once(file, 0.1, 1e-5)[1]
    assert len(told) == off and all("1 shape outside of the page" in each for each in told)


@pytest.mark.parametrize(
    ("drawn", "told"),
    [
        ('<rect width="20" height="10" fill="white"/>', True),
        ('<path d="M0 0H20V10H0z"/>', True),
        ('<rect width="20" height="9"/>', False),
        ('<path d="M0 0L20 10M0 10L20 0"/>', False),
        ('<ellipse cx="10" cy="5" rx="10" ry="5"/>', False),
    ],
)
def test_a_background_is_told_of(tmp_path: Path, drawn: str, told: bool) -> None:
    file = tmp_path / "page.svg"
    file.write_text(f'<svg xmlns="{SVG}" viewBox="0 0 20 10" width="90mm">{drawn}<path d="M1 1L9 9"/></svg>')
    assert any("along the edges of the page" in each for each in read_svg_once(file, 0.1, 1e-5)[1]) == told


def test_symbols_are_fitted_into_their_use(read: Read) -> None:
    content = (
        '<symbol id="s" viewBox="0 0 10 20"><path d="M0 0L10 20"/></symbol>'
        '<use href="#s" x="10" y="10" width="40" height="40"/>'
        '<symbol id="n" viewBox="0 0 10 20" preserveAspectRatio="none"><path d="M0 0L10 20"/></symbol>'
        '<use href="#n" width="40" height="40"/>'
        '<symbol id="m" viewBox="0 0 10 20" preserveAspectRatio="xMaxYMin slice"><path d="M0 0L10 20"/></symbol>'
        '<use href="#m" width="40" height="40"/>'
    )
    meet, free, cut = framed(read, content)
    np.testing.assert_allclose(meet, [(20, 10), (40, 50)], atol=1e-12)  # scale 2, centred in 40 x 40
    np.testing.assert_allclose(free, [(0, 0), (40, 40)], atol=1e-12)
    np.testing.assert_allclose(cut, [(0, 0), (40, 80)], atol=1e-12)  # scale 4


def test_nested_svg_and_its_viewport(read: Read) -> None:
    nested = (
        '<svg x="10" y="20" width="30" height="30" viewBox="-1 -1 2 2"><path d="M-1 -1L1 1"/>'
        '<svg x="1" viewBox="0 0 1 1"><path d="M0 0L1 1"/></svg></svg>'
    )
    outer, inner = framed(read, nested)
    np.testing.assert_allclose(outer, [(10, 20), (40, 50)], atol=1e-12)
    # Inside, the viewport is 2 x 2: the inner one stands at (1, 0) of it and is as large.
    np.testing.assert_allclose(inner, [(40, 35), (70, 65)], atol=1e-12)


def test_units(read: Read) -> None:
    frame, *boxes = read(
        '<rect width="1in" height="96px"/><rect width="25.4mm" height="2.54cm"/><rect width="72pt" height="6pc"/>'
        '<rect width="101.6Q" height="96"/>'
    )
    for box in boxes:
        np.testing.assert_allclose(box.points, frame.points, atol=1e-15)


def test_root_view_box_scales_mixed_units(read: Read) -> None:
    """In a viewBox a millimetre is still 96/25.4 user units; only preserveAspectRatio="none" can distort."""
    for root in ('viewBox="0 0 10 10"', 'width="80mm" height="10mm" viewBox="0 0 10 10"', 'width="100%" height="100%"'):
        (path,) = read('<rect width="5" height="2"/>', root=root)
        assert np.ptp(path.points[:, 1]) == pytest.approx(0.04)
    root = 'width="80mm" height="20mm" viewBox="0 0 10 10" preserveAspectRatio="none"'
    (path,) = read('<rect width="5" height="2"/>', root=root)
    assert np.ptp(path.points[:, 1]) == pytest.approx(0.01)
    (path,) = read('<rect width="5" height="2"/>', root='width="80mm" viewBox="0 0 10 10" preserveAspectRatio="none"')
    assert np.ptp(path.points[:, 1]) == pytest.approx(0.04)


def test_what_is_hidden_or_only_defined_is_not_drawn(read: Read) -> None:
    line = '<path d="M0 0L9 9"/>'
    content = (
        f'<g display="none">{line}</g><g style="display: none">{line}</g><g visibility="hidden">{line}</g>'
        f"<defs>{line}</defs><clipPath>{line}</clipPath><mask>{line}</mask><symbol>{line}</symbol><marker>{line}</marker>"
        f'<pattern>{line}</pattern><g class="off">{line}</g><g id="gone">{line}</g>'
        '<g style="display:none"><image href="data:image/png;base64,AA"/><text x="3">a<tspan>b</tspan></text></g>'
        '<switch display="none"><foreignObject/></switch>'
        '<g visibility="hidden"><path id="seen" visibility="visible" d="M1 1L2 2"/></g>'
        "<style><![CDATA[ .off, #gone { display:none } path{fill:red} g > path:hover{stroke:blue} ]]></style>"
        f'<defs><symbol id="unused">{line}</symbol><g id="inner"><symbol>{line}</symbol>{line}</g></defs>'
        '<use id="u" href="#inner"/>'
    )
    assert [path.name for path in read(FRAME + content)] == ["rect 1", "seen", "u/path 15"]


def test_style_sheets_follow_the_cascade(read: Read) -> None:
    style = "<style>#three{display:none} .on{display:inline} path{display:none} /* .on{display:none} */</style>"
    paths = "".join(
        f'<path id="{name}" class="{kind}" d="M0 0L9 {k}"/>'
        for k, (name, kind) in enumerate([("one", ""), ("two", "on"), ("three", "on")])
    )
    assert [path.name for path in read(style + paths)] == ["two"]
    inline = '<path id="four" style="display:inline" d="M0 0L9 9"/>'
    assert [path.name for path in read(style + paths + inline)] == ["two", "four"]
    font = "@charset 'utf-8'; @font-face{font-family:a;src:url(https://example.org/a.woff)} #two{display:none}"
    assert [path.name for path in read(f"<style>{font}</style>{style}{paths}{inline}")] == ["four"]


def test_names_are_ids_or_order_and_never_twice_the_same(read: Read) -> None:
    line = '<path d="M0 0L9 9"/>'
    paths = read(f'{line}<path id="a" d="M0 0L9 9"/>{line}<use href="#a"/><use id="b" href="#a"/>')
    assert [path.name for path in paths] == ["path 1", "a", "path 3", "a (2)", "b/a"]


def test_foreign_elements_and_drawings_without_a_namespace(read: Read, tmp_path: Path) -> None:
    foreign = '<x:view xmlns:x="http://example.org"><path d="M0 0L99 0"/></x:view><metadata><r xmlns="urn:r" href="http://a"/></metadata>'
    assert len(read(f'{foreign}<a xlink:href="https://example.org">{FRAME}</a>')) == 1
    file = tmp_path / "plain.svg"
    file.write_text(
        '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/svg11.dtd">\n<svg><path d="M0 0L1 1"/></svg>'
    )
    assert len(read_svg(file, 0.1, 1e-5)) == 1
    file.write_bytes('<?xml version="1.0" encoding="UTF-16"?><svg><path id="é" d="M0 0L1 1"/></svg>'.encode("utf-16"))
    assert read_svg(file, 0.1, 1e-5)[0].name == "é"


# ---- refusals -----------------------------------------------------------------------------------------------------

GOOD = '<path id="good" d="M0 0L9 9"/>'
BOMB = "".join(f'<g id="b{k}">' + f'<use href="#b{k + 1}"/>' * 10 + "</g>" for k in range(12)) + '<g id="b12"/>'
REFUSALS = [
    ('<path id="x" d="M0 0L1 1 2"/>', "path 'x': path data is wrong from character 10"),
    ('<path id="x" d="L1 1"/>', "path data is wrong from character 1:"),
    ('<path d="M0 0 L 1 1 foo"/>', "path 2: path data is wrong"),
    ('<path d="M0 0C1 1 2 2"/>', "path data is wrong"),
    ('<path d="M0 0H5V"/>', "path data is wrong"),
    ('<path d="M0 0A1 1 0 2 1 5 5"/>', "path data is wrong"),
    ('<path d="M0 0L1 1,"/>', "path data is wrong"),
    ('<path d="M0 0L1,,1"/>', "path data is wrong"),
    ('<path d="M0 0L1 1Z5"/>', "path data is wrong"),
    ('<path d="M0 0R1 1"/>', "path data is wrong"),
    ('<path d="M0 0Lnan 1"/>', "path data is wrong"),
    ('<path d="M0 0L inf 1"/>', "path data is wrong"),
    ('<path d="M0 0L' + "1" * 50_000 + 'x"/>', "path data is wrong"),
    ('<path id="x" d="M0 0L1e300 1"/>', "path 'x': path data goes beyond 1e\\+07"),
    ('<path d="M0 0L1e999 1"/>', "path data goes beyond"),
    ('<path d="M0 0' + "l9e6 1" * 3 + '"/>', "lies beyond 1e\\+07"),
    ('<g transform="scale(1e6)"><path d="M0 0L100 1"/></g>', "lies beyond"),
    ('<polygon points="1 1 2"/>', "polygon 1: points are not pairs of numbers from character 5"),
    ('<polygon points=""/>', "points are not pairs"),
    ('<polygon points="1e8 1 2 2"/>', "points lie beyond"),
    ('<circle id="c" cx="1"/>', "circle 'c': without r it draws nothing"),
    ('<rect width="5"/>', "without width and height"),
    ('<rect width="-5" height="1"/>', "width must not be negative"),
    ('<rect width="50%" height="1"/>', "width has a unit that is not supported: '50%'"),
    ('<rect width="5em" height="1"/>', "unit that is not supported"),
    ('<rect width="5furlong" height="1"/>', "unit that is not supported"),
    ('<rect width="five" height="1"/>', "width is not a length"),
    ('<rect width="1e300" height="1"/>', "width is beyond"),
    (f'<g transform="scale(0)">{GOOD}</g>', "g 1: transform is singular"),
    (f'<g transform="scale(1 0)">{GOOD}</g>', "transform is singular"),
    (f'<g transform="matrix(1 2 2 4 0 0)">{GOOD}</g>', "transform is singular"),
    (f'<g transform="skewX(90)">{GOOD}</g>', "singular or too large"),
    (f'<g transform="rotate(1 2)">{GOOD}</g>', "no transform rotate with 2 numbers"),
    (f'<g transform="rotat(1)">{GOOD}</g>', "did you mean rotate"),
    (f'<g transform="translate(1,2">{GOOD}</g>', "transform is malformed from character 1"),
    (f'<g transform="translate(1px)">{GOOD}</g>', "transform is malformed"),
    (f'<g transform="scale(1e300)">{GOOD}</g>', "number beyond"),
    ("<text>hello</text>", "<text> cannot be printed"),
    ("<g><tspan>a</tspan></g>", "<tspan> cannot be printed"),
    ('<image href="#a"/>', "<image> cannot be printed"),
    ('<defs><image href="data:image/png;base64,AA"/></defs>', "<image> cannot be printed"),
    ("<flowRoot><flowPara>a</flowPara></flowRoot>", "<flowRoot> cannot be printed"),
    ("<foreignObject/>", "<foreignObject> cannot be printed"),
    ("<script>1</script>", "<script> cannot be printed"),
    ("<switch/>", "<switch> cannot be printed"),
    ("<animate/>", "<animate> cannot be printed"),
    ("<pth/>", "did you mean <path>"),
    ('<use href="other.svg#a"/>', "outside of the file"),
    ('<use xlink:href="http://example.org/a.svg#a"/>', "outside of the file"),
    ('<use href="#god"/>', "use 1: there is no element 'god'.*did you mean 'good'"),
    ('<use id="u"/>', "there is no element ''"),
    ('<use href="#d"/><g id="d"/><g id="d"/>', "the id 'd' is given 2 times"),
    ('<g id="a"><use href="#a"/></g>', "it uses itself"),
    ('<g id="a"><use href="#b"/></g><g id="b"><use href="#a"/></g>', "it uses itself"),
    ('<clipPath id="c"/><use href="#c"/>', "cannot be drawn"),
    (BOMB + '<use href="#b0"/>', "more than 100000 elements"),
    ("<g>" * 150 + "</g>" * 150, "more than 100 inside each other"),
    ('<path fill="url(http://example.org/x)" d="M0 0L1 1"/>', "outside of the file"),
    ("<path style=\"fill:url('paint.svg#a')\" d='M0 0L1 1'/>", "outside of the file"),
    ("<style>@import 'x.css';</style>", "@-rules"),
    ("<style>path{fill:url(x.svg)}</style>", "outside of the file"),
    ("<style>path{display:none</style>", "style sheet is malformed"),
    ("<style>g > path{display:none}</style>", "selector 'g > path' is not supported"),
    ("<style>path{display:none !important}</style>", "important"),
    (
        '<style>#x{transform:scale(2)}</style><path id="x" d="M0 0L1 1"/>',
        "path 'x': transform in a style is not supported",
    ),
    ('<path style="transform:scale(2)" d="M0 0L1 1"/>', "transform in a style"),
    ('<svg viewBox="0 0 1" width="1" height="1"/>', "viewBox is not four numbers"),
    ('<svg viewBox="0 0 0 1" width="1" height="1"/>', "viewBox is not four numbers"),
    ('<svg viewBox="0 0 1 1"/>', "no width and height"),
    ('<svg width="0"/>', "draws nothing"),
    ('<svg viewBox="0 0 1 1" width="1" height="1" preserveAspectRatio="middle"/>', "preserveAspectRatio is malformed"),
    ("<?xml-stylesheet href='a.css'?>", "style sheet is never opened"),
    ("<path d='M0 0L1 1'>", "not well-formed XML at column"),
    ("&lol;", "not well-formed"),
]


def test_what_uses_multiply_is_counted_before_it_is_drawn(read: Read, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Drawing, "_draw", lambda *_: pytest.fail("drawn before it was counted"))
        with pytest.raises(InputError, match="more than 100000 elements"):
            read(f'{BOMB}<use href="#b0"/>')
    monkeypatch.setattr(drawing, "MAX_ELEMENTS", 400)
    tile = '<g id="t">' + '<path d="M0 0L9 9"><title/><desc/></path>' * 30 + "</g>"
    assert len(read(tile + '<use href="#t"/>' * 10)) == 330, "what stands in a shape is not drawn"
    uses = '<g display="none">' + '<use href="#t"/>' * 50 + "</g>"
    assert len(read(f"{uses}<defs>{tile}</defs>{GOOD}")) == 1, "nor is what is hidden"
    with pytest.raises(InputError, match="more than 400 elements"):
        read(tile + '<use href="#t"/>' * 13)
    with pytest.raises(InputError, match="use 1: it uses itself"):
        read(f'<g id="a">{GOOD * 150}<use href="#a"/></g>')


@pytest.mark.parametrize(("content", "reason"), REFUSALS, ids=[f"{k}-{c[:24]}" for k, (c, _) in enumerate(REFUSALS)])
def test_refusals_name_the_line(read: Read, content: str, reason: str) -> None:
    started = time.process_time()
    with pytest.raises(InputError, match=f"(?s){reason}") as caught:
        read(f"{GOOD}\n\n{content}")
    assert str(caught.value).startswith(str(caught.value.file))
    assert time.process_time() - started < 20
    if "well-formed" not in reason:  # which the XML parser notices where the next tag does not fit
        assert caught.value.line == 4
    assert caught.value.exit_code == 2


WHOLE = [
    (b"", "not well-formed"),
    (b"\x00\x01\x02", "not well-formed"),
    (b"\x1f\x8b\x08", "compressed"),
    (b"<html/>", "root element is <html>"),
    (b"<svg xmlns='urn:other'/>", "root element"),
    (b"<svg/>", "draws nothing"),
    (b"<svg><g/></svg>", "draws nothing"),
    (b"<svg><path d='M0 0V9'/></svg>", "has no width"),
    (b"<svg><path transform='rotate(30)' d='M0 0L5 8.660254037844386'/></svg>", "has no width"),
    (b"<svg><path d='M0 0L1e-12 9'/></svg>", "has no width"),
    (b"<?xml version='1.0' encoding='nonsense'?><svg/>", "encoding"),
    (b"<svg id='\xff'/>", "not well-formed"),
    (b"<!DOCTYPE svg [<!ENTITY a 'M0 0L9 9'>]><svg><path d='&a;'/></svg>", "DOCTYPE"),
    (b"<!DOCTYPE svg [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><svg>&a;</svg>", "DOCTYPE"),
    (b"<!DOCTYPE svg [<!ATTLIST path d CDATA 'M0 0L9 9'>]><svg><path/></svg>", "DOCTYPE"),
    (b"<!DOCTYPE svg SYSTEM 'x.dtd'><svg><path d='M0 0L9 9&a;'/></svg>", "not well-formed.*undefined entity"),
]


@pytest.mark.parametrize(("content", "reason"), WHOLE, ids=range(len(WHOLE)))
def test_refusals_of_whole_files(tmp_path: Path, content: bytes, reason: str) -> None:
    file = tmp_path / "whole.svg"
    file.write_bytes(content)
    with pytest.raises(InputError, match=reason):
        read_svg(file, 0.1, 1e-5)


def test_files_that_are_not_there_or_too_large(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no file"):
        read_svg(tmp_path / "none.svg", 0.1, 1e-5)
    with pytest.raises(InputError, match="there is no file"):
        read_svg(tmp_path, 0.1, 1e-5)
    large = tmp_path / "large.svg"
    large.write_bytes(b"<svg>" + b" " * 20_000_001 + b"</svg>")
    with pytest.raises(InputError, match="larger than 20 MB"):
        read_svg(large, 0.1, 1e-5)


def test_a_drawing_to_be_wrapped_is_named_by_its_field(tmp_path: Path) -> None:
    problem = load_problem("cylinder_logo", [f"layers.source.svg={tmp_path / 'none.svg'}"])
    with pytest.raises(InputError, match=r"layers\.source\.svg: there is no file"):
        build_toolpath(problem)


def test_where_names_the_field_that_asked(tmp_path: Path) -> None:
    def where(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file="job.yaml", line=7, field="layers.source.svg", hint=hint)

    with pytest.raises(InputError, match=r"^job\.yaml:7: layers\.source\.svg: there is no file"):
        read_svg(tmp_path / "none.svg", 0.1, 1e-5, where)


@pytest.mark.parametrize(("width", "flatness"), [(0, 1e-5), (-1, 1e-5), (math.nan, 1e-5), (0.1, 0), (0.1, math.inf)])
def test_sizes_must_be_positive(width: float, flatness: float) -> None:
    with pytest.raises(InputError, match="must be positive"):
        read_svg(LOGO, width, flatness)


@pytest.mark.slow
def test_too_many_points_are_refused_before_they_are_made(read: Read) -> None:
    with pytest.raises(InputError, match="more than 1000000 points"):
        read('<circle r="1"/>', flatness=1e-15)
    steps = "l1 1" * 30_000
    uses = '<use href="#p"/>' * 200
    with pytest.raises(InputError, match="more than 1000000 points"):
        read(f'<defs><path id="p" d="M0 0{steps}"/></defs>{uses}')


# ---- random drawings ----------------------------------------------------------------------------------------------

coordinate = st.floats(0, 100).map(lambda value: round(value, 3))
point = st.tuples(coordinate, coordinate)
command = st.one_of(
    st.tuples(st.sampled_from("Ll"), st.tuples(point)),
    st.tuples(st.sampled_from("Cc"), st.tuples(point, point, point)),
    st.tuples(st.sampled_from("QqSs"), st.tuples(point, point)),
    st.tuples(st.sampled_from("Tt"), st.tuples(point)),
    st.tuples(
        st.sampled_from("Aa"),
        st.tuples(
            st.tuples(
                st.floats(1, 90).map(lambda v: round(v, 2)),
                st.floats(1, 90).map(lambda v: round(v, 2)),
                st.integers(0, 90),
                st.integers(0, 1),
                st.integers(0, 1),
            ),
            point,
        ),
    ),
    st.tuples(st.sampled_from("HhVv"), st.tuples(st.tuples(coordinate))),
)


def evaluated(start: tuple[float, float], commands: list[tuple[str, tuple[tuple[float, ...], ...]]]) -> Array:
    """Dense points of path data, from the text of the standard and not from the reader."""
    here, last, kind = np.array(start), np.array(start), "M"
    rows = [here[None]]
    for letter, groups in commands:
        upper, origin = letter.upper(), here if letter.islower() else np.zeros(2)
        if upper in "HV":
            axis = "HV".index(upper)
            end = here.copy()
            end[axis] = groups[0][0] + origin[axis]
            rows.append(bezier(tuple(here), tuple(end), n=200))
        elif upper == "A":
            end = np.array(groups[1]) + origin
            if (end != here).any():
                rx, ry, turn, large, sweep = groups[0]
                rows.append(arc(complex(*here), rx, ry, turn, int(large), int(sweep), complex(*end), n=2000))
        else:
            controls = [np.array(group) + origin for group in groups]
            if upper in "ST":
                controls.insert(0, 2 * here - last if kind in {"S": "CS", "T": "QT"}[upper] else here)
            end = controls[-1]
            last = controls[-2] if len(controls) > 1 else here
            rows.append(bezier(tuple(here), *map(tuple, controls), n=2000))
        here, kind = end, upper
    return np.vstack(rows)


@pytest.mark.slow
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(start=point, commands=st.lists(command, min_size=1, max_size=5), flatness=st.sampled_from([3e-5, 1e-3]))
def test_random_paths_stay_within_the_flatness(
    read: Read, start: tuple[float, float], commands: list, flatness: float
) -> None:
    dense = evaluated(start, commands)
    if np.ptp(dense[:, 0]) < 1 or np.abs(dense).max() > 1e4:
        return
    data = f"M{start[0]} {start[1]}" + "".join(
        letter + " ".join(f"{v:g}" for g in groups for v in g) for letter, groups in commands
    )
    (path,) = read(f'<path d="{data}"/>', flatness=flatness)
    assert np.isfinite(path.points).all() and (np.hypot(*np.diff(path.points, axis=0).T) > 0).all()
    low, high = dense.min(axis=0), dense.max(axis=0)
    scale = 0.1 / (high[0] - low[0])
    expected = (dense - (low + high) / 2) * [scale, -scale]
    slack = 2e-6 * (1 + float(np.ptp(expected[:, 1])))  # the dense points' own bounding box is not exact
    assert distance_to_chords(expected, path.points) <= flatness + slack
    assert np.abs(path.points[0] - expected[0]).max() < slack


@pytest.mark.slow
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(st.text(alphabet="MmLlHhVvCcSsQqTtAaZz0123456789+-.,eE \n", max_size=40), st.text(max_size=20)),
    st.sampled_from(["d", "points", "transform", "style", "viewBox", "href", "width", "id"]),
)
def test_garbage_in_attributes_raises_only_input_errors(read: Read, text: str, name: str) -> None:
    escaped = "".join(f"&#{ord(c)};" for c in text)
    tag = {"d": "path", "points": "polygon", "viewBox": "svg", "href": "use"}.get(name, "rect")
    try:
        paths = read(f'<path d="M0 0L9 9"/><{tag} {name}="{escaped}"/>')
    except InputError:
        return
    assert all(np.isfinite(path.points).all() and len(path.points) > 1 for path in paths)


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(
        st.binary(max_size=60),
        st.tuples(st.integers(0, 5000), st.binary(max_size=6)).map(
            lambda cut: LOGO.read_bytes()[: cut[0]] + cut[1] + LOGO.read_bytes()[cut[0] + 3 :]
        ),
    )
)
def test_garbage_files_raise_only_input_errors(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "garbage.svg"
    file.write_bytes(data)
    try:
        paths = read_svg(file, 0.078, 1e-4)
    except InputError:
        return
    assert all(np.isfinite(path.points).all() for path in paths)


# ---- drawings that ship -------------------------------------------------------------------------------------------


def dense_points(path: PlanePath, step: float = 5e-5) -> tuple[Array, Array]:
    """Points along a path every `step`, and their arc lengths."""
    s = np.concatenate([[0], np.hypot(*np.diff(path.points, axis=0).T).cumsum()])
    along = np.arange(0, s[-1], step)
    return np.column_stack([np.interp(along, s, path.points[:, k]) for k in (0, 1)]), along


def turns(path: PlanePath) -> Array:
    """Angles of turning at the vertices, in degrees."""
    step = np.diff(path.points, axis=0)
    if path.closed:
        step = np.vstack([step, step[:1]])
    heading = step[:, 0] + 1j * step[:, 1]
    return np.abs(np.degrees(np.angle(heading[1:] / heading[:-1])))


def test_the_committed_logo_is_what_the_script_draws() -> None:
    spec = importlib.util.spec_from_file_location("draw_logo", ROOT / "problems/draw_logo.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.drawing() == LOGO.read_text(encoding="utf-8")
    assert module.TARGET == LOGO


@pytest.mark.slow
def test_the_logo_is_printable() -> None:
    """Size, length, corners; lines at least 1 mm apart, also from themselves."""
    paths = read_svg(LOGO, 0.078, 1e-5)
    assert len(paths) >= 12 and len({path.name for path in paths}) == len(paths)
    size = np.ptp(np.vstack([path.points for path in paths]), axis=0)
    assert size[0] == pytest.approx(0.078, abs=1e-9) and size[1] <= 0.085
    lengths = [length(path.points) for path in paths]
    assert 1.3 <= sum(lengths) <= 1.6 and min(lengths) >= 0.004 and max(lengths) <= 0.3
    assert max(turns(path).max() for path in paths) < 150
    assert 0.4 <= np.mean([turns(path).max() > 30 for path in paths]) <= 0.6
    clouds = [dense_points(path) for path in paths]
    for i, (cloud, along) in enumerate(clouds):
        tree = cKDTree(cloud)
        for other, _ in clouds[i + 1 :]:
            assert tree.query(other)[0].min() > 1e-3
        pairs = tree.query_pairs(1e-3, output_type="ndarray")
        gap = np.abs(along[pairs[:, 0]] - along[pairs[:, 1]])
        gap = np.minimum(gap, lengths[i] - gap) if paths[i].closed else gap
        assert gap.max() < 3.5e-3, paths[i].name  # near in the plane means near along the path


@pytest.mark.skipif(not BRISTOL.exists(), reason="the published drawing is not at hand")
def test_the_published_logo() -> None:
    """15 closed outlines; 1.486 m at its natural size, where the geometry is 2.6024 … 299.7599 px wide."""
    natural = (299.7599351 - 2.6024329) * 25.4e-3 / 96
    paths = read_svg(BRISTOL, natural, 1e-5)
    assert len(paths) == 15 and all(path.closed for path in paths)
    assert sum(length(path.points) for path in paths) == pytest.approx(1.4865, abs=2e-4)
    smaller = read_svg(BRISTOL, natural / 2, 1e-5)
    assert sum(length(path.points) for path in smaller) == pytest.approx(1.4865 / 2, abs=2e-4)
