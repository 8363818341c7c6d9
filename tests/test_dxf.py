"""Drawings in DXF files: lengths and places of what is drawn, units, layers, blocks, chains, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import pytest
from ezdxf.document import Drawing
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from planner.base.errors import InputError
from planner.planning.solve_command import main
from planner.problem import load_problem
from planner.problem.drawings import DxfSpec
from planner.toolpath import twins
from planner.toolpath.build import build_toolpath
from planner.toolpath.dxf.chains import DrawnLine, joined
from planner.toolpath.dxf.reader import INSUNITS, DxfRead, read_drawing, read_dxf
from planner.toolpath.svg.outlines import PlanePath
from planner.toolpath.twins import without_twins
from planner.verify.reread.plane_curves import _INSUNITS, read_again

FLAT = 1e-6  # m
MM = 4  # $INSUNITS
POINT = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


def drawn(draw: Callable[[Any], object], units: int = MM) -> Drawing:
    document = ezdxf.new(units=units)
    draw(document.modelspace())
    return document


def saved(folder: Path, draw: Callable[[Any], object], units: int = MM) -> Path:
    path = folder / "drawing.dxf"
    drawn(draw, units).saveas(path)
    return path


def complain(reason: str, hint: str | None = None) -> InputError:
    return InputError(reason, hint=hint)


def read(path: Path, **more: object) -> DxfRead:
    given = {"dxf": path, "unit": None, "width": None, "layers": None, "join": 1e-5, "crumbs": 0.01}
    return read_dxf(DxfSpec.model_construct(**{**given, **more}), FLAT, complain)


def size(path: PlanePath) -> float:
    """Length of a path [mm]."""
    return 1e3 * float(np.hypot(*np.diff(path.points, axis=0).T).sum())


def sizes(found: DxfRead) -> list[float]:
    return [size(path) for path in found.paths]


def test_hidden_entities_are_read_neither_once_nor_again(tmp_path: Path) -> None:
    def draw(m: Any) -> None:
        m.add_line((0, 0), (9, 9))
        m.add_line((0, 5), (40, 5), dxfattribs={"invisible": 1})

    path = saved(tmp_path, draw)
    assert sizes(read(path)) == pytest.approx([math.hypot(9, 9)])
    (again,) = read_again(DxfSpec.model_construct(dxf=path, unit=None, width=None, layers=None))
    assert again * 1e3 == pytest.approx(np.array([[-4.5, -4.5], [4.5, 4.5]]))


@settings(max_examples=6, deadline=None)
@given(radius=st.floats(0.5, 200), start=st.floats(0, 359), sweep=st.floats(5, 350))
def test_arcs_are_as_long_as_they_are(tmp_path_factory: Any, radius: float, start: float, sweep: float) -> None:
    folder = tmp_path_factory.mktemp("arc")
    path = saved(folder, lambda m: m.add_arc((7, -3), radius, start, start + sweep))
    if radius > 1.0 and radius * math.radians(sweep) > 1.0:
        assert sizes(read(path)) == pytest.approx([radius * math.radians(sweep)], rel=1e-3)


@settings(max_examples=6, deadline=None)
@given(bulge=st.floats(-3, 3), x=st.floats(1, 90))
def test_bulges_are_arcs(tmp_path_factory: Any, bulge: float, x: float) -> None:
    path = saved(
        tmp_path_factory.mktemp("b"), lambda m: m.add_lwpolyline([(0, 0, bulge), (x, 0, 0), (x, 9, 0)], format="xyb")
    )
    angle = 4.0 * math.atan(abs(bulge))
    arc = x if angle < 1e-6 else x / (2.0 * math.sin(angle / 2.0)) * angle
    found = read(path)
    assert sizes(found) == pytest.approx([arc + 9.0], rel=1e-3)
    ends = found.paths[0].points[[0, -1]] * 1e3
    assert ends[1] - ends[0] == pytest.approx([x, 9.0], abs=1e-6)  # in the polyline's own direction
    off = np.diff(found.paths[0].points[:3], axis=0)
    if abs(bulge) > 0.05:
        cross = off[0, 0] * off[1, 1] - off[0, 1] * off[1, 0]
        assert (cross > 0.0) == (bulge > 0.0)


@settings(max_examples=6, deadline=None)
@given(points=st.lists(POINT, min_size=3, max_size=8, unique=True), closed=st.booleans())
def test_polylines_keep_their_vertices(tmp_path_factory: Any, points: list[tuple[float, float]], closed: bool) -> None:
    corners = np.round(np.array(points), 1)
    ring = np.vstack([corners, corners[:1]]) if closed else corners
    steps = np.hypot(*np.diff(ring, axis=0).T)
    if (
        steps.min() < 0.1
        or np.ptp(corners, axis=0).max() < 1.0
        or (not closed and np.ptp(ring[[0, -1]], axis=0).max() < 0.1)
    ):
        return
    path = saved(tmp_path_factory.mktemp("p"), lambda m: m.add_lwpolyline(corners.tolist(), close=closed))
    found = read(path)
    assert sizes(found) == pytest.approx([steps.sum()], rel=1e-9)
    assert found.paths[0].closed == closed


@pytest.mark.parametrize("kind", ["add_polyline2d", "add_polyline3d"])
def test_frames_of_polylines_that_are_splines_are_not_printed(tmp_path: Path, kind: str) -> None:
    def draw(m: Any) -> None:
        line = getattr(m, kind)([(0, 0), (0, 0), (50, 80), (30, 20), (60, 0), (60, 0)])
        line.dxf.flags |= 4
        for k, vertex in enumerate(line.vertices):
            vertex.dxf.flags |= 16 if k in (0, 2, 5) else 8

    path = saved(tmp_path, draw)
    assert sizes(read(path)) == pytest.approx([2.0 * math.hypot(30, 20)])
    (again,) = read_again(DxfSpec.model_construct(dxf=path, unit=None, width=None, layers=None))
    assert np.ptp(again, axis=0) * 1e3 == pytest.approx([60.0, 20.0])


def test_circles_ellipses_and_splines(tmp_path: Path) -> None:
    control = [(0, 0), (10, 30), (30, -20), (40, 10), (60, 0)]

    def draw(m: Any) -> None:
        m.add_circle((0, 0), 10)
        m.add_ellipse((0, 50), (20, 0), 0.4)
        m.add_open_spline(control)

    circle, ellipse, spline = read(saved(tmp_path, draw)).paths
    t = np.linspace(0.0, 2.0 * np.pi, 20001)
    exact = np.hypot(*np.diff(np.stack([20 * np.cos(t), 8 * np.sin(t)]), axis=1)).sum()
    assert circle.closed and ellipse.closed and not spline.closed
    assert [size(circle), size(ellipse)] == pytest.approx([20.0 * np.pi, exact], rel=1e-3)
    curve = ezdxf.math.BSpline(control)
    places = np.array([(p.x, p.y) for p in curve.points(np.linspace(0.0, curve.max_t, 20001))])
    assert size(spline) == pytest.approx(np.hypot(*np.diff(places, axis=0).T).sum(), rel=1e-3)


@pytest.mark.parametrize("weights", [None, (1.0, 3.0, 1.0, 0.5)])
def test_closed_splines_end_where_they_begin(tmp_path: Path, weights: tuple[float, ...] | None) -> None:
    """They are not clamped: their knots go on beyond both ends of their domain."""
    corners = [(0, 0, 0), (40, 0, 0), (40, 30, 0), (0, 30, 0)]

    def draw(m: Any) -> None:
        if weights is None:
            m.add_spline().set_closed(corners)
        else:
            m.add_spline().set_closed_rational(corners, weights)

    path = saved(tmp_path, draw)
    (spline,) = read(path).paths
    share = np.array(weights or (1, 1, 1, 1), dtype=float)[:, None]
    control = np.hstack([share * np.array(corners)[:, :2], share])[[0, 1, 2, 3, 0, 1, 2]]
    x, y, w = BSpline(np.arange(11.0), control, 3)(np.linspace(3.0, 7.0, 20001)).T
    exact = np.column_stack([x / w, y / w])
    assert spline.closed
    assert size(spline) == pytest.approx(np.hypot(*np.diff(exact, axis=0).T).sum(), rel=1e-3)
    assert np.ptp(spline.points, axis=0) * 1e3 == pytest.approx(np.ptp(exact, axis=0), abs=0.01)
    (again,) = read_again(DxfSpec.model_construct(dxf=path, unit=None, width=None, layers=None))
    assert np.ptp(again, axis=0) * 1e3 == pytest.approx(np.ptp(exact, axis=0), abs=0.01)


@pytest.mark.parametrize("unit", [1, 4, 5, 6, 21])
def test_units_of_the_header_and_of_the_key(unit: int, tmp_path: Path) -> None:
    path = saved(tmp_path, lambda m: m.add_line((0, 0), (3, 4)), unit)
    assert sizes(read(path)) == pytest.approx([5.0 * INSUNITS[unit]])
    assert sizes(read(path, unit="cm")) == pytest.approx([50.0])
    assert sizes(read(path, width=0.03)) == pytest.approx([50.0])
    assert not read(path).notes


def test_units_are_those_that_are_read_again() -> None:
    assert pytest.approx(INSUNITS) == _INSUNITS


def test_a_drawing_without_a_unit_is_told(tmp_path: Path) -> None:
    found = read(saved(tmp_path, lambda m: m.add_line((0, 0), (3, 4)), 0))
    assert sizes(found) == pytest.approx([5.0]) and "names no unit" in found.notes[0]


def test_loose_lines_become_chains(tmp_path: Path) -> None:
    def draw(m: Any) -> None:
        m.add_line((0, 0), (20, 0))
        m.add_line((20, 20), (20, 0.004))  # backwards, and not quite there
        m.add_arc((10, 20), 10, 0, 180)
        m.add_line((0, 20), (0, 0))
        m.add_line((20, 0), (0, 0))  # drawn twice
        m.add_line((40, 0), (60, 0))

    path = saved(tmp_path, draw)
    found = read(path)
    assert sizes(found) == pytest.approx([60.0 + 10.0 * np.pi, 20.0], rel=1e-3)
    assert [each.closed for each in found.paths] == [True, False]
    assert any("5 lines joined into 2" in note for note in found.notes)
    assert any("1 line drawn twice" in note for note in found.notes)
    assert len(read(path, join=1e-6).paths) == 2 and not read(path, join=1e-6).paths[0].closed


@pytest.mark.parametrize("close", [True, False])
def test_a_polyline_over_loose_lines_is_printed_once(tmp_path: Path, close: bool) -> None:
    """A closed one with lines that begin at another corner, and an open one, whose ends are those of the lines."""
    corners = [(0, 0), (20, 0), (20, 9), (0, 9)]
    sides = list(zip(corners, corners[1:] + corners[:1], strict=True))[: 4 if close else 3]

    def draw(m: Any) -> None:
        m.add_lwpolyline(corners, close=close)
        for start, end in sides[1:] + sides[:1]:
            m.add_line(end, start)

    found = read(saved(tmp_path, draw))
    assert sizes(found) == pytest.approx([58.0 if close else 49.0]) and found.paths[0].closed == close
    assert any("1 line drawn twice" in note for note in found.notes)


def test_rows_side_by_side_are_joined_all_the_same() -> None:
    rows = [DrawnLine(str(k), "0", np.array([[0.0, y], [9.0, y]]), False) for k, y in enumerate((0.0, 1.0))]
    assert len(joined(rows, 1.5)) == 1


@settings(max_examples=6, deadline=None)
@given(st.data())
def test_a_chain_in_any_order_and_sense_is_one(data: st.DataObject) -> None:
    count = data.draw(st.integers(3, 12))
    corners = np.column_stack(
        [np.arange(count) * 3.0, data.draw(st.lists(st.floats(-9, 9), min_size=count, max_size=count))]
    )
    ring = data.draw(st.booleans())
    corners = np.vstack([corners, corners[:1]]) if ring else corners
    pieces = [corners[i : i + 2][:: data.draw(st.sampled_from([1, -1]))] for i in range(len(corners) - 1)]
    lines = [DrawnLine(f"line {i}", "0", points, False) for i, points in enumerate(data.draw(st.permutations(pieces)))]
    chains = joined(lines, 1e-6)
    assert len(chains) == 1 and chains[0].closed == ring
    total = np.hypot(*np.diff(corners, axis=0).T).sum()
    assert np.hypot(*np.diff(chains[0].points, axis=0).T).sum() == pytest.approx(total)
    assert without_twins([*lines, lines[0]], 1e-6)[1] == 1


def test_closed_twins_may_begin_anywhere() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    begun = [np.roll(ring[:-1], k, axis=0)[::way] for k, way in ((0, 1), (7, 1), (20, -1))]
    rings = [DrawnLine("ring", "0", each, True) for each in begun]
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    diamond = np.sqrt(2.0) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    assert without_twins(rings, 1e-6)[1] == 2
    assert without_twins([DrawnLine("", "0", each, True) for each in (square, diamond)], 1e-6)[1] == 0


def test_only_lines_of_one_place_are_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a screen of equal dots each is compared with none."""
    monkeypatch.setattr(twins, "_alike", lambda *_: pytest.fail("compared"))
    dots = [DrawnLine("", "0", np.array([[x, 0.0], [x + 0.5, 0.0]]), False) for x in range(9)]
    assert without_twins(dots, 1e-6) == (dots, 0)


def test_twins_may_differ_in_length() -> None:
    one, other = (DrawnLine("line", "0", np.array([[0.0, 0.0], [x, 0.0]]), False) for x in (5.9e-6, 6.1e-6))
    assert without_twins([one, other], 1e-6)[1] == 1
    assert without_twins([one, DrawnLine("line", "0", np.array([[0.0, 0.0], [9.0e-6, 0.0]]), False)], 1e-6)[1] == 0


@pytest.mark.parametrize("diamonds", [2, 4, 6, 8])
def test_zigzags_that_meet_at_every_other_corner_are_no_twins(diamonds: int) -> None:
    zigzag = np.column_stack([np.arange(2.0 * diamonds + 1.0), np.arange(2 * diamonds + 1) % 2])
    one, other = (DrawnLine("line", "0", zigzag * [1.0, side], False) for side in (1.0, -1.0))
    assert without_twins([one, other], 1e-6)[1] == 0


def test_crossing_lines_go_straight_on() -> None:
    arms = [np.array([[0.0, 0.0], way]) for way in ([1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0])]
    chains = joined([DrawnLine(str(i), "0", arm, False) for i, arm in enumerate(arms)], 1e-6)
    assert len(chains) == 2
    for chain in chains:
        assert np.ptp(chain.points, axis=0).min() == 0.0


def test_layers_are_chosen_and_those_that_are_off_are_told(tmp_path: Path) -> None:
    document = ezdxf.new(units=MM)
    document.layers.add("Ribs")
    document.layers.add("aids").off()
    model = document.modelspace()
    for length, layer in ((10, "0"), (20, "Ribs"), (30, "aids")):
        model.add_line((0, length), (length, length), {"layer": layer})
    path = tmp_path / "layers.dxf"
    document.saveas(path)
    found = read(path)
    assert sizes(found) == pytest.approx([10.0, 20.0]) and "1 aids" in found.notes[0]
    found = read(path, layers=("ribs",))
    assert sizes(found) == pytest.approx([20.0]) and "other layers" in found.notes[0]
    with pytest.raises(InputError, match="no layer 'rips'") as error:
        read(path, layers=("rips",))
    assert "Ribs" in str(error.value.hint)


def test_blocks_are_placed_turned_and_scaled(tmp_path: Path) -> None:
    document = ezdxf.new(units=MM)
    block = document.blocks.new("PART")
    block.add_circle((0, 0), 1)
    block.add_line((2, 0), (5, 0))
    outer = document.blocks.new("PAIR")
    outer.add_blockref("PART", (0, 0), {"layer": "0"})
    document.modelspace().add_blockref("PAIR", (100, 0), {"xscale": 2, "yscale": 2, "rotation": 90, "layer": "cut"})
    path = tmp_path / "blocks.dxf"
    document.saveas(path)
    found = read(path, layers=("cut",))
    assert sizes(found) == pytest.approx([4.0 * np.pi, 6.0], rel=1e-3)
    assert np.ptp(found.paths[1].points[:, 0]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("unseen", [{"invisible": 1}, {"layer": "Aids"}])
def test_blocks_whose_reference_is_not_seen_are_not_printed(
    tmp_path: Path, unseen: dict[str, object], nested: bool
) -> None:
    document = ezdxf.new(units=MM)
    document.layers.add("aids").freeze()
    document.blocks.new("PART").add_line((0, 5), (40, 5), {"layer": "ribs"})
    model = document.modelspace()
    model.add_line((0, 0), (9, 9))
    if nested:
        model.add_blockref("PAIR", (0, 0))
    (document.blocks.new("PAIR") if nested else model).add_blockref("PART", (0, 0), unseen)
    path = tmp_path / "blocks.dxf"
    document.saveas(path)
    found = read(path)
    assert sizes(found) == pytest.approx([math.hypot(9, 9)]) and "hidden, or on layers that are off" in found.notes[0]
    (again,) = read_again(DxfSpec.model_construct(dxf=path, unit=None, width=None, layers=None))
    assert np.ptp(again, axis=0) * 1e3 == pytest.approx([9.0, 9.0])
    if "layer" in unseen:
        assert sizes(read(path, layers=("ribs",))) == pytest.approx([40.0])


def test_what_is_no_line_and_what_is_not_level_is_told(tmp_path: Path) -> None:
    def draw(m: Any) -> None:
        m.add_line((0, 0, 0), (30, 0, 4))
        m.add_line((0, 9, 0), (0, 9, 5))
        m.add_text("words")
        m.add_hatch()
        m.add_point((3, 3))

    found = read(saved(tmp_path, draw))
    assert sizes(found) == pytest.approx([30.0])
    notes = " ".join(found.notes)
    for words in ("1 TEXT", "1 HATCH", "1 POINT", "up to 5.000 mm off", "left out: 1 line"):
        assert words in notes


def test_beads_on_a_plane_and_round_a_cylinder(tmp_path: Path) -> None:
    path = saved(tmp_path, lambda m: (m.add_circle((0, 0), 15), m.add_line((0, 3), (0.2, 3)), m.add_text("x")))
    source = f"layers.source={{dxf: '{path}', leave_out_share: 0.05}}"
    around = build_toolpath(load_problem("cylinder_logo", (source, "layers.count=1")))
    assert len(around.beads) == 1 and around.length == pytest.approx(30e-3 * np.pi, rel=0.02)
    assert len(around.left_out) == 1 and any("1 TEXT" in note for note in around.notes)
    changes = (
        "part={plane: {size_mm: [1000, 1000]}}",
        f"layers={{source: {{dxf: '{path}', leave_out_share: 0.05}}, project: z, count: 1, height_mm: 0.5}}",
    )
    level = build_toolpath(load_problem("cylinder_logo", changes))
    assert level.length == pytest.approx(30e-3 * np.pi, rel=0.02)
    assert any("1 TEXT" in note for note in level.notes) and any("left out" in note for note in level.notes)


def test_binary_files_are_read(tmp_path: Path) -> None:
    drawn(lambda m: m.add_circle((0, 0), 10)).saveas(tmp_path / "b.dxf", fmt="bin")
    assert sizes(read(tmp_path / "b.dxf")) == pytest.approx([20.0 * np.pi], rel=1e-3)


def test_wrong_files_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = saved(tmp_path, lambda m: m.add_circle((0, 0), 10)).read_bytes()
    drawn(lambda m: m.add_text("x")).saveas(tmp_path / "text.dxf")
    drawn(lambda m: m.add_line((0, 0), (0.001, 0))).saveas(tmp_path / "tiny.dxf")
    drawn(lambda m: m.add_line((0, 0), (9e9, 0))).saveas(tmp_path / "vast.dxf")
    drawn(lambda m: m.add_circle((0, 0), 10)).saveas(tmp_path / "binary.dxf", fmt="bin")
    cases = {
        "empty.dxf": (b"", "is not a DXF file"),
        "mesh.dxf": (b"solid x\nendsolid x\n", "is not a DXF file"),
        "drawing.dwg": (b"AC1032\0\0\0", "is a DWG file"),
        "short.dxf": (good[: len(good) - 300], "EOF"),
        "half.dxf": (good[: len(good) // 2], "is damaged"),
        "binary.dxf": ((tmp_path / "binary.dxf").read_bytes()[:2000], "is damaged"),
        "text.dxf": (None, "1 TEXT"),
        "tiny.dxf": (None, "layers.source.unit"),
        "vast.dxf": (None, "layers.source.unit"),
        "missing.dxf": (None, "there is no file"),
    }
    for name, (data, reason) in cases.items():
        if data is not None:
            (tmp_path / name).write_bytes(data)
        given = ["--set", f"layers.source={{dxf: '{tmp_path / name}'}}", "--out", str(tmp_path / "out")]
        assert main(["cylinder_logo", *given]) == 2, name
        message = " ".join(capsys.readouterr().err.split())
        assert reason in message and name in message and "Traceback" not in message, message


@settings(max_examples=6, deadline=None)
@given(st.data())
def test_damaged_files_never_end_in_a_traceback(tmp_path_factory: Any, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("d")
    text = saved(folder, lambda m: m.add_lwpolyline([(0, 0, 1), (9, 0, 0), (9, 9, 0)], format="xyb")).read_text()
    lines = text.splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        k = data.draw(st.integers(0, len(lines) - 1))
        lines[k : k + data.draw(st.integers(0, 3))] = data.draw(
            st.sampled_from([[], ["nan"], ["-7"], ["ENTITIES"], ["1e400"], ["SEQ\x16\x00\x00END"]])
        )
    path = folder / "bad.dxf"
    path.write_text("\n".join(lines) + "\n")
    try:
        read_drawing(path, complain)
        assert read(path).paths
    except InputError as error:
        assert "bad.dxf" in str(error) and str(error).isprintable()
