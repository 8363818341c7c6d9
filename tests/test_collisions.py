"""Eleven planted collisions, each found with the right bodies named, and beside each what is nearly one and is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from collision_scenes import Piece, between, laying, look, postures, scene, straight_bead, upright

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.cell.cell import Cell
from planner.cell.solids import Body, packed, triangles_of
from planner.collision.point_tree import solid_distance
from planner.collision.print_body import print_body, standing
from planner.collision.scene import HOLDER, PART, collision_bodies, obstacles_of
from planner.plan import TRAVEL
from planner.toolpath.bead import Bead, Toolpath
from planner.verify.bodies import HEAD, CellBodies, CheckedBody, pairs
from planner.verify.collision import check_start, print_pairs, sweep

NOZZLE = "nozzle clear of part and print"
ARM = "arm clear of part and print"
ROBOTS = "robots clear of each other and of fixtures"
BED = "  bed_mm: [560, 0, 290]\n"
TABLE = "  positioner: {robot: irbp_a250, origin_mm: [560, 0, 290], part_mm: [0, 0, 60], free: [rotation]}\n"
ELSEWHERE = "  bed_mm: [-500, 600, 100]\n"
WALL = "  fixtures: {wall: {box_mm: [%s], centre_mm: [%s]}}\n"


class _Nowhere:
    """A surface that nothing asks for: these scenes give facets."""

    def before(self, bead: int) -> _Nowhere:
        return self


def toolpath_of(beads: list[Bead], solid: Array | None = None) -> Toolpath:
    return Toolpath(tuple(beads), _Nowhere(), None, (), solid)  # type: ignore[arg-type]


def one_bead() -> Toolpath:
    """A bead 40 mm long on the plane z = 0."""
    return toolpath_of([straight_bead(np.array([-0.02, 0.0, 0.5e-3]), np.array([0.02, 0.0, 0.5e-3]))])


def placed(cell: Cell, name: str, q: Array) -> tuple[CheckedBody, Array]:
    """A body and the corners (n, 3) of its surface in the world."""
    bodies = CellBodies.of(cell)
    thing = next(each for each in bodies.things if each.name == name)
    T = bodies.poses(q[None])[0][thing.carrier] @ thing.T_carrier_solid
    vertices = triangles_of(thing.solid)[0]
    return thing, vertices @ T[:3, :3].T + T[:3, 3]


def millimetres(values: Array) -> str:
    return ", ".join(f"{1e3 * value:.3f}" for value in values)


def swing(cell: Cell, a: list[float], b: list[float], step: float = 0.004) -> list[Piece]:
    """From one posture [deg] to another in steps [rad]."""
    return [Piece(between(np.radians(a), np.radians(b), step))]


def turned_by_a_table(radius: float) -> tuple[Toolpath, list[Piece]]:
    """A wall at a radius [m] of a table that makes a whole turn, while the arm stands aside."""
    return wall_that_moves(radius, np.linspace(0.0, 2.0 * np.pi, 400)[:, None])


def wall_that_moves(radius: float, q: Array) -> tuple[Toolpath, list[Piece]]:
    """A wall 90 mm high at x = radius [m], printed at the first of a holder's postures q (n, k), then moved through all."""
    ends = np.array([[radius, -0.02, 0.0], [radius, 0.02, 0.0]])
    beads = [straight_bead(*(ends + [0.0, 0.0, z]), f"wall {k}", k) for k, z in enumerate(5e-3 * np.arange(1, 19))]
    beads = [replace(bead, height=np.full(60, 5e-3), width=np.full(60, 5e-3)) for bead in beads]
    still = np.radians([90.0, 0, 0, 0, 90, 0])
    way = np.column_stack([np.tile(still, (len(q), 1)), q])
    laid = [Piece(way[:1], i, np.array([bead.length])) for i, bead in enumerate(beads)]
    return toolpath_of(beads), [*laid, Piece(way)]


@pytest.mark.slow
def test_1_an_arm_link_and_a_fixture(tmp_path: Path) -> None:
    a, hit, b = [-40.0, 20, 10, 0, 60, 0], [10.0, 20, 10, 0, 60, 0], [40.0, 20, 10, 0, 60, 0]
    _, cell = scene(tmp_path, ELSEWHERE)
    centre = placed(cell, "link_4 (forearm)", np.radians(hit))[1].mean(axis=0)
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % ("20, 20, 20", millimetres(centre)))
    found = look(problem, cell, one_bead(), swing(cell, a, b))
    assert found.failed == {ROBOTS}
    worst = found.approaches[0]
    assert {worst.a, worst.b} == {"wall", "link_4 (forearm)"} and worst.distance < 0.0
    assert "wall and link_4 (forearm)" in found.checks[ROBOTS].where
    short = look(problem, cell, one_bead(), swing(cell, a, [-15.0, 20, 10, 0, 60, 0]))
    assert short.failed == set()


@pytest.mark.slow
@pytest.mark.parametrize("carrier", [TABLE, BED], ids=["table", "bed"])
def test_2_the_nozzle_and_a_hollow_fixture(tmp_path: Path, carrier: str) -> None:
    """Inside the trough the nozzle is clear; its convex hull would forbid that."""
    boxes = [([60, 4, 40], [0, -18, 20]), ([60, 4, 40], [0, 18, 20]), ([60, 40, 4], [0, 0, -2])]
    parts = [trimesh.creation.box(size, trimesh.transformations.translation_matrix(at)) for size, at in boxes]
    trimesh.util.concatenate(parts).export(tmp_path / "trough.stl")
    lines = carrier + "  fixtures: {trough: {mesh: trough.stl, centre_mm: [500, 220, 340]}}\n"
    problem, cell = scene(tmp_path, lines)
    T_part_world = np.linalg.inv(cell.T_world_holder)
    rest = tuple(cell.home[6:])

    def along(y: float, low: float = 0.365) -> list[Piece]:
        high = between(np.array([0.48, y, 0.45]), np.array([0.48, y, low]), 8e-4)
        down = [high, between(high[-1], np.array([0.52, y, low]), 8e-4)]
        tips = np.concatenate(down) @ T_part_world[:3, :3].T + T_part_world[:3, 3]
        return [Piece(postures(cell, upright(tips), rest))]

    inside = look(problem, cell, one_bead(), along(0.220))
    assert inside.failed == set()
    assert 8.0 < inside.metrics["clearance_min_mm"] < 12.0  # 16 mm to the walls, less the nozzle's 4.6 mm and the rest
    astray = look(problem, cell, one_bead(), along(0.232))
    name = ROBOTS if carrier == TABLE else NOZZLE
    assert astray.failed == {name}
    worst = astray.approaches[0]
    assert {worst.a, worst.b} == {"nozzle", "trough"} and worst.distance < 1e-3


@pytest.mark.slow
def test_3_the_head_and_a_wall_of_the_part(tmp_path: Path) -> None:
    """The slender nozzle passes beside the wall, the tube above it does not."""

    def beside(y: float) -> Toolpath:
        wall = trimesh.creation.box([0.06, 0.004, 0.06], trimesh.transformations.translation_matrix([0.0, y, 0.03]))
        floor = trimesh.creation.box([0.1, 0.1, 0.01], trimesh.transformations.translation_matrix([0.0, 0.0, -0.005]))
        beads = list(one_bead().beads)
        return toolpath_of(beads, np.concatenate([wall.triangles, floor.triangles]))

    problem, cell = scene(tmp_path, BED)
    for y, fails in ((0.014, True), (0.022, False)):
        toolpath = beside(y)
        found = look(problem, cell, toolpath, [laying(cell, toolpath, 0)])
        assert found.failed == ({NOZZLE} if fails else set())
        if fails:
            worst = found.approaches[0]
            assert (worst.a, worst.b) == ("print head", "part") and -0.005 < worst.distance < 0.0


@pytest.mark.slow(keep=("False",))
@pytest.mark.parametrize("wall_first", [True, False])
def test_4_the_nozzle_and_a_wall_that_stands_already(tmp_path: Path, wall_first: bool) -> None:
    """A low bead beside a wall: in the other order the same beads are laid without touching anything."""
    y, layers = 2.5e-3, 24
    wall = [
        straight_bead(np.array([-0.02, y, 0.5e-3 * k]), np.array([0.02, y, 0.5e-3 * k]), f"wall {k}", k - 1)
        for k in range(1, layers + 1)
    ]
    low = list(one_bead().beads)
    beads = wall + low if wall_first else low + wall
    toolpath = toolpath_of(beads)
    problem, cell = scene(tmp_path, BED)
    pieces: list[Piece] = []
    for i in range(len(beads)):
        laid = laying(cell, toolpath, i, speed=0.1)
        if pieces:  # up, across and down
            tips = [toolpath.beads[i - 1].points[-1], toolpath.beads[i].points[0]]
            up = [tip + [0.0, 0.0, 0.02 if wall_first or i > 1 else 0.03] for tip in tips]
            way = [*between(tips[0], up[0], 8e-4), *between(up[0], up[1], 8e-4), *between(up[1], tips[1], 8e-4)]
            pieces.append(Piece(postures(cell, upright(np.array(way)))))
        pieces.append(laid)
    found = look(problem, cell, toolpath, pieces)
    assert found.failed == ({NOZZLE} if wall_first else set())
    if wall_first:
        assert found.approaches[0].a == "nozzle"
        assert found.approaches[0].b in {f"bead {i}" for i in range(layers)}


def test_5_the_forearm_and_a_table(tmp_path: Path) -> None:
    a, b = [0.0, 40, 0, 0, 60, 0], [0.0, 75, 10, 0, 60, 0]
    _, cell = scene(tmp_path, ELSEWHERE)
    corners = placed(cell, "link_4 (forearm)", np.radians(b))[1]
    middle = corners.mean(axis=0)
    top = corners[:, 2].min() + 0.004  # the forearm's lowest place dips into it
    size = np.array([0.04, 0.3, 0.02])
    lowest = corners[corners[:, 2].argmin()]
    centre = np.array([lowest[0], middle[1], top - 0.5 * size[2]])
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % (millimetres(size), millimetres(centre)))
    found = look(problem, cell, one_bead(), swing(cell, a, b))
    assert ROBOTS in found.failed
    worst = found.approaches[0]
    assert {worst.a, worst.b} == {"wall", "link_4 (forearm)"}
    assert look(problem, cell, one_bead(), swing(cell, a, [0.0, 50, 3, 0, 60, 0])).failed == set()


def test_6_what_the_table_carries_and_the_arms_foot(tmp_path: Path) -> None:
    lines = "  positioner: {robot: irbp_a250, origin_mm: [500, 0, 200], free: [rotation]}\n"
    clamp = "  fixtures: {clamp: {box_mm: [80, 60, 60], centre_mm: [%d, 0, 60], on: part}}\n"
    for place, fails in ((330, True), (200, False)):
        problem, cell = scene(tmp_path, lines + clamp % place)
        still = np.radians([90.0, 0, 0, 0, 90, 0])
        q = np.column_stack([np.tile(still, (400, 1)), np.linspace(0.0, np.pi, 400)])
        found = look(problem, cell, one_bead(), [Piece(q)])
        assert found.failed == ({ROBOTS} if fails else set())
        if fails:
            worst = found.approaches[0]
            assert "clamp" in (worst.a, worst.b)
            assert "base_link" in worst.a + worst.b or "link_1" in worst.a + worst.b


@pytest.mark.parametrize(("height", "what"), [(200, "link_1"), (20, "base_link")], ids=["arm", "foot"])
def test_6_what_the_table_has_printed_and_the_arms_foot(tmp_path: Path, height: int, what: str) -> None:
    """In one whole turn: at both of its ends the print is on the far side of the table."""
    lines = f"  positioner: {{robot: irbp_a250, origin_mm: [500, 0, {height}], free: [rotation]}}\n"
    problem, cell = scene(tmp_path, lines)
    for radius, fails in ((0.365, True), (0.25, False)):
        found = look(problem, cell, *turned_by_a_table(radius))
        assert found.failed == ({ARM} if fails else set())
        if fails:
            worst = found.approaches[0]
            assert what in worst.a and worst.b.startswith("bead") and worst.distance < 0.0


@pytest.mark.parametrize("mesh", [False, True], ids=["box", "mesh"])
def test_6_what_the_table_has_printed_and_a_fixture(tmp_path: Path, mesh: bool) -> None:
    trimesh.creation.box([20, 20, 60]).export(tmp_path / "post.stl")
    post = WALL % ("20, 20, 60", "500, -360, 250")
    post = post.replace("box_mm: [20, 20, 60]", "mesh: post.stl") if mesh else post
    problem, cell = scene(
        tmp_path, "  positioner: {robot: irbp_a250, origin_mm: [500, 0, 200], free: [rotation]}\n" + post
    )
    for radius, fails in ((0.36, True), (0.3, False)):
        found = look(problem, cell, *turned_by_a_table(radius))
        assert found.failed == ({ARM} if fails else set())
        if fails:
            assert found.approaches[0].a == "wall" and found.approaches[0].b.startswith("bead")


def test_6_a_hollow_fixture_is_said_not_to_be_held_against_a_print_that_moves(tmp_path: Path) -> None:
    trimesh.creation.annulus(10.0, 15.0, 60.0).export(tmp_path / "pipe.stl")
    pipe = "  fixtures: {pipe: {mesh: pipe.stl, centre_mm: [500, -360, 250]}}\n"
    for carrier, told in ((TABLE, True), (BED, False)):
        problem, cell = scene(tmp_path, carrier + pipe)
        still = Piece(np.tile(cell.home, (3, 1)))
        assert (
            "not checked: print and pipe, hollow" in look(problem, cell, one_bead(), [still]).checks[ARM].where
        ) == told


def test_7_the_second_arm_and_what_is_printed_on_it(tmp_path: Path) -> None:
    """Its wrist bends so far that the wall, which is 0.15 m beside the flange, comes to the forearm, and back."""
    lines = (
        "  positioner:\n    robot: irb1200_09\n    base_mm: [1500, 0, 0]\n    turn_deg: 180\n"
        "    free: [joint_5, joint_6]\n    held_deg: {joint_2: 40, joint_3: 10}\n"
    )
    problem, cell = scene(tmp_path, lines)
    for degrees, fails in ((125.0, True), (80.0, False)):
        bent = np.radians(degrees) * np.sin(np.linspace(0.0, np.pi, 400))
        toolpath, moved = wall_that_moves(0.15, np.column_stack([bent, np.zeros(400)]))
        found = look(problem, cell, toolpath, moved)
        assert found.failed == ({ARM} if fails else set())
        obstacles, q = obstacles_of(problem, cell, toolpath), moved[-1].q
        planned, which = obstacles.margins(q, np.full(len(q), float(len(toolpath.beads))), np.inf)
        assert (planned.min() < 0.0) == fails
        if fails:
            worst = found.approaches[0]
            assert worst.a.startswith("holder link_4") and worst.b.startswith("bead")
            body, part = obstacles.names(int(which[np.argmin(planned)]))
            assert body.startswith("link_4") and part == PART
            assert planned.min() == pytest.approx(worst.distance - worst.need, abs=1e-3)  # so deep, any point will do


@pytest.mark.parametrize("tilted", [False, True], ids=["turned", "bent"])
def test_7_what_the_second_arm_never_brings_near_needs_no_look(tmp_path: Path, tilted: bool) -> None:
    """Joint 6 turns the wall about its own axis, far from all links; joint 5 brings it to the forearm."""
    free, held = ("joint_5, joint_6", "") if tilted else ("joint_6", ", joint_5: 20")
    lines = (
        "  positioner:\n    robot: irb1200_09\n    base_mm: [1500, 0, 0]\n    turn_deg: 180\n"
        f"    free: [{free}]\n    held_deg: {{joint_2: 40, joint_3: 10{held}}}\n"
    )
    problem, cell = scene(tmp_path, lines)
    k = len(cell.holder)
    toolpath, _ = wall_that_moves(0.15, np.zeros((2, k)))
    obstacles, things = obstacles_of(problem, cell, toolpath), collision_bodies(cell)
    table = obstacles.table
    at_part = [things[body].whose for body, tree in table.look if tree == 0]
    among = [{things[a].whose, things[b].whose} for a, b in table.pair]
    assert (HOLDER in at_part) == tilted
    body = print_body(toolpath, standing(cell))
    checked = CellBodies.of(cell)
    own = [pair for pair in print_pairs(checked, 5e-3, body) if checked.things[pair.a].kind == "holder"]
    low, high = np.maximum(cell.limits.q_min, -np.pi)[-k:], np.minimum(cell.limits.q_max, np.pi)[-k:]
    q = np.column_stack([np.tile(cell.home[:6], (500, 1)), np.random.default_rng(5).uniform(low, high, (500, k))])
    swept = sweep(checked, own, q, body, np.full(500, float(len(toolpath.beads))))
    assert own and ((swept.distance < 5e-3).any()) == tilted
    assert tilted or {HOLDER} not in among


def test_7_the_second_arm_and_the_first(tmp_path: Path) -> None:
    lines = (
        "  positioner:\n    robot: irb1200_09\n    base_mm: [1250, 0, 0]\n    turn_deg: 180\n    free: [joint_1]\n"
        "    held_deg: {joint_2: 40, joint_3: 10, joint_5: 20}\n"
    )
    problem, cell = scene(tmp_path, lines)
    still = np.radians([0.0, 30, 10, 0, 20, 0])
    q = np.column_stack([np.tile(still, (500, 1)), np.linspace(np.radians(90.0), 0.0, 500)])
    found = look(problem, cell, one_bead(), [Piece(q)])
    assert ROBOTS in found.failed
    worst = found.approaches[0]
    ours = ("arm ", "nozzle", "print head")
    assert sum(name.startswith(ours) for name in (worst.a, worst.b)) == 1
    assert sum(name.startswith("holder ") for name in (worst.a, worst.b)) == 1
    away = look(problem, cell, one_bead(), [Piece(q[:200])])
    assert away.failed == set()


def test_8_the_head_and_the_own_upper_arm(tmp_path: Path) -> None:
    """Where the head reaches into the upper arm by the points of its surface, it is found by coal."""
    problem, cell = scene(tmp_path, ELSEWHERE, ", head: {rod: {box_mm: [20, 20, 300], centre_mm: [70, 0, -150]}}}")
    bodies = CellBodies.of(cell)
    arm, head = (next(t for t in bodies.things if t.name == name) for name in ("link_2 (upper arm)", "head rod"))
    own = packed([Body(arm.name, arm.solid, np.eye(4))])
    rng = np.random.default_rng(3)
    q = rng.uniform(cell.limits.q_min, cell.limits.q_max, (4000, 6))
    q[:, [0, 1]] = 0.0
    deepest, posture = 0.0, None
    poses = bodies.poses(q)
    surface = triangles_of(head.solid)[0]
    for row, T in zip(q, poses, strict=True):
        T_arm_head = np.linalg.inv(T[arm.carrier] @ arm.T_carrier_solid) @ T[head.carrier] @ head.T_carrier_solid
        points = surface @ T_arm_head[:3, :3].T + T_arm_head[:3, 3]
        least = min(solid_distance(own.kind[0], own.size[0], own.planes, *p) for p in points[::5])
        if -0.02 < least < min(deepest, -0.005):
            deepest, posture = least, row
    assert posture is not None
    found = look(problem, cell, one_bead(), [Piece(between(cell.home, posture, 0.01))])
    assert ROBOTS in found.failed
    pair = {"head rod", "link_2 (upper arm)"}
    met = next(each for each in found.approaches if {each.a, each.b} == pair)
    assert met.distance <= deepest + 1e-3


MOTOR = ", head: {motor: {box_mm: [6, 20, 48], centre_mm: [44, 0, -24]}}}"  # beside the wrist, 3 mm off it


def test_8_the_head_and_the_link_before_the_flange(tmp_path: Path) -> None:
    """Joint 6 turns a motor beside the wrist into an end of joint 5; the tube that is assumed lies before the wrist for good."""
    problem, cell = scene(tmp_path, ELSEWHERE, MOTOR)
    level = [0.0, 20, 10, 0, 0]
    for turn, fails in ((90.0, True), (20.0, False)):
        found = look(problem, cell, one_bead(), swing(cell, [*level, 0.0], [*level, turn]))
        assert found.failed == ({ROBOTS} if fails else set())
        if fails:
            worst = found.approaches[0]
            assert {worst.a, worst.b} == {"head motor", "link_5 (wrist joint)"} and worst.distance < -1e-3
    problem, cell = scene(tmp_path, ELSEWHERE)
    bodies = CellBodies.of(cell)
    met = {bodies.things[pair.a].link for pair in pairs(bodies, 2e-3, 5e-3) if bodies.things[pair.b].kind == HEAD}
    assert "link_4" in met and "link_5" not in met


def test_8_what_comes_less_far_apart_than_is_asked_for(tmp_path: Path) -> None:
    """The motor is 18 mm off the end of joint 5 at most, and never farther than 3 mm off the wrist."""
    problem, cell = scene(tmp_path, ELSEWHERE, MOTOR)
    bodies = CellBodies.of(cell)
    found: dict[frozenset[str], float] = {}
    for pair in pairs(bodies, 20e-3, 5e-3):
        found[frozenset(bodies.things[k].name for k in (pair.a, pair.b))] = pair.need
    keep = problem.collision.model_copy(update={"nozzle": 20e-3})
    obstacles = obstacles_of(problem.model_copy(update={"collision": keep}), cell, one_bead())
    table = obstacles.table
    planned = {
        frozenset(obstacles.bodies[k] for k in pair): need for pair, need in zip(table.pair, table.needed, strict=True)
    }
    apart, joined = (frozenset({"head motor", f"link_5 ({name})"}) for name in ("wrist joint", "wrist"))
    assert found[apart] == planned[apart] == 5e-3
    assert joined not in found and joined not in planned


@pytest.mark.parametrize("carrier", [TABLE, BED], ids=["table", "bed"])
def test_9_a_thin_wall_between_two_samples(tmp_path: Path, carrier: str) -> None:
    """A needle of 0.3 mm passes a wall of 1 mm in steps of 4 mm: at no sample it is nearer than 1 mm."""
    needle = ", profile_mm: [[0, 0.3], [80, 0.3]]}"
    problem, cell = scene(tmp_path, carrier + WALL % ("1, 60, 20", "500, 220, 350"), needle)
    T_part_world = np.linalg.inv(cell.T_world_holder)
    for height, fails in ((0.355, True), (0.365, False)):
        x = np.arange(0.486, 0.5141, 0.004)
        tips = np.column_stack([x, np.full(len(x), 0.22), np.full(len(x), height)])
        tips = tips @ T_part_world[:3, :3].T + T_part_world[:3, 3]
        found = look(problem, cell, one_bead(), [Piece(postures(cell, upright(tips), tuple(cell.home[6:])))], dt=0.02)
        assert found.failed == ({ROBOTS if carrier == TABLE else NOZZLE} if fails else set())
        if fails:
            worst = found.approaches[0]
            assert {worst.a, worst.b} == {"nozzle", "wall"} and worst.distance < 0.5e-3
            assert np.abs(x - 0.5).min() > 1.5e-3  # no sample is in the wall


def test_10_the_arm_and_the_finished_print(tmp_path: Path) -> None:
    """The same way is clear before the wall is printed."""
    heights = np.arange(1, 41) * 5e-3
    beads = [
        straight_bead(np.array([-0.05, 0.2, z]), np.array([0.05, 0.2, z]), f"wall {k}", k)
        for k, z in enumerate(heights)
    ]
    beads = [replace(bead, height=np.full(60, 5e-3), width=np.full(60, 5e-3)) for bead in beads]
    toolpath = toolpath_of(beads)
    problem, cell = scene(tmp_path, "  bed_mm: [420, 0, 250]\n")
    a, b = [0.0, 40, 0, 0, 50, 0], [45.0, 40, 0, 0, 50, 0]
    way = between(np.radians(a), np.radians(b), 0.004)
    n = len(beads)
    stay = Piece(np.tile(way[:1], (n, 1)))
    before = look(problem, cell, toolpath, [Piece(way), Piece(way[::-1])])
    assert before.failed == set()
    laid = [Piece(way[:1], i, np.array([beads[i].length])) for i in range(n)]
    after = look(problem, cell, toolpath, [*laid, stay, Piece(way)])
    assert ARM in after.failed
    worst = next(each for each in after.approaches if each.b.startswith("bead"))
    assert worst.a.startswith("link_") and worst.distance < 5e-3
    assert TRAVEL == -1 and worst.sample >= n


def test_11_the_nozzles_face_and_a_sheet_under_a_bead(tmp_path: Path) -> None:
    """The bead is 6 mm wide and 2 mm high: near its tip the nozzle may come 3 mm into what is printed, of a sheet 1 mm."""
    bead = straight_bead(np.array([-0.02, 0.0, 2e-3]), np.array([0.02, 0.0, 2e-3]))
    toolpath = toolpath_of([replace(bead, width=np.full(60, 6e-3), height=np.full(60, 2e-3))])
    for top, fails in ((3.5, True), (2.7, False)):
        sheet = f"  fixtures: {{sheet: {{box_mm: [20, 20, 1], centre_mm: [0, 0, {top - 0.5}], on: part}}}}\n"
        problem, cell = scene(tmp_path, BED + sheet, ", profile_mm: [[0, 4], [20, 12]]}")
        laid = laying(cell, toolpath, 0)
        found = look(problem, cell, toolpath, [laid])
        assert found.failed == ({NOZZLE} if fails else set())
        planned, _ = obstacles_of(problem, cell, toolpath).margins(laid.q, np.zeros(len(laid.q)), np.inf)
        assert (planned.min() < 0.0) == fails
        if fails:
            check, worst = found.checks[NOZZLE], found.approaches[0]
            assert (check.worst, check.limit) == pytest.approx((-1.5, -1.0), abs=0.02)
            assert (worst.a, worst.b) == ("nozzle", "sheet") and worst.distance == pytest.approx(-1.5e-3, abs=2e-5)
            assert planned.min() == pytest.approx(-0.5e-3, abs=2e-5)


def test_a_start_posture_in_a_table_is_refused_before_anything_is_planned(tmp_path: Path) -> None:
    _, cell = scene(tmp_path, ELSEWHERE)
    corners = placed(cell, "link_4 (forearm)", cell.home)[1]
    centre = corners.mean(axis=0)
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % ("30, 30, 30", millimetres(centre)))
    with pytest.raises(InputError, match=r"wall and link_4 \(forearm\) are [0-9.]+ mm inside each other") as caught:
        check_start(problem, cell)
    assert caught.value.field == "cell.home_deg"
    near = np.array([centre[0], centre[1], corners[:, 2].min() - 0.018])
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % ("30, 30, 30", millimetres(near)))
    with pytest.raises(InputError, match=r"are only 3\.0 mm apart in the start posture"):
        check_start(problem, cell)
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % ("30, 30, 30", millimetres(near - [0.0, 0.0, 0.0021])))
    check_start(problem, cell)


def test_a_robot_without_bodies_is_said_not_to_be_checked(tmp_path: Path) -> None:
    """The wall of the first scene is where the forearm would be: without bodies nobody can know."""
    a, hit, b = [-40.0, 20, 10, 0, 60, 0], [10.0, 20, 10, 0, 60, 0], [40.0, 20, 10, 0, 60, 0]
    _, cell = scene(tmp_path, ELSEWHERE)
    centre = placed(cell, "link_4 (forearm)", np.radians(hit))[1].mean(axis=0)
    problem, cell = scene(tmp_path, ELSEWHERE + WALL % ("20, 20, 20", millimetres(centre)))
    bare = replace(cell, arm_robot=replace(cell.arm_robot, bodies=tuple(() for _ in cell.arm_robot.bodies)))
    found = look(problem, bare, one_bead(), swing(bare, a, b))
    assert f"not checked: {cell.arm_robot.name}, without bodies" in found.checks[ROBOTS].where
    assert found.checks[ROBOTS].ok
    some = tuple(() if k in (3, 5) else bodies for k, bodies in enumerate(cell.arm_robot.bodies))
    bare = replace(cell, arm_robot=replace(cell.arm_robot, bodies=some))
    found = look(problem, bare, one_bead(), swing(bare, a, a))
    told = f"not checked: what joint_3, joint_5 of {cell.arm_robot.name} carry, without bodies"
    assert all(told in found.checks[name].where for name in (ARM, ROBOTS))
