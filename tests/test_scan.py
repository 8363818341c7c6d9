"""A scanned print: clouds of points, the height map that they give, beads laid on it, and how that is verified."""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.scan import Truth, scanned
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED, InputError
from planner.cell.cell import build_cell
from planner.feedback.height_map import HeightMap, PlannedTop, height_map, planned_top
from planner.feedback.learn_telling import write_problem as write_taught
from planner.feedback.scan_command import ScannedPlan, in_part_frame, main, scanned_plan
from planner.feedback.scan_fit import fit_cloud
from planner.feedback.scan_telling import (
    bound_of,
    drawn_name,
    layer_heights,
    layer_widths,
    lines_of,
    remains,
    table_of,
    write_map,
    write_problem,
)
from planner.motion.extrusion import cross_section
from planner.plan import Check, Plan
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.problem.clouds import FEWEST, read_cloud
from planner.register.fitting import FREEDOMS
from planner.toolpath.as_printed import COLUMNS, DeviationField, beads_up_to, left, made_up, read_map
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath
from planner.toolpath.plane_paths import make_bead
from planner.verify.as_printed import _over_print
from planner.verify.scanned import ScannedTop, deviations, scanned_top, still_off
from planner.verify.verdict import verify

PRINT = ("layers.count=4", "layers.source.size_mm=[30, 30]")  # of the honeycomb on a dome
SCANNED = 2  # its layer
QUICK = ("resolve.roll_step_deg=30", "resolve.rung_mm=10", "strategy=ladder")
RADIUS = 3e-3
WRONG = partial(InputError, file="cloud")


@cache
def drawn() -> tuple[Problem, Toolpath]:
    problem = load_problem("hemisphere_honeycomb", (*PRINT, *QUICK))
    return problem, build_toolpath(problem)


@cache
def flat() -> Toolpath:
    return build_toolpath(load_problem("planar_gcode"))


@cache
def cloud() -> Array:
    return scanned(drawn()[1], SCANNED)


@cache
def mapped() -> HeightMap:
    return height_map(planned_top(drawn()[1], SCANNED), cloud(), RADIUS, WRONG)


def corrected(folder: Path, most: float | None = None) -> Problem:
    """The problem of what is left of the print, with its map beside it."""
    problem, toolpath = drawn()
    write_map(mapped(), folder / "height_map.csv")
    most = bound_of(toolpath, SCANNED, 0.3) if most is None else most
    target = folder / "rest.yaml"
    target.write_text(write_problem(problem, mapped(), SCANNED, most, folder), encoding="utf-8")
    return load_problem(target, problem.sources.overrides)


@cache
def solved() -> Plan:
    with tempfile.TemporaryDirectory() as folder:
        return solve(corrected(Path(folder)), baseline=False)


def failed(checks: tuple[Check, ...]) -> set[str]:
    return {check.name for check in checks if not check.ok}


# ----------------------------------------------------------------------------------------------------
# Files of clouds.


def points(count: int = 300) -> Array:
    return np.round(np.random.default_rng(1).uniform(-50.0, 50.0, (count, 3)), 4)


def ply(path: Path, x: Array, binary: bool) -> None:
    kind = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {kind} 1.0\nelement vertex {len(x)}\nproperty double x\nproperty double y\nproperty double z\n"
    with path.open("wb") as stream:
        stream.write(f"{head}end_header\n".encode())
        if binary:
            stream.write(x.astype("<f8").tobytes())
        else:
            stream.write("".join(f"{a} {b} {c}\n" for a, b, c in x).encode())


WRITERS: dict[str, Callable[[Path, Array], object]] = {
    "a.xyz": lambda path, x: np.savetxt(path, x),
    "commented.txt": lambda path, x: np.savetxt(path, np.hstack([x, x]), header="scan of today"),
    "counted.pts": lambda path, x: np.savetxt(path, x, header=str(len(x)), comments=""),
    "header.csv": lambda path, x: np.savetxt(
        path,
        np.column_stack([x[:, 2], x[:, 0], np.ones(len(x)), x[:, 1]]),
        delimiter=",",
        header="z,x,i,y",
        comments="",
    ),
    "semicolons.csv": lambda path, x: np.savetxt(path, x, delimiter=";", header="x_mm;y_mm;z_mm", comments=""),
    "one.npy": lambda path, x: np.save(path, x),
    "columns.npz": lambda path, x: np.savez(path, x=x[:, 0], y=x[:, 1], z=x[:, 2]),
    "points.npz": lambda path, x: np.savez(path, other=np.ones(3), points=x),
    "ascii.ply": lambda path, x: ply(path, x, False),
    "binary.ply": lambda path, x: ply(path, x, True),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_cloud_is_read(name: str, tmp_path: Path) -> None:
    x = points()
    WRITERS[name](tmp_path / name, x)
    assert np.allclose(read_cloud(tmp_path / name), x * 1e-3, atol=1e-12)
    if name != "semicolons.csv":
        assert np.allclose(read_cloud(tmp_path / name, "m"), x, atol=1e-9)


def test_a_header_tells_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "metres.csv"
    np.savetxt(path, points(), delimiter=",", header="x_m, y_m, z_m", comments="")
    assert np.allclose(read_cloud(path), points())
    with pytest.raises(InputError, match="its header says m, but --unit says mm"):
        read_cloud(path, "mm")


@given(
    st.sampled_from([" ", ",", ";", "\t", ", "]),
    st.sampled_from(["", "x,y,z", "# made by hand"]),
    st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 3), min_size=1, max_size=5),
)
@settings(max_examples=30, deadline=None)
def test_whatever_stands_between_numbers(mark: str, head: str, rows: list[tuple[float, float, float]]) -> None:
    lines = [head.replace(",", mark)] if head else []
    rows = rows * FEWEST
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.txt"
        path.write_text("\n".join([*lines, *(mark.join(repr(v) for v in row) for row in rows)]), encoding="utf-8")
        assert np.array_equal(read_cloud(path, "m"), np.array(rows))


def with_nan() -> Array:
    x = points()
    x[7, 1] = np.nan
    return x


@pytest.mark.parametrize(
    ("name", "write", "said"),
    [
        ("cloud.stl", lambda path: path.write_text("solid"), "not the ending of a point cloud"),
        (
            "cloud.xyz",
            lambda path: np.savetxt(path, with_nan()),
            "1 of its 300 points are not finite, or too far away; the first is number 7",
        ),
        ("cloud.npy", lambda path: np.save(path, points(30)), "holds 30 points"),
        ("cloud.npy", lambda path: np.save(path, np.ones((300, 2))), r"shape \(300, 2\)"),
        ("cloud.npy", lambda path: path.write_bytes(b"no array"), "not a NumPy file"),
        ("cloud.npz", lambda path: np.savez(path, points=np.array([["a"] * 3] * 300)), "not a NumPy file"),
        ("cloud.npz", lambda path: np.savez(path), "not a NumPy file"),
        ("cloud.csv", lambda path: path.write_text("\nx_m,y,z\n" + "1,2,3\n" * 300), "cloud.csv:2: .*different units"),
        ("cloud.ply", lambda path: path.write_text("plywood"), "not a readable PLY file"),
        (
            "cloud.xyz",
            lambda path: path.write_text("1 2 3\n4 5\n" * 200),
            "cloud.xyz:2: does not hold three numbers: '4 5'",
        ),
        (
            "cloud.csv",
            lambda path: path.write_text("x,y,z\n1,2,3\n1,two,3\n" * 100),
            "cloud.csv:3: does not hold three numbers",
        ),
        ("cloud.txt", lambda path: path.write_text("# nothing\n\n"), "holds no points"),
        ("cloud.txt", lambda path: path.write_bytes(b"\xff\xfe\x00"), "not UTF-8"),
        ("cloud.txt", lambda path: None, "there is no file"),
        ("cloud.ply", lambda path: None, "there is no file"),
        ("cloud.npy", lambda path: None, "there is no file"),
    ],
)
def test_what_is_no_cloud_is_refused(name: str, write: Callable[[Path], object], said: str, tmp_path: Path) -> None:
    write(tmp_path / name)
    with pytest.raises(InputError, match=said):
        read_cloud(tmp_path / name)


def test_frames() -> None:
    bed = build_cell(load_problem("hemisphere_honeycomb"))
    x = points() * 1e-3
    world = x + np.array([0.560, -0.093, 0.290])
    assert np.allclose(in_part_frame(world, "world", bed), x)
    assert np.array_equal(in_part_frame(x, "part", bed), x)
    turned = build_cell(load_problem("cylinder_logo"))
    assert np.allclose(in_part_frame(x + np.array([0.0, 0.0, 0.06]), "plate", turned), x)
    with pytest.raises(InputError, match="positioner moves"):
        in_part_frame(x, "world", turned)
    held = build_cell(
        load_problem("cylinder_logo", ["cell.positioner.free=[]", "cell.positioner.held_deg={tilt: 30, rotation: 50}"])
    )
    T = held.T_world_holder
    assert np.allclose(in_part_frame(x @ T[:3, :3].T + T[:3, 3], "world", held), x)


# ----------------------------------------------------------------------------------------------------
# The height map.


def test_the_map_is_the_truth() -> None:
    found, truth = mapped(), Truth.of(drawn()[1], SCANNED).at(mapped().top.middle)
    off = found.smoothed - truth
    assert np.abs(truth).max() > 0.7e-3
    assert np.sqrt((off**2).mean()) < 0.02e-3 and np.abs(off[found.measured]).max() < 0.1e-3
    assert 0.8 < found.covered < 0.98 and found.widest_hole > 1e-3
    assert found.noise < 0.03e-3


def test_outliers_do_not_reach_the_map() -> None:
    clean = scanned(drawn()[1], SCANNED, noise=0.0)
    wild = clean.copy()
    random = np.random.default_rng(3)
    some = random.random(len(wild)) < 0.2
    wild[some] += random.uniform(-3e-3, 3e-3, (int(some.sum()), 3))
    top = planned_top(drawn()[1], SCANNED)
    a, b = (height_map(top, each, RADIUS, WRONG) for each in (clean, wild))
    assert np.abs(a.smoothed - b.smoothed).max() < 0.08e-3
    assert np.sqrt(((a.smoothed - b.smoothed) ** 2).mean()) < 0.01e-3


def test_a_flat_print_has_a_map() -> None:
    found = height_map(planned_top(flat(), 1), scanned(flat(), 1), 2.5e-3, WRONG)
    off = found.smoothed - Truth.of(flat(), 1).at(found.top.middle)
    assert np.sqrt((off**2).mean()) < 0.025e-3


@cache
def wall() -> PlannedTop:
    """The top of a bead along x that is 1 m long, 30 mm wide and 10 mm high."""
    line = np.column_stack([np.linspace(0.0, 1.0, 201), np.zeros(201), np.full(201, 10e-3)])
    up, ahead = np.tile([0.0, 0.0, 1.0], (201, 1)), np.tile([1.0, 0.0, 0.0], (201, 1))
    bead = make_bead("wall", 0, line, up, ahead, line, width=30e-3, height=10e-3)
    return planned_top(Toolpath((bead,), flat().surface), 1)


def test_of_a_wide_and_high_bead_coarser_scans_and_greater_errors_are_taken() -> None:
    """4 mm too low; scanned every 3 to 4 mm, with half a millimetre of noise."""
    top = wall()
    assert len(top.middle) == 112  # cells of 9 mm, of which each has six points or more
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0.0, 1.0, 4e-3), np.arange(-9e-3, 10e-3, 3e-3)))
    noise = np.random.default_rng(5).normal(0.0, 0.5e-3, len(x))
    found = height_map(top, np.column_stack([x, y, 6e-3 + noise]), 15e-3, WRONG)
    assert found.covered > 0.9
    assert np.median(found.deviation) == pytest.approx(-4e-3, abs=0.2e-3)
    with pytest.raises(InputError, match="lies elsewhere"):  # the layer beneath
        height_map(top, np.column_stack([x, y, noise]), 15e-3, WRONG)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x: x * 1e3, "1000 times the layer's .* it is in another unit"),
        (lambda x: x * 1e-3, r"0\.001 times the layer's .* it is in another unit"),
        (
            lambda x: x + np.array([0.0, 0.0, 0.012]),
            r"lies elsewhere: half of the layer's top is 9\.\d mm .*\+12\.\d\) mm",
        ),
        (lambda x: x + 0.3, "lies elsewhere"),
        (lambda x: x[x[:, 0] > 0.0], "covers 5\\d% of the layer's top"),
        (lambda x: x[::40], "covers .*% of the layer's top"),
    ],
)
def test_a_cloud_of_another_print_is_refused(change: Callable[[Array], Array], said: str) -> None:
    with pytest.raises(InputError, match=said):
        height_map(planned_top(drawn()[1], SCANNED), change(cloud()), RADIUS, WRONG)


def displaced(x: Array, degrees: tuple[float, float, float], shift_mm: tuple[float, float, float]) -> Array:
    turn = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    middle = x.mean(axis=0)
    return np.asarray((x - middle) @ turn.T + middle + np.array(shift_mm) * 1e-3)


@pytest.mark.slow
def test_a_displaced_cloud_is_fitted() -> None:
    toolpath = build_toolpath(load_problem("hemisphere_honeycomb", ["layers.count=2"]))
    top, x = planned_top(toolpath, 2), scanned(toolpath, 2)
    straight = fit_cloud(top, x, FREEDOMS, WRONG)  # the errors of the print look like a displacement, too
    fit = fit_cloud(top, displaced(x, (1.0, -1.5, 2.0), (1.5, -1.0, 0.8)), FREEDOMS, WRONG)
    assert np.abs(fit.points - straight.points).max() < 0.05e-3
    assert np.linalg.norm(straight.shift) < 0.2e-3 and not fit.unseen
    assert height_map(top, fit.points, RADIUS, WRONG).covered > 0.8


def test_freedoms_that_are_not_fitted_stay() -> None:
    top, x = planned_top(flat(), 1), scanned(flat(), 1)
    straight = fit_cloud(top, x, ("z",), WRONG)
    fit = fit_cloud(top, displaced(x, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), ("z",), WRONG)
    assert np.abs(fit.shift[:2]).max() < 1e-9 and not np.abs(fit.turn).any()
    assert straight.shift[2] - fit.shift[2] == pytest.approx(1e-3, abs=2e-5)


def test_the_edges_of_a_wide_bead_tell_of_shifts() -> None:
    """They are 15 mm from its middle; points are looked for within 2 mm of those of narrow beads in the end."""
    random = np.random.default_rng(5)
    x, y = random.uniform(0.0, 1.0, 6000), random.uniform(-15.5e-3, 15.5e-3, 6000)
    noise = random.normal(0.0, 0.5e-3, 6000)
    cloud = np.column_stack([x, y + 2e-3, 13e-3 + noise])
    fit = fit_cloud(wall(), cloud, ("y", "z"), WRONG)
    assert fit.shift == pytest.approx([0.0, -2e-3, -3e-3], abs=0.3e-3) and not fit.unseen


def test_what_is_too_far_off_is_not_fitted() -> None:
    top = planned_top(drawn()[1], SCANNED)
    with pytest.raises(InputError, match="too few to fit"):
        fit_cloud(top, cloud() + 0.5, FREEDOMS, WRONG)
    with pytest.raises(InputError, match=r"mm and .* degrees from the layer's top"):
        fit_cloud(top, cloud() + np.array([0.0, 0.0, 11e-3]), FREEDOMS, WRONG)


def surroundings() -> Array:
    """What a scanner sees besides a layer of the honeycomb: the bare dome between its beads, and the bed around it."""
    random, top = np.random.default_rng(2), planned_top(drawn()[1], SCANNED)
    way = random.standard_normal((150_000, 3))
    dome = 0.05 * way / np.linalg.norm(way, axis=1)[:, None] + [0.0, 0.0, -0.02]
    dome = dome[(dome[:, 2] > 0.0) & (np.hypot(*dome[:, :2].T) < 0.02)]
    near = cKDTree(top.points).query(dome)[1]
    aside = np.linalg.norm(np.cross(dome - top.points[near], top.normals[near]), axis=1)
    plane = random.uniform(-0.2, 0.2, (100_000, 2))
    bed = np.column_stack([plane, np.zeros(len(plane))])[np.hypot(*plane.T) > 0.046]
    return np.vstack([dome[aside > 0.3e-3], bed])


@pytest.mark.slow
def test_what_lies_around_the_beads_does_no_harm_but_to_a_fit() -> None:
    top = planned_top(drawn()[1], SCANNED)
    whole = np.vstack([surroundings(), cloud()])
    assert np.array_equal(height_map(top, whole, RADIUS, WRONG).smoothed, mapped().smoothed)
    with pytest.raises(InputError, match=r"% on the layer's beads"):
        fit_cloud(top, displaced(whole, (0.5, 0.5, 0.5), (1.0, 1.0, 0.5)), FREEDOMS, WRONG)


# ----------------------------------------------------------------------------------------------------
# What is made of the map.


@given(st.floats(-3e-3, 3e-3), st.floats(0.02e-3, 1e-3))
def test_what_is_made_up_for_is_bounded_and_leads_to_nothing_left(deviation: float, most: float) -> None:
    e = np.array([deviation])
    assert abs(made_up(e, most)[0]) <= most * (1.0 + 1e-12)
    rest = [abs(left(e, most, k)[0]) for k in range(4)]
    assert all(b <= a for a, b in zip(rest[:-1], rest[1:], strict=True))
    assert abs(left(e, most, int(abs(deviation) / most * 1.5) + 4)[0]) < 0.05 * most
    assert still_off(e, most, np.array([3]))[0] == pytest.approx(left(e, most, 3)[0], abs=1e-15)


def test_a_slope_is_read_as_it_is() -> None:
    random = np.random.default_rng(5)
    x = np.column_stack([random.uniform(-0.02, 0.02, (900, 2)), np.zeros(900)])
    up = np.tile([0.0, 0.0, 1.0], (900, 1))
    field = DeviationField(x, up, 0.01 * x[:, 0] - 0.02 * x[:, 1] + 2e-4, RADIUS)
    ask = np.column_stack([random.uniform(-0.018, 0.018, (50, 2)), np.full(50, 0.004)])
    assert np.abs(field.at(ask, up[:50]) - (0.01 * ask[:, 0] - 0.02 * ask[:, 1] + 2e-4)).max() < 2e-6


def test_the_verifier_reads_the_map_alike_with_other_code(tmp_path: Path) -> None:
    spec = corrected(tmp_path).as_printed
    assert spec is not None
    field = read_map(spec.map, spec.smoothing, WRONG)
    for bead in (drawn()[1].beads[k] for k in (1, -1)):
        far = bead.points + 0.02 * np.cross(bead.normals, [0.0, 0.0, 1.0])  # beside the map
        for places in (bead.points[::7], far[::7]):
            top = ScannedTop(field.points, field.normals, field.deviation, np.ones(len(field.points), dtype=bool))
            assert top.tree is top.tree  # built once, and searched many times
            ours = field.at(places, bead.normals[::7])
            assert np.abs(deviations(top, places, bead.normals[::7], spec.smoothing) - ours).max() < 1e-9


def test_the_verifier_reads_maps_with_a_mark_and_comments(tmp_path: Path) -> None:
    spec = corrected(tmp_path).as_printed
    assert spec is not None
    plain = scanned_top(spec)
    spec.map.write_text("# by hand\n" + spec.map.read_text("utf-8") + "# the end\n", "utf-8-sig")
    assert np.array_equal(scanned_top(spec).points, plain.points)
    assert len(read_map(spec.map, spec.smoothing, WRONG).points) == len(plain.points)


def test_beads_above_make_up_for_the_print(tmp_path: Path) -> None:
    toolpath = drawn()[1]
    rest = build_toolpath(corrected(tmp_path))
    truth = Truth.of(toolpath, SCANNED)
    assert len(rest.beads) == len(toolpath.beads)
    for before, after in zip(toolpath.beads, rest.beads, strict=True):
        above = before.layer + 1 - SCANNED
        rise = ((after.points - before.points) * before.normals).sum(axis=1)
        feet = before.points - above * 0.5e-3 * before.normals
        assert np.abs(rise - left(truth.at(feet), 0.15e-3, max(above, 0))).max() < 0.12e-3
        if above > 0:
            change = after.height - before.height
            assert np.abs(change).max() <= 0.15e-3 and np.abs(change).max() > 0.1e-3
        else:
            assert np.array_equal(after.height, before.height)
        assert np.allclose(np.linalg.norm(np.diff(after.points, axis=0), axis=1).sum(), after.length, rtol=1e-3)
    assert "laid on what is printed" in rest.notes[-1]


def test_normals_are_those_of_the_places_that_were_drawn(tmp_path: Path) -> None:
    """A metre of bead round a ball of 60 mm, whose top lies 0.155 mm low: laid there it is 2.4 mm shorter."""
    share = np.linspace(0.0, 1.0, 1000)
    lean, turn = 0.05 + 0.85 * share, 12.0 * np.pi * share
    up = np.column_stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
    rows = np.vstack([np.column_stack([(60.0 + 0.5 * k) * up, up, np.full(1000, k)]) for k in range(2)])
    np.savetxt(tmp_path / "ball.txt", rows, fmt="%.6f", header="x y z nx ny nz layer")
    low = np.column_stack([60.0 * up, up, np.full(1000, -0.155)])
    np.savetxt(tmp_path / "map.csv", low, fmt="%.6f", delimiter=",", header=",".join(COLUMNS), comments="")
    scan = f"{{map: {tmp_path / 'map.csv'}, after_layer: 1, most_mm: 0.01, smoothing_mm: 5}}"
    waypoints = f"layers.source={{waypoints: {tmp_path / 'ball.txt'}}}"
    as_drawn = build_toolpath(load_problem("peer_cap", [waypoints]))
    toolpath = build_toolpath(load_problem("peer_cap", [waypoints, f"as_printed={scan}"]))
    assert as_drawn.beads[1].length - toolpath.beads[1].length > 2e-3
    for i, bead in enumerate(toolpath.beads):
        found = toolpath.surface.normals_on(i, bead.s, bead.points)
        off = np.arccos(np.clip((found * bead.normals).sum(axis=1), -1.0, 1.0))
        assert np.degrees(off.max()) < 0.01


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("as_printed.after_layer=4", "layer 4 is the last one"),
        ("as_printed.after_layer=9", r"there is no layer 9 \(layers 1 to 4"),
        ("as_printed.most_mm=0.3", "more than half the height of a bead"),
        ("as_printed.map=rest.yaml", "is not a height map"),
        ("as_printed.map=nothing.csv", "there is no file"),
        ("process.bead.section=fibre", "a fibre has a fixed thickness"),
    ],
)
def test_a_section_that_cannot_be(change: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        build_toolpath(corrected(tmp_path).changed([change]))


def test_maps_that_are_none(tmp_path: Path) -> None:
    head = "x_mm,y_mm,z_mm,nx,ny,nz,deviation_mm\n"
    path = tmp_path / "map.csv"
    for text, said in (
        (head, "places missing"),
        ("x_mm,y_mm\n1,2\n", "z_mm missing"),
        (f"{head}0,0,0,0,0,1,high\n", "not all numbers"),
        (f"{head}0,0,0,0,0,1\n", "not all numbers"),
        (f"{head}0,0,0,0,0,1,nan\n", "not finite"),
        (f"{head}0,0,0,0,0,2,0\n", "not of unit length"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            read_map(path, RADIUS, WRONG)


def test_prints_that_are_not_made_in_layers() -> None:
    assert beads_up_to([0, 0, 1, 2], 1, WRONG) == 2
    with pytest.raises(InputError, match="after beads above it"):
        beads_up_to([0, 1, 0, 1], 1, WRONG)


def test_a_rounded_bead_is_not_made_higher_than_wide(tmp_path: Path) -> None:
    problem = corrected(tmp_path).changed(["process.bead.section=rounded"])
    with pytest.raises(InputError, match="more than it is wide"):
        build_toolpath(problem)


def test_what_is_told() -> None:
    heights = layer_heights(drawn()[1], SCANNED)
    assert [number for number, _ in heights] == [3, 4]
    table = table_of(mapped(), heights, 0.15e-3)
    assert table[1].split()[:2] == ["3", "0.350–0.650"] and "0.70–1.30" in table[1]
    widths = layer_widths(drawn()[1], SCANNED)
    assert widths == pytest.approx([0.6e-3, 0.6e-3])
    low, own = cross_section("rounded", np.full(2, 0.6), np.array([0.35, 0.5]), 0.0)
    rounded = table_of(mapped(), heights, 0.15e-3, widths)[1].split()
    assert rounded[1] == "0.350–0.650" and float(rounded[2].split("–")[0]) == pytest.approx(low / own, abs=6e-3)
    assert "are left on the last layer" in remains(mapped(), heights, 0.15e-3)
    assert "made up for to 0.1 mm" in remains(mapped(), [(k, 0.5e-3) for k in range(3, 15)], 0.15e-3)
    assert "made up for to 0.025 mm" in remains(mapped(), [(k, 0.05e-3) for k in range(3, 15)], 0.15e-3)


def test_why_cells_are_interpolated_is_told() -> None:
    n = len(mapped().measured)
    measured, count, scatter = np.arange(n) > 2, np.full(n, 10), np.full(n, 0.05e-3)
    count[0], scatter[1] = 3, 0.4e-3  # the third one has points that agree, and is left out all the same
    found = replace(mapped(), measured=measured, count=count, scatter=scatter)
    first, _, holes = lines_of(found, SCANNED)
    assert f"measured by {10 * (n - 3)} points (10 in a cell)" in first
    assert "interpolated: 3 cells (2 with fewer than 4 points that agree, 1 far off what lies around); " in holes
    measured, count = np.arange(n) > 0, np.full(n, 10)
    found = replace(mapped(), measured=measured, count=count, scatter=scatter)
    assert "interpolated: 1 cells (1 far off what lies around); " in lines_of(found, SCANNED)[-1]
    assert len(lines_of(replace(found, measured=np.ones(n, dtype=np.bool_)), SCANNED)) == 2


@pytest.mark.parametrize("again", [False, True])
def test_what_runs_taught_is_left_out(again: bool, tmp_path: Path) -> None:
    problem, taught = corrected(tmp_path) if again else drawn()[0], tmp_path / "taught.yaml"
    taught.write_text(write_taught(problem, "dome_run_2", 1e-3, tmp_path), encoding="utf-8")
    assert load_problem(taught).as_run is not None
    text = write_problem(load_problem(taught), mapped(), SCANNED, 0.1e-3, tmp_path)
    (tmp_path / "rest.yaml").write_text(text, encoding="utf-8")
    rest = load_problem(tmp_path / "rest.yaml")
    assert rest.as_run is None and "what runs taught" not in text.lower()
    assert rest.as_printed is not None and rest.as_printed.most == pytest.approx(0.1e-3)


def test_only_what_a_scan_has_added_is_taken_off_a_name(tmp_path: Path) -> None:
    own, again = (
        problem.model_copy(update={"name": "vase_after_anneal_after_2"})
        for problem in (drawn()[0], corrected(tmp_path))
    )
    assert drawn_name(own) == own.name
    assert drawn_name(again) == "vase_after_anneal"


@pytest.mark.parametrize(
    ("height", "off", "holds"),
    [(0.5e-3, 0.09e-3, True), (0.5e-3, 0.11e-3, False), (0.05e-3, 0.02e-3, True), (0.05e-3, 0.03e-3, False)],
)
def test_over_the_print_low_beads_are_off_by_half_their_height_at_most(
    monkeypatch: pytest.MonkeyPatch, height: float, off: float, holds: bool
) -> None:
    n = 20
    s, high = np.linspace(0.0, 3e-3, n), np.full(n, height)
    high[7] += off
    bead = SimpleNamespace(layer=SCANNED, s=s, height=np.full(n, height))
    t = SimpleNamespace(deposit=np.ones(n, dtype=bool), bead=np.zeros(n, dtype=np.int64), s=s, t=s)
    judged: Any = SimpleNamespace(
        trajectory=t, toolpath=SimpleNamespace(beads=(bead,)), motion=SimpleNamespace(tip=np.zeros((n, 3)))
    )
    spec: Any = SimpleNamespace(after_layer=SCANNED, smoothing=RADIUS)
    for name, value in (("scanned_top", None), ("normals_along", None), ("over_print", high)):
        monkeypatch.setattr(f"planner.verify.as_printed.{name}", lambda *_, value=value: value)
    (check,), metrics = _over_print(judged, spec)
    assert (check.ok, check.sample) == (holds, 7)
    assert metrics["over_print_error_max_mm"] == pytest.approx(off * 1e3)


# ----------------------------------------------------------------------------------------------------
# Planned and verified.


@pytest.mark.slow
def test_the_rest_of_the_print_is_planned_on_it_and_verified() -> None:
    plan = solved()
    assert plan.verified, failed(plan.checks)
    assert plan.first_bead == sum(bead.layer < SCANNED for bead in plan.toolpath.beads)
    assert plan.metrics["over_print_error_max_mm"] < 0.1
    truth = Truth.of(drawn()[1], SCANNED)
    t = plan.trajectory
    for i in range(plan.first_bead, len(plan.toolpath.beads)):
        bead, before = plan.toolpath.beads[i], drawn()[1].beads[i]
        if bead.layer != SCANNED:
            continue
        at = np.flatnonzero(t.deposit & (t.bead == i))
        s = t.s[at] * before.length / bead.length
        p, n = (np.stack([np.interp(s, before.s, x) for x in v.T], axis=1) for v in (before.points, before.normals))
        gap = ((t.tip[at] - p) * n).sum(axis=1) + 0.5e-3 - truth.at(p - 0.5e-3 * n)
        assert np.abs(gap - np.interp(t.s[at], bead.s, bead.height)).max() < 0.1e-3


@pytest.mark.slow
def test_what_was_not_corrected_fails(tmp_path: Path) -> None:
    plan = solved()
    problem = corrected(tmp_path)
    drawn_problem, toolpath = drawn()
    same = verify(problem, plan.cell, plan.toolpath, plan.trajectory)
    assert not failed(same.checks)
    flat_heights = tuple(
        replace(bead, height=before.height) for bead, before in zip(plan.toolpath.beads, toolpath.beads, strict=True)
    )
    spoilt = verify(problem, plan.cell, replace(plan.toolpath, beads=flat_heights), plan.trajectory)
    assert {"nozzle over the print", "beads as wide and high as asked", "extrusion balance"} <= failed(spoilt.checks)
    as_drawn = solve(drawn_problem, first_bead=plan.first_bead, baseline=False)
    spoilt = verify(problem, plan.cell, toolpath, as_drawn.trajectory)
    assert {"nozzle over the print", "layers on the part"} <= failed(spoilt.checks)


@pytest.mark.slow
def test_another_map_fails(tmp_path: Path) -> None:
    plan, problem = solved(), corrected(tmp_path)
    assert problem.as_printed is not None
    lines = problem.as_printed.map.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[6] = f"{float(row[6]) + 0.2:.6f}"
    problem.as_printed.map.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]), encoding="utf-8")
    spoilt = verify(problem, plan.cell, plan.toolpath, plan.trajectory)
    assert {"nozzle over the print", "beads as wide and high as asked", "layers on the part"} <= failed(spoilt.checks)
    problem.as_printed.map.unlink()
    with pytest.raises(InputError, match="cannot be read again"):
        verify(problem, plan.cell, plan.toolpath, plan.trajectory)


@pytest.mark.slow
def test_a_bead_that_is_printed_is_not_begun_with(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is printed already"):
        solve(corrected(tmp_path), first_bead=1, baseline=False)
    later = solved().first_bead + 2
    resumed = solve(corrected(tmp_path), first_bead=later, baseline=False)
    assert resumed.first_bead == later and resumed.verified
    assert np.array_equal(resumed.paths[0].q, solved().paths[2].q)


# ----------------------------------------------------------------------------------------------------
# The command.


def sets() -> list[str]:
    return [word for each in (*PRINT, *QUICK) for word in ("--set", each)]


@pytest.mark.slow
def test_the_map_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "cloud.npy", cloud() * 1e3)
    given_ = ["hemisphere_honeycomb", str(tmp_path / "cloud.npy"), "--after-layer", "2", "--map-only"]
    assert main([*given_, *sets(), "--out", str(tmp_path / "out")]) == EXIT_VERIFIED
    said = capsys.readouterr().out
    assert "top of layer 2" in said and "interpolated" in said and "not made up for" in said
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"height_map.csv", "height_map.png", "hemisphere_honeycomb_after_2.yaml", "manifest.json"}
    assert (tmp_path / "out" / "height_map.png").read_bytes().startswith(b"\x89PNG")
    rest = load_problem(tmp_path / "out" / "hemisphere_honeycomb_after_2.yaml", PRINT)
    assert rest.as_printed is not None and rest.as_printed.after_layer == 2
    assert rest.as_printed.most == pytest.approx(0.15e-3) and rest.as_printed.smoothing == pytest.approx(3e-3)
    again = scanned_plan(str(tmp_path / "out" / "hemisphere_honeycomb_after_2.yaml"), PRINT)  # a later scan begins anew
    assert again.toolpath.length == pytest.approx(drawn()[1].length)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (1.0, ["--after-layer", "2"], "it is in another unit"),
        (1e6, ["--after-layer", "2"], "it is in another unit"),
        (1e3, ["--after-layer", "7"], "there is no layer 7"),
        (1e3, ["--after-layer", "4"], "layer 4 is the last one"),
        (1e3, ["--after-layer", "2", "--frame", "world"], "lies elsewhere"),
        (1e3, ["--after-layer", "2", "--frame", "world", "--fit"], "too few to fit"),
    ],
)
def test_wrong_input_writes_nothing(
    change: float, options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "cloud.npy", cloud() * change)
    given_ = ["hemisphere_honeycomb", str(tmp_path / "cloud.npy"), *options, *sets(), "--out", str(tmp_path / "out")]
    assert main(given_) == EXIT_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_name_that_was_set_is_not_that_of_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load_problem("hemisphere_honeycomb", (*PRINT, *QUICK, "name=fast"))
    solved_with: list[list[str]] = []

    def solved_by(given: list[str]) -> int:
        solved_with.append(given)
        return EXIT_VERIFIED

    for name, instead in {
        "scanned_plan": lambda *_: ScannedPlan(problem, drawn()[1]),
        "_measured": lambda *_: (mapped(), None),
        "write_picture": lambda *_: None,
        "solve_main": solved_by,
    }.items():
        monkeypatch.setattr(f"planner.feedback.scan_command.{name}", instead)
    monkeypatch.chdir(tmp_path)
    assert main(["hemisphere_honeycomb", "cloud.npy", "--after-layer", "2"]) == EXIT_VERIFIED
    (given,) = solved_with
    assert Path(given[0]) == Path("out/fast_scanned_2/fast_after_2.yaml")
    assert "layers.count=4" in given and "name=fast" not in given
    assert load_problem(given[0], given[2::2]).name == "fast_after_2"


@pytest.mark.parametrize("option", [["--share", "0.7"], ["--fit", "x,w"], ["--smoothing-mm", "0"], ["--unit", "in"]])
def test_options_that_are_none(option: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["hemisphere_honeycomb", "cloud.npy", "--after-layer", "2", *option])
    assert ended.value.code == EXIT_INPUT


def test_plans_that_there_are_not(tmp_path: Path) -> None:
    for name, said in (("nothing.npz", "no shipped problem|no such file|there is no"), ("nowhere", "nowhere")):
        with pytest.raises(InputError, match=said):
            scanned_plan(str(tmp_path / name))
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"holds no plan\.json"):
        scanned_plan(str(tmp_path / "empty"))
    for text, said in (
        ("{}", "no plan.json that solve wrote"),
        ('{"problem": "mine", "settings": {"overrides": []}}', "mine"),
    ):
        (tmp_path / "empty" / "plan.json").write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=said):
            scanned_plan(str(tmp_path / "empty"))
    held = {"problem": "hemisphere_honeycomb", "settings": {"overrides": list(PRINT)}}
    (tmp_path / "empty" / "plan.json").write_text(json.dumps(held), encoding="utf-8")
    assert scanned_plan(str(tmp_path / "empty")).toolpath.length == pytest.approx(drawn()[1].length)


def test_fibre_is_not_scanned() -> None:
    with pytest.raises(InputError, match="lays fibre, whose thickness is fixed"):
        scanned_plan("hemisphere_honeycomb", (*PRINT, "process.bead.section=fibre"))


@pytest.mark.slow
def test_a_saved_plan_and_its_inputs(tmp_path: Path) -> None:
    problem = tmp_path / "mine.yaml"
    shipped = drawn()[0].file.read_text(encoding="utf-8")
    problem.write_text(shipped.replace("size_mm: [60, 60]", "size_mm: [14, 14]"), encoding="utf-8")
    plan = solve(load_problem(problem, [*QUICK, "layers.count=2"]), baseline=False)
    saved = plan.save(tmp_path / "plan.npz")
    assert scanned_plan(str(saved)).toolpath.length == pytest.approx(plan.toolpath.length)
    problem.write_text(shipped, encoding="utf-8")
    with pytest.raises(InputError, match="mm of beads were planned, but its problem now has"):
        scanned_plan(str(saved))
    problem.unlink()
    with pytest.raises(InputError, match="no longer exists"):
        scanned_plan(str(saved))


@pytest.mark.slow
def test_the_whole_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    np.save(tmp_path / "cloud.npy", cloud() * 1e3)
    given_ = ["hemisphere_honeycomb", "cloud.npy", "--after-layer", "2", "--quiet", *sets()]
    assert main(given_) == EXIT_VERIFIED
    folder = tmp_path / "out" / "hemisphere_honeycomb_after_2"
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert plan["verified"] and plan["first_bead"] == solved().first_bead
    assert {"nozzle over the print", "begins above the scanned layer"} <= {check["name"] for check in plan["checks"]}
    assert list(folder.glob("*.mod"))


def test_clouds_that_are_cut_off_or_endless_are_refused_without_a_warning(tmp_path: Path) -> None:
    np.savez(tmp_path / "cloud.npz", points=points())
    (tmp_path / "cut.npz").write_bytes((tmp_path / "cloud.npz").read_bytes()[:900])
    far = points()
    far[3, 1] = 1e200
    np.save(tmp_path / "far.npy", far)
    ply(tmp_path / "far.ply", np.minimum(far, 3e38), binary=True)
    (tmp_path / "huge.npy").write_bytes(
        (tmp_path / "far.npy").read_bytes().replace(b"(300, 3)", b"(9" + b"0" * 17 + b", 3)")
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, said in (
            ("cut.npz", "is not a NumPy file"),
            ("far.npy", "too far away"),
            ("far.ply", "too far away"),
            ("huge.npy", "is not a NumPy file"),
        ):
            with pytest.raises(InputError, match=said):
                read_cloud(tmp_path / name)


def test_a_header_without_points_is_refused_without_a_warning(tmp_path: Path) -> None:
    (tmp_path / "cloud.csv").write_text("x_mm,y_mm,z_mm\n", encoding="utf-8")
    with warnings.catch_warnings(), pytest.raises(InputError, match="holds no points"):
        warnings.simplefilter("error")
        read_cloud(tmp_path / "cloud.csv")


def test_a_map_with_an_endless_field_is_refused(tmp_path: Path) -> None:
    problem = corrected(tmp_path)
    (tmp_path / "height_map.csv").write_text("x_mm," + "9" * 200_000 + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"height_map\.csv is not CSV"):
        build_toolpath(problem)
