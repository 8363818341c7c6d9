"""Cones about the vertical that cannot be kept to: the least lean against brute force, and what is named, tried."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label
from solved import solve_alone, write_small

from planner.base.arrays import Array
from planner.base.errors import EXIT_INPUT, InputError
from planner.cell.cell import Cell, build_cell
from planner.planning.check_command import examine
from planner.problem import Problem, load_problem
from planner.resolve.least_lean import LeastLean, _least_way, _too_narrow, check_cones, least_along, least_leans
from planner.toolpath.build import build_toolpath
from planner.toolpath.task import Cones, NozzleTask, tasks_of

TABLES = {
    "both": ("[tilt, rotation]", "{}", (-20, 60)),
    "both, rotation in its range": ("[tilt, rotation]", "{}", (10, 15)),
    "tilt": ("[tilt]", "{rotation: 30}", (-20, 60)),
    "rotation": ("[rotation]", "{tilt: 20}", (-181, 181)),
}


def table(which: str) -> Cell:
    free, held, (low, high) = TABLES[which]
    home = "{tilt: 12}" if "tilt" in free else "{}"
    return build_cell(
        load_problem(
            "cylinder_logo",
            [
                f"cell.positioner={{robot: irbp_a250, origin_mm: [633, 9, 320], free: {free}, held_deg: {held}, home_deg: {home}}}",
                *([f"cell.limits={{tilt: {{range_deg: [{low}, {high}]}}}}"] if "tilt" in free else []),
            ],
        )
    )


def ranges(cell: Cell) -> tuple[Array, Array]:
    na = len(cell.arm)
    return cell.limits.q_min[na:], cell.limits.q_max[na:]


def some_normals(n: int) -> Array:
    normals = np.random.default_rng(n).normal(size=(n, 3))
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


@pytest.mark.slow(cases=("both",))
@pytest.mark.parametrize("which", TABLES)
def test_least_lean_of_each_place_against_all_angles(which: str) -> None:
    cell = table(which)
    low, high = ranges(cell)
    normals = some_normals(60)
    found = least_leans(cell.holder, low, high, normals)
    each = [np.linspace(max(a, -np.pi), min(b, np.pi), 721) for a, b in zip(low, high, strict=True)]
    all_angles = np.stack(np.meshgrid(*each, indexing="ij"), axis=-1).reshape(-1, len(low))
    up = cell.holder.poses(all_angles)[:, 2, :3]
    brute = np.arccos(np.clip((normals @ up.T).max(axis=1), -1.0, 1.0))
    assert (found <= brute + 1e-5).all()
    np.testing.assert_allclose(found, brute, rtol=0, atol=np.radians(0.3))
    enough = float(np.median(found))
    early = least_leans(cell.holder, low, high, normals, enough)
    np.testing.assert_allclose(early[found > enough + 1e-6], found[found > enough + 1e-6], rtol=0, atol=1e-6)
    assert (early[found <= enough] <= enough + 1e-6).all()


@pytest.mark.slow(keep=4)
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("round_b", [False, True])
def test_least_way_against_all_thresholds(seed: int, round_b: bool) -> None:
    """For each threshold what can be reached from rung to rung, by labels of what hangs together."""
    rng = np.random.default_rng(seed)
    na, nb, r = 6, 7, 5
    up, normals = (x / np.linalg.norm(x, axis=-1)[..., None] for x in (rng.normal(size=(na, nb, 3)), some_normals(r)))
    cosines = np.einsum("ijk,rk->rij", up, normals)

    def passes(threshold: float) -> bool:
        reached = cosines[0] >= threshold
        for here in cosines[1:] >= threshold:
            wide = np.tile(here, (1, 3)) if round_b else here
            marks, _ = label(wide)
            entries = np.tile(reached, (1, 3)) if round_b else reached
            known = np.isin(marks, np.unique(marks[entries & wide])) & wide
            reached = known[:, nb : 2 * nb] if round_b else known
        return bool(reached.any())

    best = max(c for c in np.unique(cosines) if passes(c))
    assert _least_way(up, normals, False, round_b) == pytest.approx(best, abs=1e-12)


def test_a_way_along_the_bead_may_lean_more_than_any_of_its_places() -> None:
    """A tilt to one side alone: between normals that lean to both sides the table has to turn round, at a place in the
    middle that leans sideways."""
    cell = table("both, rotation in its range")
    n = 61
    lean = np.radians(30.0) * np.linspace(-1.0, 1.0, n)
    normals = np.column_stack([np.sin(lean), np.full(n, np.tan(np.radians(2.0))), np.cos(lean)])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    low, high = ranges(cell)
    each = least_leans(cell.holder, low, high, normals)
    along = least_along(cell.holder, low, high, normals)
    assert along > each.max()
    one = table("tilt")
    assert least_along(one.holder, *ranges(one), normals) == pytest.approx(
        least_leans(one.holder, *ranges(one), normals).max(), abs=np.radians(0.1)
    )


def test_a_winding_of_many_turns_leans_as_one_turn_does() -> None:
    """The wall of a cylinder on a table that tilts by 60 degrees leans by 30, if the table goes round with it. Of 40 turns
    few places are looked at: 36 degrees apart no angle of the table would do for two of them by less than 34.6."""
    cell = table("both")
    angle = np.linspace(0.0, 80.0 * np.pi, 1601)
    normals = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    assert least_along(cell.holder, *ranges(cell), normals) == pytest.approx(np.radians(30.0), abs=np.radians(1.0))


CAP: tuple[str, list[str]] = ("peer_cap", [])
TILTED = (
    "cylinder_logo",
    [
        "layers.count=1",
        "cell.positioner={robot: irbp_a250, origin_mm: [633, 9, 320], free: [tilt, rotation]}",
        "cell.limits={tilt: {range_deg: [-20, 60]}}",
    ],
)
NARROW = {
    "layer": (*CAP, "{layer_gravity_deg: 10}"),
    "nozzle": (*CAP, "{nozzle_gravity_deg: 10, nozzle_normal_deg: 5}"),
    "both": (*CAP, "{layer_gravity_deg: 20, nozzle_gravity_deg: 10, nozzle_normal_deg: 5}"),
    "layer on a table": (*TILTED, "{layer_gravity_deg: 12, nozzle_normal_deg: 5}"),
}


def check(name: str, *changes: str) -> None:
    problem = load_problem(name, changes)
    toolpath = build_toolpath(problem)
    check_cones(problem, build_cell(problem), tasks_of(problem, toolpath))


@pytest.mark.slow
@pytest.mark.parametrize("which", NARROW)
def test_the_least_that_is_named_is_enough_and_less_is_not(which: str) -> None:
    name, changes, cones = NARROW[which]
    with pytest.raises(InputError) as caught:
        check(name, *changes, f"process.cones={cones}")
    error = caught.value
    assert error.exit_code == EXIT_INPUT
    assert (error.field or "").endswith(f"process.cones.{'nozzle' if which == 'nozzle' else 'layer'}_gravity_deg")
    place = re.search(r"\(bead (\d+), layer (\d+), path '(.+)', ([\d.]+) mm along it\)", error.reason)
    assert place, error.reason
    named = re.findall(r"(layer_gravity_deg|nozzle_gravity_deg): ([\d.]+)", error.hint or "")
    assert len(named) == 1 + (which == "both")
    normal = re.findall(r"nozzle_normal_deg: \d+", cones)

    def cones_with(more: float) -> str:
        values = [*(f"{key}: {float(value) + more:.2f}" for key, value in named), *normal]
        return f"process.cones={{{', '.join(values)}}}"

    check(name, *changes, cones_with(0.0))
    with pytest.raises(InputError, match="at least"):
        check(name, *changes, cones_with(-0.3))


@pytest.mark.slow
def test_a_plan_keeps_to_the_cone_that_was_named() -> None:
    with pytest.raises(InputError) as caught:
        solve_alone(load_problem("peer_cap", ["process.cones={layer_gravity_deg: 10}"]))
    found = re.search(r"_gravity_deg: ([\d.]+)", caught.value.hint or "")
    assert found
    assert solve_alone(load_problem("peer_cap", [f"process.cones={{layer_gravity_deg: {found[1]}}}"])).verified


def test_check_tells_it_without_a_search(tmp_path: Path) -> None:
    path = write_small(
        tmp_path, ("  travel_speed_mm_s: 200", "  travel_speed_mm_s: 200\n  cones: {layer_gravity_deg: 30}")
    )
    mistakes = examine(load_problem(path)).mistakes
    assert len(mistakes) == 1
    assert mistakes[0].line == 1 + path.read_text().splitlines().index("  cones: {layer_gravity_deg: 30}")
    assert "at any angle of rotation" in mistakes[0].reason
    assert "or more axes in cell.positioner.free" in (mistakes[0].hint or "")


def cap() -> tuple[Problem, Cell, tuple[NozzleTask, ...]]:
    problem = load_problem("peer_cap")
    return problem, build_cell(problem), tasks_of(problem, build_toolpath(problem))


def test_what_verification_lets_pass_is_not_refused_and_runs_are_not_judged() -> None:
    problem, cell, tasks = cap()
    (task,) = tasks
    lean = np.arccos(task.normals[:, 2])
    most = float(lean[task.first : task.last + 1].max())
    with pytest.raises(InputError):
        check_cones(problem, cell, [replace(task, cones=Cones(layer_gravity=most - np.radians(0.06)))])
    check_cones(problem, cell, [replace(task, cones=Cones(layer_gravity=most - np.radians(0.04)))])
    check_cones(problem, cell, [task])
    half = len(task) // 2
    flatter = replace(task, first=0, last=half, cones=Cones(layer_gravity=float(lean[: half + 1].max())))
    check_cones(problem, cell, [flatter])


@pytest.mark.parametrize(
    ("nozzle", "named"),
    [(25.0, "{layer_gravity_deg: 30.0, nozzle_gravity_deg: 30.0}"), (31.0, "{layer_gravity_deg: 30.0}")],
)
def test_a_cone_that_only_the_way_along_the_bead_breaks_is_named_too(nozzle: float, named: str) -> None:
    problem, cell, (task,) = cap()
    here, along = np.radians([22.0, 30.0])
    cones = Cones(layer_gravity=np.radians(20.0), nozzle_gravity=np.radians(nozzle))
    error = _too_narrow(problem, cell, cones, LeastLean(task, task.first, here, along))
    assert named in (error.hint or "")
    assert (error.field or "").endswith("layer_gravity_deg") and "the nozzle leans" not in error.reason
