"""Bodies of the print head and of fixtures: what the problem says, and what is assumed where it says nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.base.errors import InputError
from planner.cell.cell import build_cell
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, Mesh, packed, triangles_of
from planner.problem import load_problem
from planner.verify.bodies import coal_geometry


def heads(*changes: str) -> tuple[Body, ...]:
    return build_cell(load_problem("cylinder_logo", changes)).head


def corners(body: Body) -> np.ndarray:
    """Vertices of a body in the frame that carries it."""
    T = body.T_frame_solid
    return triangles_of(body.solid)[0] @ T[:3, :3].T + T[:3, 3]


def test_a_nozzle_is_assumed_from_its_bore_and_held_by_a_tube_to_the_flange() -> None:
    cone, shaft, tube = heads()
    low = corners(cone)
    assert low[:, 2].max() == pytest.approx(0.0)  # the face, at the tip
    assert np.hypot(*low[low[:, 2] > -1e-9, :2].T).max() == pytest.approx(0.6e-3)
    assert corners(shaft)[:, 2].min() == pytest.approx(-40e-3)
    flange = build_cell(load_problem("cylinder_logo")).T_flange_nozzle
    ends = corners(tube) @ flange[:3, :3].T + flange[:3, 3]
    assert ends[:, 2].min() < 16e-3
    assert np.linalg.norm(ends, axis=1).min() < 15e-3
    assert isinstance(tube.solid, Capsule)


def test_a_wide_nozzle_is_held_by_a_tube_as_thick_as_it_is() -> None:
    *_, shaft, tube = heads("cell.nozzle.diameter_mm=20")
    assert isinstance(shaft.solid, Frustum) and isinstance(tube.solid, Capsule)
    assert tube.solid.radius == shaft.solid.top == pytest.approx(24e-3)
    narrow = heads()[-1]
    assert isinstance(narrow.solid, Capsule)
    ahead = narrow.T_frame_solid[:3, 2]
    for end in (-1.0, 1.0):  # from and to the same places
        far, near = (
            float(ahead @ body.T_frame_solid[:3, 3]) + end * (0.5 * solid.length + solid.radius)
            for body, solid in ((tube, tube.solid), (narrow, narrow.solid))
        )
        assert far == pytest.approx(near)


def test_an_outline_is_taken_as_it_is_and_may_have_steps() -> None:
    parts = heads("cell.nozzle.profile_mm=[[0, 0.5], [5, 4], [20, 4], [20, 12], [50, 12]]", "cell.nozzle.head={}")
    assert all(isinstance(part.solid, Frustum) for part in parts)
    sizes = [
        (part.solid.bottom, part.solid.top, part.solid.height) for part in parts if isinstance(part.solid, Frustum)
    ]
    assert np.allclose(sizes, [(0.5e-3, 4e-3, 5e-3), (4e-3, 4e-3, 15e-3), (12e-3, 12e-3, 30e-3)])
    assert corners(parts[2])[:, 2].min() == pytest.approx(-50e-3)


def test_bodies_of_a_head_stand_in_the_flange_frame(tmp_path: Path) -> None:
    stl = tmp_path / "heater.stl"
    trimesh.creation.box((20, 30, 40)).export(stl)
    trimesh.creation.cylinder(15, 20, sections=360).export(tmp_path / "fan.stl")
    own = {
        "motor": {"box_mm": [40, 40, 60], "centre_mm": [0, 0, 30]},
        "heater": {"mesh": str(stl), "rpy_deg": [0, 0, 90]},
        "fan": {"mesh": str(tmp_path / "fan.stl")},
    }
    cell = build_cell(load_problem("cylinder_logo", [f"cell.nozzle.head={json.dumps(own)}"]))
    motor, heater, fan = cell.head[-3:]
    T = cell.T_flange_nozzle
    there = corners(motor) @ T[:3, :3].T + T[:3, 3]
    assert np.allclose([there.min(axis=0), there.max(axis=0)], [[-0.02, -0.02, 0.0], [0.02, 0.02, 0.06]])
    assert isinstance(heater.solid, Hull)
    assert np.allclose(np.ptp(corners(heater) @ T[:3, :3].T, axis=0), [0.03, 0.02, 0.04])
    # in triangles, its round ends have fewer around a corner than coal takes
    assert np.bincount(triangles_of(fan.solid)[1].ravel()).max() < 255
    coal_geometry(fan.solid)
    packed(cell.head)  # all of them convex


def test_fixtures_stand_in_the_world_or_turn_with_the_part(tmp_path: Path) -> None:
    stl = tmp_path / "vice.stl"
    trimesh.creation.annulus(10, 20, 5).export(stl)
    own = {
        "table": {"box_mm": [800, 600, 20], "centre_mm": [600, 0, -10]},
        "post": {"cylinder": {"radius_mm": 10, "height_mm": 100}, "centre_mm": [0, 0, 50], "on": "part"},
        "vice": {"mesh": str(stl), "centre_mm": [1, 2, 3], "on": "part"},
    }
    cell = build_cell(load_problem("cylinder_logo", [f"cell.fixtures={json.dumps(own)}"]))
    assert [body.name for body in cell.fixtures] == ["table"]
    assert cell.fixtures[0].solid == Box((0.8, 0.6, 0.02))
    post, vice = cell.carried
    assert np.allclose([corners(post)[:, 2].min(), corners(post)[:, 2].max()], [0.0, 0.1])
    assert isinstance(vice.solid, Mesh)
    assert np.allclose(corners(vice).mean(axis=0), [1e-3, 2e-3, 3e-3], atol=1e-4)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ('cell.fixtures={"t": {"box_mm": [1, 2]}}', "fixtures.t.box_mm: must be a list of 3 numbers"),
        ('cell.fixtures={"t": {"boxx_mm": [1, 2, 3]}}', "did you mean box_mm"),
        ('cell.fixtures={"t": {}}', "no shape is given"),
        ('cell.fixtures={"t": {"box_mm": [1, 2, 3], "mesh": "a.stl"}}', "both box_mm and mesh are given"),
        ('cell.fixtures={"t": {"box_mm": [1, 2, 3], "on": "wrld"}}', "did you mean world"),
        ('cell.fixtures={"t": {"cylinder": {"radius_mm": 4}, "on": "part"}}', "t.cylinder.height_mm: is missing"),
        ('cell.fixtures={"t": {"cylinder": 4}}', "its keys: radius_mm, height_mm"),
        ('cell.nozzle.head={"motor": {"box": [4, 4, 4]}}', "head.motor.box: unknown key .did you mean box_mm"),
        ('cell.nozzle.head={"motor": 4}', "head.motor: must be a section, not 4 .its keys: box_mm, cylinder, mesh"),
        ("cell.nozzle.profile_mm=long", "must be a list, not the text 'long' .outline of the nozzle .* pairs of"),
        ("cell.nozzle.profile_mm=[[1, 2], [2, 3]]", "begin at height 0"),
        ("cell.nozzle.profile_mm=[[0, 2], [2, 3], [1, 4]]", "heights must not fall"),
        ("collision.arm_mm=-4", "too small"),
        ("collision.nozle_mm=4", "did you mean nozzle_mm"),
    ],
)
def test_mistakes_are_named(change: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_problem("cylinder_logo", [change])


def test_files_that_are_no_bodies_are_named(tmp_path: Path) -> None:
    flat = tmp_path / "flat.stl"
    trimesh.Trimesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0]], [[0, 1, 2], [1, 3, 2]]).export(flat)
    for field, file, words in (
        ("cell.fixtures", tmp_path / "none.stl", "there is no file"),
        ("cell.nozzle.head", flat, "one plane"),
    ):
        problem = load_problem("cylinder_logo", [f'{field}={{"it": {{"mesh": "{file}"}}}}'])
        with pytest.raises(InputError, match=words) as caught:
            build_cell(problem)
        assert f"{field}.it" in str(caught.value) or "--set" in str(caught.value)
