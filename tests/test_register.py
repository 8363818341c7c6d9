"""Registration: exact contacts give the exact placement, noise and wrong contacts nearly so, and what is written."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contact_files import MOVED, PART, TURNED, apart, chosen, contacts, scene, scratch
from scipy.spatial.transform import Rotation
from solved import write_small
from test_nozzles import TWO

from benchmarks import registration
from benchmarks.touching import cartesian, from_one_side, misplaced, tips_of, write_contacts
from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.cell.cell import build_cell, frame_from_z, translation
from planner.cell.kinematics.inverse import track
from planner.problem import load_problem, shipped_problems
from planner.problem.rewrite import write_changed
from planner.register import command
from planner.register.command import main
from planner.register.contacts import locate, plate_poses, read_readings, settled
from planner.register.finding import Ask, as_published, plan_contacts, register, scene_of, suggest_next
from planner.register.fitting import FREEDOMS, UNKNOWNS, Placement, looked_for, most_wrong, rows, slopes, split, words
from planner.register.places import TouchPlaces, most_telling, reached, rolls
from planner.register.telling import changes_of, published_lines, rpy_degrees, turntable_lines

# Placement


@pytest.mark.slow
def test_rows_are_the_derivatives_of_residuals() -> None:
    here = scene("fibre_bowl")
    points, q = chosen("fibre_bowl", 12)
    T_world_plate = plate_poses(here.cell, q)
    truth = misplaced(here, MOVED, TURNED, (1.0, 2.0, -1.0))
    tips = tips_of(here, truth, points, np.zeros(12), q)
    centre = np.array([0.01, -0.02, 0.03])

    def residuals(step: Array) -> Array:
        moved = truth.moved(step, centre)
        return here.surface.signed_distance(moved.seen(tips, T_world_plate)) - moved.growth

    seen = truth.seen(tips, T_world_plate)
    np.testing.assert_allclose(seen, points, atol=1e-12)
    J = rows(seen, slopes(here.surface, seen), T_world_plate @ truth.T_plate_part, centre)
    steps = 1e-6 * np.eye(UNKNOWNS)
    expected = np.column_stack([(residuals(s) - residuals(-s)) / 2e-6 for s in steps])
    np.testing.assert_allclose(J, expected, atol=1e-6)
    assert np.abs(expected).max() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "blind"),
    [
        ("fibre_bowl", 8, 1),  # a turn about its axis
        ("hemisphere_honeycomb", 6, 3),  # any turn about the ball's centre
        ("fibre_plane", 5, 3),  # two slides and a turn
        ("fibre_corrugated", 8, 1),  # a slide along the waves
        ("aerofoil_core", 9, None),  # a mesh
        ("curved_plate", 9, None),  # faces of a STEP file
        ("shoehorn", 9, None),
    ],
)
def test_exact_contacts_give_the_exact_placement(tmp_path: Path, name: str, count: int, blind: int | None) -> None:
    here = scene(name)
    truth = misplaced(here, MOVED, TURNED)
    found = register(here, contacts(tmp_path, name, truth, count), Ask())
    assert np.abs(found.fit.residuals).max() < 1e-8
    assert found.fit.kept.all()
    if blind is not None:
        assert len(split(found.fit.columns)[1].T) == blind
    # what is seen is right: the surface is where it really is, at every waypoint
    now, w = found.fit.placement, here.waypoints
    real = truth.seen(now.T_plate_part[:3, :3].dot(w.points.T).T + now.T_plate_part[:3, 3], np.eye(4)[None])
    gap = here.surface.signed_distance(real) - here.surface.signed_distance(w.points)
    assert np.abs(gap).max() < (2e-6 if name != "shoehorn" else 2e-5)
    if blind == 0:
        move, turn = apart(truth, now)
        assert move < 1e-8 and np.abs(turn).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "still"),
    [
        ("fibre_bowl", 12, ("rz",)),
        ("hemisphere_honeycomb", 10, ("rx", "ry", "rz")),
        ("fibre_plane", 10, ("x", "y", "rz")),
        ("fibre_corrugated", 12, ("y",)),
    ],
)
def test_what_contacts_do_not_see_is_left_exactly_as_it_was(
    tmp_path: Path, name: str, count: int, still: tuple[str, ...]
) -> None:
    """A bowl was turned about its own axis by up to 24 degrees, by what seen turns add up to."""
    here = scene(name)
    for seed in (3, 4):
        random = np.random.default_rng(seed)
        truth = misplaced(here, random.normal(0.0, 3.0, 3), random.normal(0.0, 2.0, 3))
        off = random.normal(0.0, 5e-5, count)
        found = register(here, contacts(tmp_path, name, truth, count, off), Ask())
        assert len(found.held) >= 1
        now, centre = found.fit.placement.T_plate_part, found.fit.touch.unknowns.centre
        moved = np.linalg.inv(here.start.T_plate_part) @ now
        way = moved[:3, :3] @ centre + moved[:3, 3] - centre
        turn = Rotation.from_matrix(moved[:3, :3]).as_rotvec()
        gone = dict(zip(FREEDOMS, [*way, *turn], strict=True))
        assert max(abs(gone[freedom]) for freedom in still) < 1e-6
        assert max(map(abs, gone.values())) > 1e-3


def test_a_ball_keeps_its_direction_in_the_problem(tmp_path: Path) -> None:
    here = scene("hemisphere_honeycomb")
    truth = misplaced(here, MOVED, TURNED)
    found = register(here, contacts(tmp_path, "hemisphere_honeycomb", truth, 10), Ask())
    changes = changes_of(here.problem, found.fit.placement, here.start, FREEDOMS)
    assert set(changes) == {"cell.bed_mm"}


@pytest.mark.slow
def test_a_bowl_that_is_not_round_has_no_freedom_left(tmp_path: Path) -> None:
    wide = ("part.ellipsoid.radii_mm=[95, 80, 60]",)
    here = scene("fibre_bowl", *wide)
    truth = misplaced(here, MOVED, TURNED)
    found = register(here, contacts(tmp_path, "fibre_bowl", truth, 12, overrides=wide), Ask())
    move, turn = apart(truth, found.fit.placement)
    assert move < 1e-8 and np.abs(turn).max() < 1e-7
    assert found.held == ()


@pytest.mark.slow
def test_a_bed_is_moved_and_turned(tmp_path: Path) -> None:
    here = scene("aerofoil_core")
    truth = misplaced(here, MOVED, TURNED)
    np.testing.assert_array_equal(here.start.T_plate_part, here.cell.T_world_holder)
    found = register(here, contacts(tmp_path, "aerofoil_core", truth, 12), Ask())
    changes = changes_of(here.problem, found.fit.placement, here.start, Ask().free or ("x", "rx"))
    assert set(changes) == {"cell.bed_mm", "cell.bed_rpy_deg"}


@pytest.mark.slow
def test_noise_is_told_as_it_is(tmp_path: Path) -> None:
    """Over many parts the errors are as large as the standard errors that are told with them."""
    here, points_q = scene("hemisphere_honeycomb"), chosen("hemisphere_honeycomb", 10)
    squares, noises = [], []
    for seed in range(24):
        random = np.random.default_rng(seed)
        off = random.normal(0.0, 5e-5, 10)
        truth = misplaced(here, random.normal(0.0, 3.0, 3))
        found = register(here, contacts(tmp_path, "hemisphere_honeycomb", truth, 10, off), Ask(noise=5e-5))
        centre = np.asarray(here.problem.part.sphere.centre)
        E = np.linalg.inv(truth.T_plate_part) @ found.fit.placement.T_plate_part
        error = E[:3, :3] @ centre + E[:3, 3] - centre
        J = here_columns(found, points_q)
        squares.append(float(error @ J.T @ J @ error) / 5e-5**2)
        noises.append(register(here, tmp_path / "contacts.csv", Ask()).fit.noise)
    assert np.mean(squares) == pytest.approx(3.0, rel=0.45)  # chi squared of three freedoms
    assert np.median(noises) == pytest.approx(5e-5, rel=0.2)


def here_columns(found, points_q) -> Array:
    """How a ball's distance depends on where it is: its normals."""
    return slopes(found.scene.surface, points_q[0])[found.fit.kept]


@pytest.mark.slow(keep=("1",))
@pytest.mark.parametrize("seed", range(6))
def test_wrong_contacts_are_found_and_left_out(tmp_path: Path, seed: int) -> None:
    here, random = scene("fibre_bowl"), np.random.default_rng(seed)
    off = random.normal(0.0, 2e-5, 14)
    wrong = random.choice(14, 3, replace=False)
    off[wrong] += random.uniform(1e-3, 5e-3, 3) * random.choice([-1.0, 1.0], 3)
    truth = misplaced(here, MOVED, TURNED)
    found = register(here, contacts(tmp_path, "fibre_bowl", truth, 14, off), Ask())
    assert set(wrong) <= set(np.flatnonzero(~found.fit.kept))
    assert found.fit.kept.sum() >= 9
    move, turn = apart(truth, found.fit.placement)
    assert move < 0.2e-3 and np.degrees(np.abs(turn[:2])).max() < 0.2


def test_wrong_contacts_are_as_many_as_can_be_told() -> None:
    assert most_wrong(12, 5) == 3
    assert most_wrong(9, 2) == 2
    assert most_wrong(7, 5) == 0  # one to spare tells that something is wrong, but not what
    assert most_wrong(3, 5) == 0


def test_a_known_noise_keeps_what_it_explains(tmp_path: Path) -> None:
    here, truth = scene("fibre_bowl"), misplaced(scene("fibre_bowl"), MOVED)
    file = contacts(tmp_path, "fibre_bowl", truth, 12, [0.15e-3])
    assert not register(here, file, Ask()).fit.kept[0]  # all others are exact
    assert register(here, file, Ask(noise=1e-4)).fit.kept.all()


@pytest.mark.slow
def test_joint_readings_and_places_say_the_same(tmp_path: Path) -> None:
    here = scene("cylinder_logo")
    truth = misplaced(here, (2.0, -1.0))
    points, q = chosen("cylinder_logo", 6)
    tips = tips_of(here, truth, points, np.zeros(6), q)
    one = register(here, write_contacts(tmp_path / "places.csv", cartesian(here, tips, q)), Ask())
    cell, postures = here.cell, []
    for tip, start in zip(tips, plate_poses(cell, q) @ truth.T_plate_part, strict=True):
        T = np.tile(cell.arm.poses(cell.home[None, :6])[0], (1, 1, 1))
        T[0, :3, 3] = tip
        away = tip - start[:3, 3]  # the nozzle comes towards the table's axis
        a = np.arctan2(-away[1], -away[0])
        T[0, :3, :3] = Rotation.from_euler("z", a).as_matrix() @ [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
        flange = np.linalg.inv(cell.T_world_base) @ T @ np.linalg.inv(cell.T_flange_nozzle)
        posture, exists = track(cell.inverse, flange, None, cell.home[:6])
        assert exists.all()
        postures.append(posture[0])
    columns = {f"joint_{k + 1}": np.degrees(np.array(postures)[:, k]) for k in range(6)}
    other = register(here, write_contacts(tmp_path / "j.csv", columns | {"rotation": np.degrees(q[:, 0])}), Ask())
    np.testing.assert_allclose(other.fit.touch.contacts.tips, tips, atol=2e-8)
    np.testing.assert_allclose(other.fit.placement.T_plate_part, one.fit.placement.T_plate_part, atol=1e-7)
    assert apart(truth, other.fit.placement)[0] < 1e-7


def test_a_ball_stands_off_the_surface(tmp_path: Path) -> None:
    here, truth = scene("fibre_bowl"), misplaced(scene("fibre_bowl"), MOVED)
    file = contacts(tmp_path, "fibre_bowl", truth, 10, [2e-3] * 10)
    found = register(here, file, Ask(ball=2e-3))
    assert np.abs(found.fit.residuals).max() < 1e-8
    assert apart(truth, found.fit.placement)[0] < 1e-8


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize(
    ("name", "overrides", "key"),
    [("hemisphere_honeycomb", (), "sphere"), ("cylinder_logo", (), "cylinder")],
)
def test_the_radius_is_found_where_it_is_asked_for(tmp_path: Path, name: str, overrides, key: str) -> None:
    here, ask = scene(name), Ask(size=True)
    truth = misplaced(here, (2.0, -1.0))
    found = register(here, contacts(tmp_path, name, truth, 10, [0.7e-3] * 10, ask), ask)
    assert found.fit.placement.growth == pytest.approx(0.7e-3, abs=1e-8)
    changes = changes_of(here.problem, found.fit.placement, here.start, ("x", "y"))
    assert changes[f"part.{key}.radius_mm"] == pytest.approx({"sphere": 50.7, "cylinder": 34.7}[key])


def test_the_height_that_is_told_is_that_of_the_covariance(tmp_path: Path) -> None:
    """A plane touched at its corners: the height's error in the middle is that of a mean."""
    here = scene("fibre_plane")
    side = 80e-3
    points = np.array([[x, y, 0.0] for x in (-side, side) for y in (-side, side)] * 2)
    tips = tips_of(here, here.start, points, np.zeros(8), np.zeros((8, 1)))
    file = write_contacts(tmp_path / "c.csv", cartesian(here, tips, np.zeros((8, 1))))
    found = register(here, file, Ask(noise=4e-5))
    w = here.waypoints.points[:, :2] / side
    expected = 4e-5 / np.sqrt(8.0) * np.sqrt(1.0 + (w**2).sum(axis=1))
    np.testing.assert_allclose(found.uncertainty.height, expected, rtol=1e-6)
    np.testing.assert_allclose(found.uncertainty.bound, np.sqrt(7.8147) * expected, rtol=1e-4)  # chi squared, 3, 95 %
    assert np.abs(here.waypoints.points[found.uncertainty.worst]).max() == pytest.approx(70e-3)


@pytest.mark.slow
def test_the_place_to_touch_next_is_the_best_of_all(tmp_path: Path) -> None:
    """Touching there leaves as much of the error as was told, and no other place leaves less."""
    here, truth = scene("fibre_bowl"), misplaced(scene("fibre_bowl"), MOVED)
    points, q = chosen("fibre_bowl", 8)
    q = np.zeros_like(q)
    ask = Ask(noise=5e-5)

    def told(more: Sequence[Array]) -> float:
        every = np.vstack([points, *more])
        turned = np.zeros((len(every), 1))
        tips = tips_of(here, truth, every, np.zeros(len(every)), turned)
        found = register(here, write_contacts(tmp_path / "c.csv", cartesian(here, tips, turned)), ask)
        return float(found.uncertainty.height.max())

    before = told([])
    found = register(here, tmp_path / "c.csv", ask)
    suggested = suggest_next(found)
    assert suggested is not None
    places, k, left = suggested
    after = told([places.points[[k]]])
    assert after / before == pytest.approx(left, abs=0.02)
    assert left < 1.0
    random = np.random.default_rng(2).choice(len(places), 12, replace=False)
    assert after <= min(told([places.points[[i]]]) for i in random) * 1.02


# Turntable


def one_sided(n: int, aim: float = 0.0) -> tuple[Array, Array, Array, Array, Array]:
    """Contacts from one side of a cylinder on a table: tips, turns, reach, and the true axis and cylinder."""
    random = np.random.default_rng(3)
    axis, cylinder, r = np.array([0.6351, 0.0121]), np.array([0.0314, 0.037]), 0.034
    a = np.radians(np.linspace(-170.0, 150.0, n))
    turns = np.moveaxis(np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]), 2, 0)
    beside = random.normal(0.0, aim, n)
    tips = axis + turns @ cylinder + np.column_stack([-np.sqrt(r * r - beside**2), beside])
    return tips, turns, np.tile([-r, 0.0], (n, 1)), axis, cylinder


def test_pollards_equation_is_exact_and_bears_a_wrong_contact() -> None:
    tips, turns, reach, axis, cylinder = one_sided(9)
    tips[4] += [5e-3, -4e-3]
    found = locate(tips, turns, reach)
    np.testing.assert_allclose(found.axis, axis, atol=1e-9)
    np.testing.assert_allclose(found.cylinder, cylinder, atol=1e-9)
    np.testing.assert_allclose(found.off[4], [5e-3, -4e-3], atol=1e-9)
    assert found.cost == pytest.approx(1e-3)
    with pytest.raises(ValueError, match="one angle"):
        locate(tips, turns[[0] * 9], reach)


def test_pollards_cost_is_the_least() -> None:
    """Against moves to all sides, since a convex cost has one minimum."""
    tips, turns, reach, *_ = one_sided(9, 1e-3)
    tips = tips + np.random.default_rng(1).normal(0.0, 1e-4, tips.shape)
    found = locate(tips, turns, reach)
    for step in np.vstack([np.eye(4), -np.eye(4), np.random.default_rng(2).normal(size=(40, 4))]) * 1e-5:
        off = tips - reach - (found.axis + step[:2]) - turns @ (found.cylinder + step[2:])
        assert np.abs(off).sum(axis=1).mean() >= found.cost - 1e-12


@pytest.mark.slow
def test_table_and_cylinder_from_contacts_at_several_angles(tmp_path: Path) -> None:
    here, ask = scene("cylinder_logo"), Ask(table=True)
    truth = misplaced(here, (2.0, -1.0), (), (1.5, -2.0))
    found = register(here, contacts(tmp_path, "cylinder_logo", truth, 9, ask=ask), ask)
    np.testing.assert_allclose(found.fit.placement.shift, [1.5e-3, -2e-3, 0.0], atol=1e-8)
    assert apart(truth, found.fit.placement)[0] < 1e-8
    changes = changes_of(here.problem, found.fit.placement, here.start, ("x", "y"))
    spec = here.problem.cell.positioner
    origin = np.asarray(spec.origin) * 1e3 + [1.5, -2.0, 0.0]
    np.testing.assert_allclose(changes["cell.positioner.origin_mm"], origin, atol=1e-3)
    np.testing.assert_allclose(
        changes["cell.positioner.part_mm"], np.asarray(spec.part) * 1e3 + [2.0, -1.0, 0.0], atol=1e-3
    )


def test_both_ways_to_a_turntable_are_told(tmp_path: Path) -> None:
    """Contacts with the nozzle's direction: the published estimate is right, and stands beside ours."""
    here = scene("cylinder_logo")
    truth = misplaced(here, (2.0, -1.0))
    a = np.radians(np.linspace(-150.0, 180.0, 9))
    centre = np.asarray(here.problem.part.cylinder.centre) + [2e-3, -1e-3]
    T = plate_poses(here.cell, a[:, None])
    tips = (
        np.einsum("nij,j->ni", T[:, :3, :3], [*centre, 0.05 + here.start.T_plate_part[2, 3]])
        + T[:, :3, 3]
        + [-34e-3, 0.0, 0.0]
    )
    q = a[:, None]
    side = np.tile([1.0, 0.0, 0.0], (9, 1))
    columns = cartesian(here, tips, q) | {f"a{axis}": side[:, k] for k, axis in enumerate("xyz")}
    found = register(here, write_contacts(tmp_path / "c.csv", columns), Ask())
    assert found.turntable is not None
    np.testing.assert_allclose(found.turntable.axis, [0.6335, 0.00987], atol=1e-9)
    np.testing.assert_allclose(found.turntable.cylinder, centre, atol=1e-9)
    assert apart(truth, found.fit.placement)[0] < 1e-8
    # the same from one side only leaves the table's axis free across the nozzle, which least squares must say
    with pytest.raises(InputError, match="do not fix what the nozzle's height depends on"):
        register(here, tmp_path / "c.csv", Ask(table=True))


@pytest.mark.slow
def test_the_published_answer_is_written_from_nine_contacts_of_one_side(tmp_path: Path) -> None:
    here, off = scene("cylinder_logo"), []
    spec, truth = here.problem.cell.positioner, misplaced(here, (0.8, 0.5), (), (0.4, -0.3))
    for seed in range(20):
        columns = from_one_side(here, truth, 5e-5, 5e-5, np.random.default_rng(seed))
        file = write_contacts(tmp_path / f"{seed}.csv", columns)
        out = tmp_path / f"{seed}.yaml"
        assert main([str(file), "cylinder_logo", "--published", "--out", str(out)]) == EXIT_VERIFIED
        now = load_problem(out).cell.positioner
        axis = np.asarray(now.origin) - np.asarray(spec.origin) - truth.shift
        cylinder = np.asarray(now.part) - np.asarray(spec.part) - [0.8e-3, 0.5e-3, 0.0]
        assert axis[2] == cylinder[2] == 0.0 and now.part_rpy == spec.part_rpy
        off.append([np.linalg.norm(axis), np.linalg.norm(cylinder)])
    assert (np.array(off) <= 5e-5).all(axis=1).mean() >= 0.9
    np.testing.assert_allclose(off, 0.0, atol=1e-4)


def test_a_plate_is_placed_whose_frame_is_not_on_the_tables_axis(tmp_path: Path) -> None:
    """Its origin is a corner of the plate, say: both ways find table and cylinder where they are."""
    here, random = scene("cylinder_logo"), np.random.default_rng(0)
    T_plate_part = translation(np.array([-0.03, 0.02, 0.0])) @ here.cell.T_plate_part
    cell = replace(here.cell, T_plate_part=T_plate_part)
    aside = replace(here, cell=cell, start=Placement(T_plate_part, np.zeros(3)))

    def file(truth: Placement) -> Path:
        return write_contacts(tmp_path / "c.csv", from_one_side(aside, truth, 0.0, 0.0, random))

    truth = misplaced(aside, (0.8, 0.5), (), (0.4, -0.3))
    found = as_published(aside, file(truth)).placement
    np.testing.assert_allclose(found.T_plate_part, truth.T_plate_part, atol=1e-7)
    np.testing.assert_allclose(found.shift, truth.shift, atol=1e-7)
    told = turntable_lines(register(aside, file(misplaced(aside, (0.8, 0.5))), Ask()))
    published, ours = ([float(word) for word in re.findall(r"-?\d+\.\d{3}", line)[:4]] for line in told)
    origin = plate_poses(here.cell, np.zeros((1, 1)))[0, :2, 3]
    np.testing.assert_allclose(ours, published, atol=2e-3)
    np.testing.assert_allclose(ours[:2], origin * 1e3, atol=2e-3)


def test_a_ball_stands_off_the_cylinder_by_the_published_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here, random, out = scene("cylinder_logo"), np.random.default_rng(0), tmp_path / "out.yaml"
    monkeypatch.setattr(command, "scene_of", lambda *_: here)
    truth = misplaced(here, (0.8, 0.5), (), (0.4, -0.3))
    file = write_contacts(tmp_path / "c.csv", from_one_side(here, truth, 0.0, 0.0, random, np.full(9, 2e-3)))
    code, _ = run(str(file), "cylinder_logo", "--published", "--ball-mm", "2", "--out", str(out))
    spec, now = here.problem.cell.positioner, load_problem(out).cell.positioner
    assert code == EXIT_VERIFIED
    np.testing.assert_allclose(np.asarray(now.origin) - np.asarray(spec.origin), truth.shift, atol=1e-6)
    np.testing.assert_allclose(np.asarray(now.part) - np.asarray(spec.part), [0.8e-3, 0.5e-3, 0.0], atol=1e-6)
    columns = from_one_side(here, misplaced(here, (0.8, 0.5)), 0.0, 0.0, random, np.full(9, 2e-3))
    beside = register(here, write_contacts(tmp_path / "d.csv", columns), Ask(ball=2e-3)).turntable
    assert beside is not None
    np.testing.assert_allclose(beside.axis, plate_poses(here.cell, np.zeros((1, 1)))[0, :2, 3], atol=1e-7)


def test_contacts_keep_their_names_by_the_published_way(tmp_path: Path) -> None:
    here = scene("cylinder_logo")
    file = write_contacts(tmp_path / "c.csv", from_one_side(here, here.start, 0.0, 0.0, np.random.default_rng(0)))
    head, *rows_ = file.read_text().splitlines()
    file.write_text("\n".join([f"name,{head}", *(f"rim {k},{row}" for k, row in enumerate(rows_))]))
    lines = published_lines(as_published(here, file), {})
    assert [line[:5] for line in lines[1:10]] == [f"rim {k}" for k in range(9)]


def test_least_squares_settle_what_pollards_equation_found() -> None:
    """Of normal noise they leave half as much again less variance, and wrong contacts stay without weight."""
    tips, turns, reach, axis, cylinder = one_sided(9)
    alone, both = [], []
    for seed in range(60):
        random = np.random.default_rng(seed)
        there = tips + random.normal(0.0, 5e-5, tips.shape)
        there[seed % 9] += [4e-3, -3e-3]
        found = locate(there, turns, reach)
        for kept, each in ((alone, found), (both, settled(found, turns)[0])):
            kept.append(np.concatenate([each.axis - axis, each.cylinder - cylinder]))
    assert np.square(both).mean() < 0.8 * np.square(alone).mean()
    assert np.abs(both).max() < 1.2e-4
    exact, right = settled(locate(tips, turns, reach), turns)
    assert right.all()
    np.testing.assert_allclose([exact.axis, exact.cylinder], [axis, cylinder], atol=1e-9)


@pytest.mark.slow(cases=("cylinder_logo-*",))
@pytest.mark.parametrize(
    ("problem", "columns", "words"),
    [
        ("peer_cap", "xyz", "is not a cylinder"),
        ("cylinder_logo", "xyz", "from which side"),
        ("cylinder_logo", "still", "cannot tell the table's axis"),
        ("cylinder_logo", "far", "do not lie on this cylinder"),
    ],
)
def test_what_the_published_way_cannot_do_is_refused(
    tmp_path: Path, problem: str, columns: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    here = scene("cylinder_logo")
    found = from_one_side(here, here.start, 0.0, 0.0, np.random.default_rng(0))
    if columns == "xyz":
        found = {name: values for name, values in found.items() if name not in ("ax", "ay", "az")}
    if columns == "still":
        found["rotation"] = np.zeros(9)
    if columns == "far":
        found["x_mm"] = found["x_mm"] + np.linspace(0.0, 30.0, 9) ** 2
    if problem == "peer_cap":
        found.pop("rotation")
    file = write_contacts(tmp_path / "c.csv", found)
    assert main([str(file), problem, "--published", "--out", str(tmp_path / "out.yaml")]) == EXIT_INPUT
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out.yaml").exists()


# Freedoms in words


def test_freedoms_are_named() -> None:
    places = np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3))
    all_six = looked_for(("x", "y", "z", "rx", "ry", "rz"), np.zeros((3, 0)), False, places)

    def hidden(points: Array, normals: Array) -> list[str]:
        J = all_six.columns(rows(points, normals, np.tile(np.eye(4), (len(points), 1, 1)), all_six.centre))
        return words(all_six, split(J)[1])

    up = np.tile([0.0, 0.0, 1.0], (50, 1))
    plane = places * [1.0, 1.0, 0.0]
    assert hidden(plane, up)[:2] == ["a slide along x", "a slide along y"]
    assert hidden(plane, up)[2].startswith("a turn about z")
    ball = places / np.linalg.norm(places, axis=1)[:, None]
    assert hidden(0.05 * ball + [0.01, 0.02, 0.03], ball) == ["any turn about (10.0, 20.0, 30.0) mm"]
    ring = ball * [1.0, 1.0, 0.0]
    ring /= np.linalg.norm(ring, axis=1)[:, None]
    wall = 0.03 * ring + places * [0.0, 0.0, 1.0] + [0.01, 0.0, 0.0]
    assert hidden(wall, ring) == ["a slide along z", "a turn about z through (10.0, 0.0, 0.0) mm"] or hidden(
        wall, ring
    )[1].startswith("a turn about z through (10.0, 0.0")
    line = np.outer(np.linspace(-0.05, 0.05, 50), [1.0, 0.0, 0.0])
    assert "a turn about x through" in " ".join(hidden(line, up))


# What is written


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize("name", shipped_problems())
def test_a_written_problem_is_the_same_but_for_its_place(tmp_path: Path, name: str) -> None:
    problem = load_problem(name)
    start = build_cell(problem)
    T = start.T_world_holder if start.holder_robot is None else start.T_plate_part
    placement = Placement(T, np.zeros(3)).moved(np.array([1e-3, 2e-3, 0, 0, 0, 0.01, 0, 0, 0, 0]), np.zeros(3))
    free = ("x", "y", "z", "rx", "ry", "rz")
    target = tmp_path / "deeper" / "new.yaml"
    write_changed(problem, changes_of(problem, placement, Placement(T, np.zeros(3)), free), target)
    written = load_problem(target)
    cell = build_cell(written)
    now = cell.T_world_holder if cell.holder_robot is None else cell.T_plate_part
    np.testing.assert_allclose(now, placement.T_plate_part, atol=2e-7)
    for own, other in ((problem.layers, written.layers), (problem.part, written.part)):
        if own is not None:
            assert same_but_for_paths(own.model_dump(), other.model_dump())


def same_but_for_paths(one, other) -> bool:
    if isinstance(one, Path):
        return one.resolve() == other.resolve()
    if isinstance(one, dict):
        return set(one) == set(other) and all(same_but_for_paths(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same_but_for_paths, one, other))
    return one == other


def test_rpy_turns_back_into_the_rotation() -> None:
    for angles in ([10, -20, 30], [179, 5, -170], [40, 90, 0], [-30, -90, 0]):
        R = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        np.testing.assert_allclose(Rotation.from_euler("xyz", rpy_degrees(R), degrees=True).as_matrix(), R, atol=1e-6)


def run(*arguments: str) -> tuple[int, str]:
    stream = io.StringIO()
    with redirect_stdout(stream):
        code = main(arguments)
    return code, stream.getvalue()


@pytest.mark.slow
def test_the_command_writes_a_problem_whose_surface_goes_through_the_contacts(tmp_path: Path) -> None:
    here = scene("fibre_bowl")
    truth = misplaced(here, MOVED, TURNED)
    random = np.random.default_rng(5)
    off = random.normal(0.0, 1e-5, 14)
    off[6] = 2e-3
    file = contacts(tmp_path, "fibre_bowl", truth, 14, off)
    target, picture = tmp_path / "new.yaml", tmp_path / "r.html"
    code, text = run(str(file), "fibre_bowl", "--out", str(target), "--report", str(picture), "--tolerance-mm", "0.2")
    assert code == EXIT_VERIFIED
    for expected in (
        "7                +2.0",
        "outlier",
        "part_rpy_deg",
        "a turn about z",
        "touch next: part (",
        "keeps the",
    ):
        assert expected in text
    again = scene_of(load_problem(target))
    readings = read_readings(file, again.cell)
    seen = again.start.seen(readings.tips * 1e-3, plate_poses(again.cell, np.radians(readings.holder)))
    gap = again.surface.signed_distance(seen)
    assert np.abs(np.delete(gap, 6)).max() < 5e-5
    assert gap[6] == pytest.approx(2e-3, abs=1e-4)
    assert "<svg" in picture.read_text() and "outlier" in picture.read_text()
    before = target.read_bytes()
    assert main([str(file), "fibre_bowl", "--out", str(target)]) == EXIT_INPUT
    assert target.read_bytes() == before


@pytest.mark.slow
def test_the_command_tells_when_the_tolerance_may_be_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    here = scene("cylinder_logo")
    off = np.random.default_rng(1).normal(0.0, 2e-4, 6)
    file = contacts(tmp_path, "cylinder_logo", misplaced(here, (1.0, 1.0)), 6, off)
    code, text = run(str(file), "cylinder_logo", "--report", str(tmp_path / "r.png"))
    assert code == EXIT_NOT_VERIFIED
    assert "may leave the tolerance of 0.1 mm" in text
    written = load_problem(tmp_path / "cylinder_logo_registered.yaml")
    np.testing.assert_allclose(written.cell.positioner.part[:2], [1e-3, 1e-3], atol=0.5e-3)
    assert written.cell.positioner.part_rpy == here.problem.cell.positioner.part_rpy
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")


def test_nothing_is_left_of_a_problem_that_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    points, q = np.array([[65.4, 37.0, 50.0]]) * 1e-3, np.radians([[0.0], [40.0], [80.0]])
    here = scene("cylinder_logo")
    tips = tips_of(here, here.start, points.repeat(3, axis=0), np.zeros(3), q)
    file = write_contacts(tmp_path / "c.csv", cartesian(here, tips, q))
    monkeypatch.setattr(command, "changes_of", lambda *_: {"part": {}})
    target = tmp_path / "new.yaml"
    assert main([str(file), "cylinder_logo", "--free", "x", "--out", str(target)]) == EXIT_INPUT
    assert not target.exists()


@pytest.mark.slow
def test_the_command_says_when_nothing_is_to_spare(tmp_path: Path) -> None:
    here = scene("cylinder_logo")
    points, q = chosen("cylinder_logo", 2)
    tips = tips_of(here, here.start, points, np.zeros(2), q)
    file = write_contacts(tmp_path / "c.csv", cartesian(here, tips, q))
    code, text = run(str(file), "cylinder_logo", "--out", str(tmp_path / "a.yaml"))
    assert code == EXIT_NOT_VERIFIED and "there is no contact to spare" in text
    code, text = run(str(file), "cylinder_logo", "--out", str(tmp_path / "b.yaml"), "--noise-mm", "0.01")
    assert code == EXIT_VERIFIED and "keeps the tolerance" in text


@pytest.mark.slow
def test_places_are_suggested_before_any_contact() -> None:
    code, text = run("--suggest", "4", "cylinder_logo", "--table")
    assert code == EXIT_VERIFIED
    assert len(text.splitlines()) == 4
    assert "rotation" in text and "nozzle along (" in text


@pytest.mark.slow
def test_places_that_are_not_clear_are_not_suggested() -> None:
    """A post beside the dome is in the way of the head where the nozzle would come level from its side."""
    before, best = plan_contacts(scene("hemisphere_honeycomb"), PART, 8)
    bed = np.asarray(scene("hemisphere_honeycomb").problem.cell.bed) * 1e3
    post = f"{{box_mm: [60, 400, 400], centre_mm: [{bed[0] + 65:g}, {bed[1]:g}, {bed[2] + 200:g}]}}"
    after, other = plan_contacts(scene("hemisphere_honeycomb", f"cell.fixtures={{post: {post}}}"), PART, 8)
    assert before.points[best][:, 0].max() > 20e-3
    assert after.points[other][:, 0].max() < before.points[best][:, 0].max() - 5e-3


def test_postures_that_touch_are_counted_as_the_ranges_are() -> None:
    """Of joints that are counted a turn further, all places are reached as before, within the ranges."""
    here = scene("cylinder_logo")
    cell, limits, na = here.cell, here.cell.limits, len(here.cell.arm)
    frames = [frame_from_z(p, -n) for p, n in zip(here.points, here.normals, strict=True)]
    poses = (np.array(frames)[:, None] @ rolls()).reshape(-1, 4, 4)
    turn = np.append(np.full(na, 2.0 * np.pi), np.zeros(len(limits.q_min) - na))
    further = replace(cell, limits=replace(limits, q_min=limits.q_min + turn, q_max=limits.q_max + turn))
    (q, able), (other, also) = (reached(each, here.start, poses, cell.home[na:]) for each in (cell, further))
    assert able.any()
    np.testing.assert_array_equal(also, able)
    np.testing.assert_allclose(np.cos(other[able] - q[able]), 1.0, rtol=0, atol=1e-12)


def test_no_place_is_suggested_beside_another(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of three places, each there three times within 2 mm, no more than three are suggested, and that is said."""
    points = np.vstack([0.01 * np.eye(3), 0.01 * np.eye(3) + 1e-3, 0.01 * np.eye(3)])
    places = TouchPlaces(points, np.tile(np.eye(3), (3, 1)), np.empty((9, 0)), np.tile(np.eye(4), (9, 1, 1)))
    unknowns = looked_for(("x", "y", "z"), np.zeros((3, 0)), False, points)
    best = most_telling(places, unknowns, Placement(np.eye(4), np.zeros(3)), 8)
    assert sorted(k % 3 for k in best) == [0, 1, 2]
    here = scene("hemisphere_honeycomb")
    monkeypatch.setattr(command, "scene_of", lambda *_: here)
    monkeypatch.setattr(command, "plan_contacts", lambda *_: (places, best))
    code, text = run("--suggest", "8", "hemisphere_honeycomb")
    assert code == EXIT_VERIFIED and len(text.splitlines()) == 3
    assert "3 of 8: no other place" in capsys.readouterr().err


def test_no_place_within_reach() -> None:
    far = scene("hemisphere_honeycomb", "cell.bed_mm=[5600, 0, 290]")
    with pytest.raises(InputError, match="can touch no place"):
        plan_contacts(far, PART, 6)
    file = scratch() / "far.csv"
    points = far.points[:: len(far.points) // 12]
    none = np.zeros((len(points), 0))
    write_contacts(file, cartesian(far, tips_of(far, far.start, points, np.zeros(len(points)), none), none))
    assert suggest_next(register(far, file, PART)) is None


def test_a_part_too_thin_to_be_touched() -> None:
    """Beside the nozzle's place its surface bends away at once."""
    thin = scene("cylinder_logo", "part.cylinder.radius_mm=5", "layers.source.width_mm=15")
    assert not len(thin.points)
    with pytest.raises(InputError, match="can touch no place"):
        plan_contacts(thin, PART, 6)


@pytest.mark.parametrize(
    "arguments",
    [
        ("fibre_bowl",),
        ("a.csv", "fibre_bowl", "--suggest", "3"),
        ("--suggest", "0", "fibre_bowl"),
        ("a.csv", "fibre_bowl", "--tolerance-mm", "0"),
        ("a.csv", "fibre_bowl", "--tolerance-mm", "thin"),
        ("a.csv", "fibre_bowl", "--free", "x,q"),
        ("a.csv", "fibre_bowl", "--free", "x,x"),
        ("a.csv", "fibre_bowl", "--ball-mm", "-1"),
        ("a.csv", "fibre_bowl", "--report", "r.pdf"),
    ],
)
def test_options_that_mean_nothing(arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == EXIT_INPUT


@pytest.mark.parametrize("target", ["nowhere/new.yaml", "."])
def test_a_target_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["missing.csv", "fibre_bowl", "--out", target]) == EXIT_INPUT


@pytest.mark.slow
def test_a_file_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "no.csv"), "fibre_bowl", "--out", str(tmp_path / "n.yaml")]) == EXIT_INPUT
    assert "no.csv" in capsys.readouterr().err


def test_parts_that_are_refused_count_as_told_of_neither_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    errors = iter([(1.0, 1.0, 1.0, False), InputError("too little"), InputError("too little")])

    def touched(*_: object) -> tuple[object, object]:
        found = next(errors)
        if isinstance(found, InputError):
            raise found
        return found, found

    monkeypatch.setattr(registration, "touched", touched)
    monkeypatch.setattr(registration, "errors_of", lambda scene, truth, found: found)
    case = registration.CASES[0]
    assert registration.row_of(case, 2, 0.0, tmp_path)[-2:] == ["0.0 %", "50 %"]
    assert registration.row_of(case, 1, 0.0, tmp_path)[-2:] == ["", "100 %"]


@pytest.mark.slow
def test_joints_are_those_of_the_nozzle_that_touches(tmp_path: Path) -> None:
    problem = load_problem(write_small(tmp_path, *TWO))
    here = scene_of(problem, "tPva")
    truth = misplaced(here, (2.0, -1.0))
    places, best = plan_contacts(here, PART, 9)
    joints = []
    for k in best:
        poses = frame_from_z(places.points[k], -places.normals[k]) @ rolls()
        postures, able = reached(here.cell, truth, poses, places.q[k])
        joints.append(np.degrees([*postures[able][0], *places.q[k]]))
    columns = dict(zip(here.cell.joint_names, np.array(joints).T, strict=True))
    file = write_contacts(tmp_path / "joints.csv", columns)
    assert apart(truth, register(here, file, PART).fit.placement)[0] < 1e-6
    with pytest.raises(InputError, match="--nozzle, one of tPla, tPva"):
        register(scene_of(problem), file, PART)
    with pytest.raises(InputError, match="did you mean tPva"):
        scene_of(problem, "tPvb")
