"""What robots look like: shells of what is checked, meshes of URDFs, and a view of the cell that holds all bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.base.errors import InputError
from planner.cell.bodies import drawn_meshes, read_mesh
from planner.cell.cell import build_cell
from planner.cell.collada import read_collada
from planner.cell.looks import bodies_surface, link_surface
from planner.cell.robot import Robot, joint_axes, read_robot, robot_names
from planner.cell.shells import MOST_FILLET, casting
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, Mesh, triangles_of
from planner.cell.surfaces import TriangleSurface, creased, decimated, rgb, solid_surface
from planner.cell.urdf import parse_urdf
from planner.problem import load_problem
from planner.verify.drawing import cell_view

ROBOTS = Path(__file__).resolve().parent.parent / "robots"
SHELLS = [key for key in robot_names() if key not in ("panda", "ur3", "ur5", "ur10", "xarm7")]
ARMS = [key for key in SHELLS if key not in ("irbp_a250", "track_3m", "gantry_xy")]
COVERED = 3.1e-3  # m: how far covers stand out of what they are on
IN_CENTIMETRES = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="box"><mesh>
    <source id="places">
      <float_array id="numbers" count="24">{corners}</float_array>
      <technique_common><accessor source="#numbers" count="8" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common>
    </source>
    <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
    <triangles count="12"><input semantic="VERTEX" source="#corners" offset="0"/><p>{triangles}</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="all"><node id="one"><instance_geometry url="#box"/></node></visual_scene>
  </library_visual_scenes>
  <scene><instance_visual_scene url="#all"/></scene>
</COLLADA>"""


def links(robot: Robot) -> list[tuple[int, list[Body], TriangleSurface]]:
    """Joint, bodies and surface of each link."""
    out = []
    for i, bodies in enumerate(robot.bodies):
        for link in dict.fromkeys(body.link for body in bodies):
            own = [body for body in bodies if body.link == link]
            looks = [look for look in robot.looks[i] if look.link == link]
            out.append((i, own, link_surface(own, looks, joint_axes(robot.model, i))))
    return out


def outside(bodies: list[Body], points: np.ndarray) -> np.ndarray:
    """How far points (n, 3) are from the nearest of boxes, cylinders and capsules, 0 inside, by other formulas."""
    found = []
    for body in bodies:
        solid, T = body.solid, body.T_frame_solid
        p = (points - T[:3, 3]) @ T[:3, :3]
        if isinstance(solid, Box):
            inside = np.clip(p, -0.5 * np.array(solid.size), 0.5 * np.array(solid.size))
        elif isinstance(solid, Frustum):
            r = np.hypot(p[:, 0], p[:, 1])
            share = np.minimum(1.0, solid.bottom / np.maximum(r, 1e-12))
            inside = np.column_stack([p[:, :2] * share[:, None], np.clip(p[:, 2], 0.0, solid.height)])
        else:
            assert isinstance(solid, Capsule)
            core = np.column_stack([0 * p[:, :2], np.clip(p[:, 2], -0.5 * solid.length, 0.5 * solid.length)])
            off = np.linalg.norm(p - core, axis=1)
            inside = core + (p - core) * np.minimum(1.0, solid.radius / np.maximum(off, 1e-12))[:, None]
        found.append(np.linalg.norm(p - inside, axis=1))
    return np.min(found, axis=0)


def crossings(surface: TriangleSurface, start: np.ndarray, way: np.ndarray) -> int:
    """How many triangles a ray meets."""
    a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
    across = np.cross(way, c - a)
    det = np.einsum("ij,ij->i", b - a, across)
    u = np.einsum("ij,ij->i", start - a, across) / np.where(det == 0, 1, det)
    q = np.cross(start - a, b - a)
    v, t = q @ way / np.where(det == 0, 1, det), np.einsum("ij,ij->i", c - a, q) / np.where(det == 0, 1, det)
    return int(((det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)).sum())


@pytest.mark.slow(keep=("irb140", "irb2600"))
@pytest.mark.parametrize("key", ARMS)
def test_shells_stay_by_what_is_checked(key: str) -> None:
    for _, bodies, surface in links(read_robot(ROBOTS / f"{key}.yaml")):
        off = outside(bodies, surface.vertices)
        assert off.max() < max(0.3 * MOST_FILLET, COVERED) + 5e-3, (bodies[0].link, off.max())
        assert (off < 1e-3).mean() > 0.6, "most of it is inside: only fillets and covers stand out"
        # and it is as large as what is checked, but for rounded edges
        corners = np.vstack(
            [triangles_of(b.solid)[0] @ b.T_frame_solid[:3, :3].T + b.T_frame_solid[:3, 3] for b in bodies]
        )
        lack = np.abs(
            np.vstack(
                [surface.vertices.min(axis=0) - corners.min(axis=0), surface.vertices.max(axis=0) - corners.max(axis=0)]
            )
        )
        assert lack.max() < 0.12 * np.ptp(corners, axis=0).max() + 5e-3, bodies[0].link


@pytest.mark.slow(keep=("irb140", "ur3e"))
@pytest.mark.parametrize("key", ARMS)
def test_shells_are_closed_and_hold_the_axes_that_cross_them(key: str) -> None:
    robot = read_robot(ROBOTS / f"{key}.yaml")
    held = 0
    for i, bodies, _ in links(robot):
        axes = joint_axes(robot.model, i)
        shell = casting([Body(b.name, b.solid, b.T_frame_solid, b.link, colour="#ffffff") for b in bodies], axes)
        edges = np.sort(
            np.concatenate([shell.triangles[:, [0, 1]], shell.triangles[:, [1, 2]], shell.triangles[:, [2, 0]]])
        )
        _, count = np.unique(edges, axis=0, return_counts=True)
        assert (count % 2 == 0).all(), "no edge is open"
        for point in axes[:, :3]:
            inside = [body for body in bodies if outside([body], point[None])[0] == 0.0]
            if inside and min(_depth(body, point) for body in inside) > 0.01:
                held += 1
                assert crossings(shell, point, np.array([0.31, 0.52, 0.795])) % 2 == 1, (bodies[0].link, point)
    assert held >= 2, "joints within links"


def _depth(body: Body, point: np.ndarray) -> float:
    """How deep a point lies in a body: the least distance of any of its surface's corners, at most."""
    surface = solid_surface(body.solid, "#ffffff").moved(body.T_frame_solid)
    return float(np.linalg.norm(surface.vertices - point, axis=1).min())


@pytest.mark.slow(keep=("gantry_xy", "irb140", "ur10e"))
@pytest.mark.parametrize("key", [*SHELLS, "ur5", "panda", "xarm7"])
def test_surfaces_are_finite_with_unit_normals_that_face_outwards(key: str) -> None:
    for _, _, surface in links(read_robot(ROBOTS / f"{key}.yaml")):
        assert np.isfinite(surface.vertices).all() and surface.triangles.max() < len(surface.vertices)
        assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1.0, abs=1e-6)
        assert surface.colours.dtype == np.uint8 and surface.colours.shape == surface.vertices.shape
        corners = surface.vertices[surface.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = np.einsum("ij,ij->i", across, surface.normals[surface.triangles].mean(axis=1)) > 0.0
        area = np.linalg.norm(across, axis=1)
        assert area[facing].sum() > 0.97 * area.sum()


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("key", ["ur5", "panda", "xarm7"])
def test_arms_of_the_package_show_their_meshes(key: str) -> None:
    robot = read_robot(ROBOTS / f"{key}.yaml")
    assert all(robot.looks[i] for i in range(robot.model.njoints) if robot.bodies[i])
    triangles = 0
    for _, bodies, surface in links(robot):
        corners = np.vstack(
            [triangles_of(b.solid)[0] @ b.T_frame_solid[:3, :3].T + b.T_frame_solid[:3, 3] for b in bodies]
        )
        for end in (np.min, np.max):
            assert np.abs(end(surface.vertices, axis=0) - end(corners, axis=0)).max() < 0.03, bodies[0].link
        triangles += len(surface.triangles)
    assert 5_000 < triangles < 80_000


def test_meshes_keep_the_colours_of_their_materials() -> None:
    (path,) = [look.file for look in read_robot(ROBOTS / "ur5.yaml").looks[1] if look.file.name == "shoulder.dae"]
    vertices, triangles, colours = read_collada(path)
    assert len(colours) == len(triangles) > 1_000 and np.isfinite(vertices).all()
    palette = {tuple(each) for each in np.unique(colours, axis=0).tolist()}
    assert any(blue > red + 20 for red, _, blue in palette), "the blue cap"


def test_a_file_that_is_no_collada_says_so(tmp_path: Path) -> None:
    for text in (
        "",
        "<COLLADA/>",
        "<COLLADA><library_visual_scenes><visual_scene><node><instance_geometry url='#a'/></node></visual_scene></library_visual_scenes></COLLADA>",
    ):
        (tmp_path / "m.dae").write_text(text)
        with pytest.raises(ValueError, match=r"m\.dae"):
            read_collada(tmp_path / "m.dae")


def test_collada_counts_in_its_own_unit_drawn_and_checked_alike(tmp_path: Path) -> None:
    """A box of 8 by 20 by 30 cm; y up stays y, as ROS has it."""
    box = trimesh.creation.box((8.0, 20.0, 30.0))
    corners, triangles = (" ".join(map(str, np.ravel(each).tolist())) for each in (box.vertices, box.faces))
    (tmp_path / "link.dae").write_text(IN_CENTIMETRES.format(corners=corners, triangles=triangles), encoding="utf-8")
    mesh = '<geometry><mesh filename="link.dae" scale="2 1 1"/></geometry>'
    text = f'<robot name="r"><link name="base"><collision>{mesh}</collision></link></robot>'
    ((checked, _),) = drawn_meshes(parse_urdf(text.encode(), tmp_path / "r.urdf"), "base", "collision", np.eye(4))
    np.testing.assert_allclose(np.ptp(checked.vertices(), axis=0), [0.16, 0.2, 0.3], rtol=1e-5)
    for vertices in (read_mesh(tmp_path / "link.dae").vertices, read_collada(tmp_path / "link.dae")[0]):
        np.testing.assert_allclose(np.ptp(vertices, axis=0), [0.08, 0.2, 0.3], rtol=1e-5)
    assert [each.name for each in tmp_path.iterdir()] == ["link.dae"]


def test_a_mesh_that_cannot_be_read_is_drawn_as_what_is_checked(tmp_path: Path) -> None:
    (tmp_path / "bad.stl").write_text("no mesh")
    robot = read_robot(ROBOTS / "irb140.yaml")
    look = read_robot(ROBOTS / "ur5.yaml").looks[1][0]
    spoilt = type(look)(look.link, tmp_path / "bad.stl", look.scale, look.T_frame_solid)
    bodies, axes = robot.bodies[1], joint_axes(robot.model, 1)
    with_it, without = link_surface(bodies, [spoilt], axes), link_surface(bodies, [], axes)
    assert (with_it.vertices == without.vertices).all()


def test_decimation_moves_nothing_further_than_a_cell() -> None:
    ball = solid_surface(Capsule(0.1, 0.2), "#ffffff")
    vertices, triangles, kept = decimated(ball.vertices, ball.triangles, 0.02)
    assert len(triangles) < len(ball.triangles) and len(kept) == len(triangles)
    off = np.linalg.norm(ball.vertices[:, None] - vertices[None], axis=2).min(axis=1)
    assert off.max() <= 0.02 * np.sqrt(3)


def test_creases_stay_sharp_and_what_is_round_is_smooth() -> None:
    vertices, triangles = triangles_of(Box((1.0, 1.0, 1.0)))
    cube = creased(vertices, triangles, np.tile(rgb("#102030"), (len(triangles), 1)))
    assert len(cube.vertices) == 24 and set(np.abs(cube.normals).max(axis=1).round(6)) == {1.0}
    vertices, triangles = triangles_of(Capsule(0.5, 0.0))
    ball = creased(vertices, triangles, np.tile(rgb("#102030"), (len(triangles), 1)))
    out = ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None]
    assert (np.einsum("ij,ij->i", out, ball.normals) > 0.97).mean() > 0.85, "all but the poles, where corners coincide"
    assert (ball.colours == rgb("#102030")).all()


@pytest.mark.parametrize("solid", [Box((0.2, 0.1, 0.05)), Frustum(0.05, 0.03, 0.1), Capsule(0.04, 0.1)])
def test_solids_are_drawn_within_themselves(solid: Box | Frustum | Capsule) -> None:
    surface = solid_surface(solid, "#ffffff")
    low, high = (end(triangles_of(solid)[0], axis=0) for end in (np.min, np.max))
    assert (surface.vertices > low - 1e-9).all() and (surface.vertices < high + 1e-9).all()
    assert np.ptp(surface.vertices, axis=0) == pytest.approx(high - low, rel=0.02)


def test_hulls_and_meshes_are_drawn_as_they_are() -> None:
    corners, triangles = triangles_of(Box((0.2, 0.1, 0.05)))
    for solid in (Hull(corners), Mesh(corners, triangles)):
        surface = bodies_surface([Body("b", solid, np.eye(4))], "#ffffff")
        assert sorted(map(tuple, np.unique(surface.vertices.round(9), axis=0))) == sorted(map(tuple, corners.round(9)))


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("name", ["cylinder_logo", "rail_panel", "fibre_bowl"])
def test_a_view_has_every_body_once(name: str) -> None:
    cell = build_cell(load_problem(name, []))
    view = cell_view(cell)
    for k, surface in enumerate(view.vertices):
        assert np.isfinite(surface).all() and len(surface) == len(view.normals[k]) == len(view.colours[k])
    named = [body for bodies in view.bodies for body in bodies]
    assert {"arm", "head"} <= set(view.kinds) and len(view.names) == len(view.joints)
    assert len([body for body in cell.arm_robot.bodies if body]) <= view.kinds.count("arm") <= len(named)
    assert sum(map(len, view.triangles)) < 60_000


def test_colours_that_are_none_are_refused(tmp_path: Path) -> None:
    text = (ROBOTS / "irb140.yaml").read_text()
    (tmp_path / "irb140.urdf").write_text((ROBOTS / "irb140.urdf").read_text())
    for wrong, told in (
        ('{others: "orange"}', "a colour such as"),
        ('{link_9: "#ffffff"}', "no link or shape"),
        ("[1]", "by link or shape"),
    ):
        line = next(line for line in text.splitlines() if line.startswith("colours"))
        (tmp_path / "r.yaml").write_text(text.replace(line, f"colours: {wrong}"))
        with pytest.raises(InputError, match=told) as caught:
            read_robot(tmp_path / "r.yaml")
        assert caught.value.line == text.splitlines().index(line) + 1
