"""Solids and the tree of points: distances against brute force and against coal, triangles against volumes."""

from __future__ import annotations

import coal
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, Mesh, Packed, Solid, packed, triangles_of
from planner.collision.point_tree import (
    FROM_THE_START,
    PointTree,
    SolidNumbers,
    TipRule,
    least_distances,
    nearest_point,
    point_tree,
    search_room,
    solid_distance,
)

RNG = np.random.default_rng(3)
HULL = Hull(np.random.default_rng(1).normal(size=(20, 3)) * 0.03)
SOLIDS = [Box((0.05, 0.03, 0.02)), Frustum(0.01, 0.03, 0.04), Frustum(0.02, 0.0, 0.05), Capsule(0.01, 0.06), HULL]
VOLUMES = [3e-5, np.pi * 0.04 / 3 * (1e-4 + 3e-4 + 9e-4), np.pi * 0.05 / 3 * 4e-4, np.pi * (6e-6 + 4e-6 / 3)]


def pose(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.uniform(-0.1, 0.1, 3)
    return T


def distances(pack: Packed, points: Array, b: int = 0) -> Array:
    """Signed distances of points in the frame from the b-th solid."""
    T = pack.T_solid_frame[b]
    local = points @ T[:3, :3].T + T[:3, 3]
    return np.array([solid_distance(pack.kind[b], pack.size[b], pack.planes, *p) for p in local])


def coal_shape(solid: Solid) -> tuple[coal.CollisionGeometry, Array]:
    """The same solid for coal, and its pose in ours."""
    T = np.eye(4)
    if isinstance(solid, Box):
        return coal.Box(*solid.size), T
    if isinstance(solid, Capsule):
        return coal.Capsule(solid.radius, solid.length), T
    if isinstance(solid, Frustum) and solid.top == 0.0:
        T[2, 3] = 0.5 * solid.height
        return coal.Cone(solid.bottom, solid.height), T
    vertices = coal.StdVec_Vec3s()
    for p in triangles_of(solid)[0]:
        vertices.append(p)
    return coal.Convex.convexHull(vertices, False, ""), T


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_distances_outside_are_coals(solid: Solid) -> None:
    T = pose(5)
    pack = packed([Body("it", solid, T)])
    points = RNG.uniform(-0.2, 0.2, (300, 3))
    own = distances(pack, points)
    shape, T_own = coal_shape(solid)
    there = coal.Transform3s((T @ T_own)[:3, :3], (T @ T_own)[:3, 3])
    theirs = []
    for p in points:
        result = coal.DistanceResult()
        at = coal.Transform3s(np.eye(3), p)
        theirs.append(coal.distance(shape, there, coal.Sphere(1e-9), at, coal.DistanceRequest(), result))
    theirs = np.array(theirs)
    out = theirs > 1e-4
    assert out.sum() > 200
    if isinstance(solid, Hull):  # planes are a bound from below, exact before a facet
        assert (own[out] <= theirs[out] + 1e-7).all()
        assert np.isclose(own[out], theirs[out], atol=1e-6).mean() > 0.02
    else:
        tolerance = (
            2.5e-3 * 0.03 if isinstance(solid, Frustum) and solid.top > 0.0 else 5e-6
        )  # corners on the circle; GJK stops at 1e-6
        assert np.abs(own[out] - theirs[out]).max() < tolerance


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_distances_are_signed_and_change_by_no_more_than_the_point_moves(solid: Solid) -> None:
    pack = packed([Body("it", solid, pose(6))])
    vertices, triangles = triangles_of(solid)
    mesh = trimesh.Trimesh(vertices, triangles).apply_transform(pose(6))
    inside = mesh.bounds.mean(axis=0) + 1e-3 * RNG.normal(size=(50, 3))
    assert (distances(pack, inside) < 0.0).all()
    a, step = RNG.uniform(-0.15, 0.15, (500, 3)), RNG.normal(size=(500, 3)) * 0.02
    moved = np.abs(distances(pack, a + step) - distances(pack, a))
    assert (moved <= np.linalg.norm(step, axis=1) + 1e-12).all()
    far = np.linalg.norm(mesh.vertices - pack.centre[0], axis=1).max()
    assert far <= pack.reach[0] + 1e-9


@pytest.mark.parametrize(("solid", "volume"), list(zip(SOLIDS, VOLUMES, strict=False)))
def test_triangles_close_a_body_of_the_right_volume(solid: Solid, volume: float) -> None:
    vertices, triangles = triangles_of(solid)
    mesh = trimesh.Trimesh(vertices, triangles)
    assert 0.98 * volume < mesh.volume <= volume * (1.0 + 1e-9)
    assert (distances(packed([Body("it", solid, np.eye(4))]), vertices) <= 1e-9).all()


def test_a_mesh_is_given_back_as_it_is_and_is_not_convex() -> None:
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    assert triangles_of(mesh)[1] is mesh.triangles
    with pytest.raises(TypeError, match="vice is not convex"):
        packed([Body("vice", mesh, np.eye(4))])


def test_a_flat_hull_is_refused() -> None:
    flat = np.column_stack([RNG.normal(size=(8, 2)), np.zeros(8)])
    with pytest.raises(ValueError, match="one plane"):
        packed([Body("flat", Hull(flat), np.eye(4))])


def ask(
    tree: PointTree,
    pack: Packed,
    now: float,
    enough: float,
    clearance: float,
    tip: Array,
    slope: float,
    slack: float,
    graze: float = np.inf,
    deep: float = np.inf,
) -> tuple[float, int]:
    solid, rule = SolidNumbers(pack.kind[0], pack.size[0], pack.planes), TipRule(clearance, slope, slack, graze)
    T, tip = np.array(pack.T_solid_frame[0]), np.array(tip)  # of the types in use: compiled once
    return nearest_point(tree.arrays, solid, T, tip, rule, now, enough, deep, search_room())


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 400),
    which=st.integers(0, len(SOLIDS) - 1),
    now=st.floats(-0.5, 1.5),
    near=st.booleans(),
    graze=st.sampled_from([np.inf, 1e-3, 0.0]),
    deep=st.sampled_from([np.inf, 0.01]),
)
def test_the_tree_finds_what_looking_at_all_points_finds(
    seed: int, n: int, which: int, now: float, near: bool, graze: float, deep: float
) -> None:
    rng = np.random.default_rng(seed)
    points, radius = rng.uniform(-0.1, 0.1, (n, 3)), rng.uniform(0.0, 0.002, n)
    time = np.where(rng.random(n) < 0.3, FROM_THE_START, rng.random(n))
    T = pose(seed + 1)
    pack = packed([Body("it", SOLIDS[which], T)])
    tip, enough = T[:3, 3], 0.05
    clearance, slope, slack = (0.002, 0.25, 5e-3) if near else (0.005, 0.0, -0.005)
    tree = point_tree(points, radius, time)
    value, found = ask(tree, pack, now, enough, clearance, tip, slope, slack, graze, deep)
    away = np.linalg.norm(points - tip, axis=1)
    each = distances(pack, points) - radius - np.minimum(clearance, slope * away - slack)
    each = np.where(time == FROM_THE_START, np.minimum(each, distances(pack, points) + graze), each)
    each = np.where(time < now, each, np.inf)
    least = min(float(each.min(initial=np.inf)), enough)
    assert value < -deep if least < -deep - 1e-12 else value == pytest.approx(least, abs=1e-12)
    if least < enough:
        assert each[tree.number[found]] == pytest.approx(value, abs=1e-12)
    else:
        assert found == -1


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(0, 400),
    which=st.integers(0, len(SOLIDS) - 1),
    exact=st.floats(-0.01, 0.08),
    share=st.floats(0.5, 1.0),
)
def test_distances_along_poses_are_exact_where_near_and_a_share_of_the_true_ones_beyond(
    seed: int, n: int, which: int, exact: float, share: float
) -> None:
    """Of poses one after the other and far apart, and times in any order, so that what was nearest before may not be there."""
    rng, most = np.random.default_rng(seed), 0.1
    points, radius = rng.uniform(-0.1, 0.1, (n, 3)), rng.uniform(0.0, 0.002, n)
    time = np.where(rng.random(n) < 0.3, FROM_THE_START, rng.random(n))
    tree, pack = point_tree(points, radius, time), packed([Body("it", SOLIDS[which], np.eye(4))])
    T = np.stack([pose(seed + 1), *(pose(seed + 2 + k) for k in range(5))])
    T[:3, :3, 3] += 0.15  # some of them farther away
    now = rng.uniform(-0.5, 1.5, len(T))
    distance, point = np.empty(len(T)), np.empty(len(T), dtype=np.int64)
    solid = SolidNumbers(pack.kind[0], pack.size[0], pack.planes)
    least_distances(tree.arrays, solid, T, now, exact, most, share, search_room(), distance, point)
    for k, T_solid_tree in enumerate(T):
        each = distances(pack, points @ T_solid_tree[:3, :3].T + T_solid_tree[:3, 3]) - radius
        each = np.where(time < now[k], each, np.inf)
        least = min(float(each.min(initial=np.inf)), most)
        if least < exact:
            assert distance[k] == pytest.approx(least, abs=1e-12)
            assert each[tree.number[point[k]]] == pytest.approx(least, abs=1e-12)
        else:
            assert max(exact, min(share * least, least)) - 1e-12 <= distance[k] <= least + 1e-12
