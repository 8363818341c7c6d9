"""Clearance of postures: distances against coal, margins against brute force, slopes against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from collision_cells import Placed, coal_distance, placed, with_bodies
from scipy.spatial.transform import Rotation

from planner.base.errors import InputError, Refusal
from planner.cell.cell import Cell, build_cell
from planner.cell.solids import Body, Box, Capsule, Frustum, Hull, Mesh, Solid, packed, triangles_of
from planner.collision.gjk import solids_distance
from planner.collision.margins import SUNK, nearest_margins
from planner.collision.point_tree import point_tree
from planner.collision.print_body import TIP_SLOPE, TipRoom
from planner.collision.scene import Around, Obstacles, _assembled, obstacles_of, surface_points
from planner.problem import Problem, load_problem
from planner.resolve.joint_path import JointPath
from planner.resolve.ladder import ClearSearch, coarse_nodes, ladder
from planner.resolve.nodes import evaluate
from planner.resolve.search import best_route
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import NozzleTask, tasks_of


def a_solid(rng: np.random.Generator) -> Solid:
    kind = rng.integers(4)
    if kind == 0:
        return Box(tuple(rng.uniform(0.02, 0.4, 3)))
    if kind == 1:
        return Frustum(*rng.uniform(0.0, 0.1, 2), rng.uniform(0.05, 0.4))
    if kind == 2:
        return Capsule(rng.uniform(0.01, 0.1), rng.uniform(0.0, 0.3))
    return Hull(rng.uniform(-0.15, 0.15, (12, 3)))


def a_pose(rng: np.random.Generator, size: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:3, 3] = rng.uniform(-size, size, 3)
    return T


def own_distance(a: Solid, b: Solid, T_a: np.ndarray, T_b: np.ndarray, enough: float, little: float) -> float:
    both = packed([Body("a", a, np.eye(4)), Body("b", b, np.eye(4))])
    vertices = [solid.corners if isinstance(solid, Hull) else np.zeros((0, 3)) for solid in (a, b)]
    span = np.array([[0, len(vertices[0])], [len(vertices[0]), len(vertices[1])]])
    way, room = (T_a[:3, 3] - T_b[:3, 3])[None].copy(), np.zeros((4, 9))
    return solids_distance(
        both.kind, both.size, span, np.vstack([*vertices, np.zeros((1, 3))]), np.stack([T_a, T_b]), 0, 1,
        enough, little, way, 0, room,
    )  # fmt: skip


@pytest.mark.slow
def test_distances_of_solids_are_those_of_coal() -> None:
    rng = np.random.default_rng(0)
    apart = 0
    for _ in range(300):
        a, b, T_a, T_b = a_solid(rng), a_solid(rng), a_pose(rng, 0.3), a_pose(rng, 0.3)
        own, known = own_distance(a, b, T_a, T_b, np.inf, -np.inf), coal_distance(a, T_a, b, T_b)
        if known > 1e-4:
            apart += 1
            assert own == pytest.approx(known, rel=1e-3, abs=1e-5)
            assert own <= known + 1e-5
            assert own_distance(a, b, T_a, T_b, 0.5 * known, -np.inf) >= 0.5 * known
            assert own_distance(a, b, T_a, T_b, np.inf, 2.0 * known) <= 2.0 * known
        elif known < -1e-4:
            assert own < 1e-6
    assert apart > 100


@pytest.fixture(scope="module")
def problem() -> Problem:
    return load_problem("cylinder_logo", ["layers.count=1"])


def at(x: float, y: float, z: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


@pytest.fixture(scope="module")
def scene(problem: Problem) -> tuple[Cell, Obstacles]:
    """An arm with links, a post, a block on the part, a mesh with a hollow, and a part of points that come in time."""
    rng = np.random.default_rng(3)
    corner = np.array([Box((0.1, 0.3, 0.1)), Box((0.3, 0.1, 0.1))], dtype=object)
    hollow = [triangles_of(solid) for solid in corner]
    mesh = Mesh(np.vstack([hollow[0][0], hollow[1][0]]), np.vstack([hollow[0][1], hollow[1][1] + len(hollow[0][0])]))
    fixtures = (Body("post", Frustum(0.03, 0.02, 0.6), at(0.5, 0.3, 0.3)), Body("corner", mesh, at(0.3, -0.4, 0.6)))
    cell = with_bodies(build_cell(problem), fixtures, (Body("block", Box((0.05, 0.1, 0.2)), at(0.1, 0.1, 0.1)),))
    part = point_tree(rng.uniform(-0.1, 0.1, (40, 3)), 1e-3, rng.uniform(0.0, 10.0, 40))
    return cell, _assembled(cell, Around(2e-3, 5e-3, TipRoom(np.full(12, 0.5e-3), np.zeros(12)), part))


def some_postures(cell: Cell, n: int) -> np.ndarray:
    low, high = np.maximum(cell.limits.q_min, -2.5), np.minimum(cell.limits.q_max, 2.5)
    return np.random.default_rng(1).uniform(low, high, (n, len(low)))


def head_point_margin(cell: Cell, body: Placed, point: np.ndarray, tip: np.ndarray, T_world_part: np.ndarray) -> float:
    """Margin of one part of the head and a ball of 1 mm in the part, as the contract has it."""
    place = T_world_part[:3, :3] @ point + T_world_part[:3, 3]
    T = np.eye(4)
    T[:3, 3] = place
    away = np.linalg.norm(place - tip)
    return coal_distance(body.solid, body.T, Capsule(1e-3, 0.0), T) - min(2e-3, TIP_SLOPE * away - 0.5e-3)


def test_postures_without_their_times_or_joints_are_refused(scene: tuple[Cell, Obstacles]) -> None:
    cell, obstacles = scene
    q = some_postures(cell, 3)
    for postures, now in ((q, 0.5), (q, np.zeros(2)), (q[:, :5], np.zeros(3)), (q[0], np.zeros(1))):
        with pytest.raises(InputError, match=r"postures have shape .*, times"):
            obstacles.margins(postures, now, np.inf)  # type: ignore[arg-type]


def test_margins_are_those_of_brute_force(scene: tuple[Cell, Obstacles]) -> None:
    cell, obstacles = scene
    table = obstacles.table
    assert {"post", "block", "link 2", "nozzle", "print head"} <= set(obstacles.bodies)
    assert "corner" in obstacles.trees
    q, now = some_postures(cell, 30), np.linspace(0.0, 10.0, 30)
    margin, which = obstacles.margins(q, now, np.inf)
    points, times = table.points[: table.first[0, 1]], table.time[: table.first[0, 1]]
    seen = set()
    for i in range(len(q)):
        bodies = placed(cell, q[i])
        T_world_part = cell.holder.poses(q[i : i + 1, len(cell.arm) :])[0]
        tip = cell.arm.poses(q[i : i + 1, : len(cell.arm)])[0, :3, 3]
        known = np.inf
        for k, (a, b) in enumerate(table.pair):
            one, other = bodies[obstacles.bodies[a], a], bodies[obstacles.bodies[b], b]
            known = min(known, coal_distance(one.solid, one.T, other.solid, other.T) - table.needed[k])
        for k, (a, t) in enumerate(table.look):
            if t == 0 and table.head_on_part[k]:
                body = bodies[obstacles.bodies[a], a]
                there = points[times < now[i]]
                near = [head_point_margin(cell, body, p, tip, T_world_part) for p in there]
                known = min(known, *near) if near else known
        if which[i] < len(table.pair) or table.head_on_part[which[i] - len(table.pair)]:
            assert margin[i] == pytest.approx(known, rel=2e-3, abs=2e-5) or max(margin[i], known) < -1.9e-3
        else:
            assert margin[i] <= known + 2e-5
        seen.add(obstacles.names(int(which[i])))
    assert len(seen) >= 3


def test_what_is_printed_later_is_not_there_yet(scene: tuple[Cell, Obstacles]) -> None:
    cell, obstacles = scene
    q = some_postures(cell, 400)
    early, _ = obstacles.margins(q, np.zeros(400), 0.2)
    late, which = obstacles.margins(q, np.full(400, 10.0), 0.2)
    assert (np.maximum(late, -SUNK) <= np.maximum(early, -SUNK)).all()
    nearer = late < early
    assert nearer.any()
    assert all("part or print" in obstacles.names(int(k)) for k in which[nearer])


def test_slopes_are_those_of_differences(scene: tuple[Cell, Obstacles]) -> None:
    cell, obstacles = scene
    n, rows, nj = 80, 3, len(cell.home)
    q, now, wanted = some_postures(cell, n), np.full(n, 5.0), np.ones(n, dtype=np.bool_)

    def margins(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        margin, slope = np.empty((n, rows)), np.empty((n, rows, nj))
        which = np.empty((n, rows), dtype=np.int64)
        nearest_margins(obstacles.table, q, now, wanted, 0.3, 0.3, margin, slope, which)
        order = np.argsort(which, axis=1)
        return (
            np.take_along_axis(margin, order, 1), np.take_along_axis(slope, order[..., None], 1),
            np.take_along_axis(which, order, 1),
        )  # fmt: skip

    margin, slope, which = margins(q)
    first = margin.min(axis=1)
    least, _ = obstacles.margins(q, now, 0.3)
    assert np.maximum(first, -SUNK) == pytest.approx(np.maximum(least, -SUNK), abs=1e-6)
    h, checked = 1e-4, 0
    pairs, looks = obstacles.table.pair, obstacles.table.look
    for j in range(nj):
        step = np.zeros(nj)
        step[j] = h
        (up, _, same_up), (down, _, same_down) = margins(q + step), margins(q - step)
        clear = (which == same_up) & (which == same_down) & (which >= 0) & (margin > 1e-3)
        # the tip moves in a difference, while slopes are for a tip that stays on the part: there the whole is needed
        own = np.array([k >= len(pairs) and looks[k - len(pairs)][1] == 0 for k in which.ravel()]).reshape(which.shape)
        clear &= ~own
        checked += int(clear.sum())
        off = np.abs((up - down) / (2.0 * h) - slope[..., j])[clear]
        assert np.quantile(off, 0.9) < 2e-3  # where the nearest place jumps from edge to edge there is no slope
    assert checked > 300


def test_points_stand_for_their_surface() -> None:
    rng = np.random.default_rng(0)
    corners = rng.uniform(-0.05, 0.05, (6, 3, 3))
    clearance = 3e-3
    points, radius = surface_points(corners, clearance)
    for _ in range(200):
        a, b = rng.uniform(0.0, 1.0, 2)
        share = np.array([1 - np.sqrt(a), np.sqrt(a) * (1 - b), b * np.sqrt(a)])
        triangle = corners[rng.integers(6)]
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        place = share @ triangle + clearance * normal / np.linalg.norm(normal)
        assert (np.linalg.norm(points - place, axis=1) - radius).min() <= clearance + 1e-9


def test_a_long_thin_facet_has_few_points() -> None:
    """One of a profile of 3 m, 2 mm wide: 1.1 million, where its longest side is divided and all of it is filled so."""
    points, radius = surface_points(np.array([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 2e-3, 0.0]]]), 2e-3)
    assert 3.0 / 2e-3 < len(points) < 10_000
    assert radius.max() < 1e-3


def test_points_of_a_mesh_are_laid_once(scene: tuple[Cell, Obstacles]) -> None:
    """They are in the mesh's own frame, wherever the part stands; nearer than that they are others."""
    cell, obstacles = scene
    elsewhere = obstacles.of(cell)
    assert obstacles.around is not None and elsewhere.around is not None
    assert obstacles.around.meshes
    for (_, here), (_, there) in zip(obstacles.around.meshes, elsewhere.around.meshes, strict=True):
        assert here is there
    nearer = obstacles.with_nozzle_at(cell, 1e-3)
    assert nearer is not None and nearer.around is not None
    assert (nearer.around.meshes[0][1].radius > obstacles.around.meshes[0][1].radius).all()


def test_nothing_is_its_own_obstacle(scene: tuple[Cell, Obstacles]) -> None:
    """Pairs that are built together are not looked at, nor what does not move against what does not."""
    _, obstacles = scene
    frames = obstacles.table.frame
    for a, b in obstacles.table.pair:
        assert frames[a] != frames[b]
        assert {obstacles.bodies[a], obstacles.bodies[b]} != {"link 1", "link 2"}
    names = [set(obstacles.names(k)) for k in range(len(obstacles.table.pair))]
    assert {"post", "block"} in names
    assert {"nozzle", "block"} not in names  # it is among the part's points


# --- the search -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tasks(problem: Problem) -> tuple[NozzleTask, ...]:
    return tasks_of(problem, build_toolpath(problem))[:2]


def least(cell: Cell, fixture: Body, paths: tuple[JointPath, ...]) -> float:
    """Least distance of a fixture from arm and head along paths, by coal."""
    out = np.inf
    for path in paths:
        for q in path.q[::20]:
            for (name, _), body in placed(cell, q).items():
                if name != fixture.name:
                    out = min(out, coal_distance(body.solid, body.T, fixture.solid, fixture.T_frame_solid))
    return out


def with_a_post_in_the_way(bare: Cell, unaware: tuple[JointPath, ...]) -> tuple[Cell, Body]:
    """The cell with a post where the print head passes half-way along the first path."""
    q = unaware[0].q[len(unaware[0].q) // 2]
    head = next(body for (name, _), body in placed(bare, q).items() if name == "print head")
    post = Body("post", Capsule(0.01, 0.1), at(*(head.T[:3, 3] + [0.0, 0.0, 0.03])))
    return replace(bare, fixtures=(post,)), post


@pytest.mark.slow
def test_looking_where_routes_lead_finds_the_route_among_clear_nodes(
    problem: Problem, tasks: tuple[NozzleTask, ...]
) -> None:
    bare = with_bodies(build_cell(problem))
    cell, _ = with_a_post_in_the_way(bare, ladder(bare, tasks, problem.resolve))
    obstacles = obstacles_of(problem, cell, build_toolpath(problem))
    demand, nodes = coarse_nodes(cell, tasks, problem.resolve, obstacles=obstacles)
    search = ClearSearch(cell, demand, nodes.grid, problem.resolve.min_sigma, obstacles)
    everything = ClearSearch(cell, demand, nodes.grid, problem.resolve.min_sigma, obstacles)
    everything.look(np.arange(len(demand.rung)))
    (found, _), (expected, _) = search.best(), everything.best()
    assert found is not None and expected is not None
    assert found.price == expected.price
    for name in ("roll", "holder", "branch"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    free, _ = best_route(evaluate(cell, demand, nodes.grid, problem.resolve.min_sigma), demand, cell.limits)
    assert free is not None and free.price < expected.price, "the post is in nobody's way"
    seen = np.isfinite(search.nodes.price)
    assert not (np.isfinite(nodes.price) & ~seen).any()
    assert (seen & ~np.isfinite(nodes.price)).any(), "everything was looked at"


@pytest.mark.slow
def test_the_ladder_keeps_clear_of_a_post(problem: Problem, tasks: tuple[NozzleTask, ...]) -> None:
    bare = with_bodies(build_cell(problem))
    unaware = ladder(bare, tasks, problem.resolve)
    cell, post = with_a_post_in_the_way(bare, unaware)
    assert least(cell, post, unaware) < 0.0
    aware = ladder(cell, tasks, problem.resolve, obstacles_of(problem, cell, build_toolpath(problem)))
    assert least(cell, post, aware) > problem.collision.nozzle - 2e-4


@pytest.mark.slow
def test_a_refusal_names_what_is_in_the_way(problem: Problem, tasks: tuple[NozzleTask, ...]) -> None:
    bare = with_bodies(build_cell(problem))
    T_world_part = bare.T_world_holder
    middle = T_world_part @ np.append(tasks[0].tip[0] + 0.09 * -tasks[0].frames[0, :, 2], 1.0)
    ring = Body("cage", Box((2.0, 2.0, 0.01)), at(0.0, 0.0, float(middle[2]) + 0.05))
    cell = replace(bare, fixtures=(ring,))
    with pytest.raises(Refusal, match=r"collision of .* with cage: .* lacks [\d.]+ mm of clearance") as refused:
        ladder(cell, tasks, problem.resolve, obstacles_of(problem, cell, build_toolpath(problem)))
    assert refused.value.bead is not None
    assert refused.value.point_mm is not None
