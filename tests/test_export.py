"""Exporters: golden files, what is written in RAPID, tables and G-code."""

from __future__ import annotations

import io
import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from export_fixtures import (
    BEAD_AREA,
    FILAMENT,
    GOLDEN,
    RUN_IN,
    golden_texts,
    make_plan,
    problem,
    with_board,
    written_with,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from rapid_moves import ALONG, BOTH, moves_of
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from planner.base.errors import OutputError
from planner.export.extruder import gcode
from planner.export.fit import angle, by_samples, continuous, fewest, from_matrix, slerp, thin, to_matrix
from planner.export.plan_json import plan_json
from planner.export.player.play import play
from planner.export.rapid import writer
from planner.export.rapid.reader import read_rapid
from planner.export.rapid.text import comment, module_name
from planner.export.rapid.writer import rapid
from planner.export.readback import compare, judge
from planner.export.tables import write_table
from planner.export.write import write_plan, write_robot_code, write_trajectory
from planner.plan import Check, Dip, Event, Remedy, Trajectory

HEADER = "t_s,bead,layer,deposit,s_mm,x_mm,y_mm,z_mm,ax,ay,az,speed_mm_s,flow_mm3_s,e_mm"
# ---- golden files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["TwoBeads.mod", "TwoBeads.pgf", "extrusion.gcode", "plan.json", "trajectory.csv"])
def test_golden_file(name):
    assert golden_texts()[name] == (GOLDEN / name).read_text(encoding="utf-8")


def test_same_plan_same_bytes(tmp_path):
    plan = make_plan()
    for folder in ("a", "b"):
        write_trajectory(plan, tmp_path / folder)
        write_plan(plan, tmp_path / folder)
        write_robot_code(plan, tmp_path / folder)
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["TwoBeads.mod", "TwoBeads.pgf", "extrusion.gcode", "forecast.json", "plan.json", "trajectory.csv"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


# ---- RAPID: what is written ---------------------------------------------------------------------------------------


def test_every_quaternion_is_normalised_and_continuous():
    quat = np.array([move.quat for move in moves_of(rapid(make_plan()))])
    assert np.abs(np.linalg.norm(quat, axis=1) - 1.0).max() < 1e-6
    assert (np.einsum("ij,ij->i", quat[1:], quat[:-1]) > 0.0).all()


def test_extruder_is_switched_where_deposit_begins_and_ends():
    plan = make_plan()
    moves = moves_of(rapid(plan))
    deposit, tip = plan.trajectory.deposit, plan.trajectory.tip * 1e3
    first = np.flatnonzero(deposit[1:] & ~deposit[:-1]) + 1
    last = np.flatnonzero(deposit[:-1] & ~deposit[1:])
    for name, samples in (("trgOn", first), ("trgOff", last)):
        switched = np.array([move.position for move in moves if move.trigger == name])
        assert len(samples) == 2
        np.testing.assert_allclose(switched, tip[samples], atol=1e-3)
    assert {move.trigger for move in moves} == {None, "trgOn", "trgOff"}
    assert all(move.zone != "fine" for move in moves if move.trigger)


def test_targets_reach_the_planned_postures_on_the_turned_station():
    """Target, station angles and cfx, put through inverse kinematics, give the plan's joints: frames and order hold.

    Also those on the way of arcs, whose joints are the plan's to what tolerances leave.
    """
    plan = make_plan()
    cell, q = plan.cell, plan.trajectory.q
    moves = moves_of(rapid(plan))
    vias = [SimpleNamespace(word="via", **vars(move.via)) for move in moves if move.via is not None]
    assert len(vias) >= 6
    for move in [*moves, *vias]:
        tilt, rotation = np.radians(move.external[:2])
        assert tilt == 0.0 and move.external[2:] == [None] * 4
        T_part_nozzle = np.eye(4)
        T_part_nozzle[:3, :3] = Rotation.from_quat(np.roll(move.quat, -1)).as_matrix()
        T_part_nozzle[:3, 3] = move.position * 1e-3
        T_plate = np.eye(4)
        T_plate[:3, :3] = Rotation.from_rotvec([0.0, 0.0, rotation]).as_matrix()
        T_plate[:3, 3] = plan.problem.cell.positioner.origin
        flange = np.linalg.inv(cell.T_world_base) @ T_plate @ T_part_nozzle @ np.linalg.inv(cell.T_flange_nozzle)
        posture = cell.wrist.solve(flange[None])[0][0, move.conf[3]]
        difference = np.abs(np.angle(np.exp(1j * (q[:, :6] - posture)))).max(axis=1) + np.abs(q[:, 6] - rotation)
        k = int(np.argmin(difference))
        # in beads the nozzle may be turned by 0.05 deg, and the middle of an arc by what it may miss
        assert difference[k] < {"MoveJ": 2e-5, "via": 6e-3}.get(move.word, 2e-3)
        for cf, joint in zip(move.conf[:3], (0, 3, 5), strict=True):
            assert cf == np.floor(np.degrees(q[k, joint]) / 90.0 + 1e-9)


def test_beads_pass_their_targets_on_time_and_targets_stand_apart():
    """By what is written alone: lengths of lines and arcs, and the speeds on them."""
    plan = make_plan()
    t = plan.trajectory
    moves = moves_of(rapid(plan))
    on, clock, begun, checked = False, 0.0, 0.0, 0
    for before, move in itertools.pairwise(moves):
        if on:
            a, b = (int(np.argmin(np.linalg.norm(t.tip * 1e3 - m.position, axis=1))) for m in (before, move))
            length = _way(before.position, move)
            clock += length / move.speed
            assert abs(clock - (t.t[b] - begun)) <= 8e-3 + t.dt  # the sample is known to one
            assert t.t[b] - t.t[a] >= 0.025 and length <= 25.0
            assert move.word in ALONG and move.zone != "fine"
            checked += 1
        on = {"trgOn": True, "trgOff": False}.get(move.trigger, on)
        if move.trigger == "trgOn":
            clock, begun = 0.0, t.t[int(np.argmin(np.linalg.norm(t.tip * 1e3 - move.position, axis=1)))]
    assert checked >= 10
    assert max(move.speed for move in moves) <= plan.problem.process.travel_speed * 1e3
    slowest = min(move.speed for move in moves if move.word == "MoveL")
    assert slowest < 25.0  # the dip in the middle of the beads is in the program


def _way(begin, move):
    """Length [mm] of a line, or of the arc through a via point by the law of sines."""
    chord = np.linalg.norm(move.position - begin)
    if move.via is None:
        return chord
    to, fro = move.via.position - begin, move.position - move.via.position
    half = np.arccos(np.clip(to @ fro / np.linalg.norm(to) / np.linalg.norm(fro), -1.0, 1.0))
    return chord * half / np.sin(half)


@pytest.mark.parametrize("arcs", [True, False])
def test_targets_stand_on_the_path_and_arcs_need_fewer(arcs):
    plan = written_with(make_plan(), arcs=arcs)
    tip = plan.trajectory.tip[plan.trajectory.deposit] * 1e3
    laid = [move for move in moves_of(rapid(plan)) if move.word in ALONG and move.trigger != "trgOn"]
    laid = [move for move in laid if move.zone != "fine"]
    for move in laid:
        assert np.linalg.norm(tip - move.position, axis=1).min() < 2e-3
    for move in laid:
        if (
            move.via is not None
        ):  # on the arc, which leaves the path by its tolerance at most; samples are 0.18 mm apart
            assert np.linalg.norm(tip - move.via.position, axis=1).min() < np.hypot(0.1, 0.09)
    assert (sum(move.via is not None for move in laid) >= 8) == arcs
    assert len(laid) == (10 if arcs else 22)


def test_only_the_tip_governs_the_speed():
    plan = make_plan()
    t = plan.trajectory
    quat = Rotation.from_quat(t.quat)
    turn = np.degrees((quat[:-1].inv() * quat[1:]).magnitude().max()) / t.dt
    table = np.degrees(np.abs(np.diff(t.q[:, 6])).max()) / t.dt
    speeds = read_rapid(rapid(plan)).speed
    assert np.degrees(speeds[:, 1].min()) > 1.2 * turn and np.degrees(speeds[:, 3].min()) > 1.2 * table


def test_where_the_tip_stands_still_the_turning_has_its_real_rate(monkeypatch):
    """A wrist that turns about the tip at 20 deg/s: the tip cannot set the pace."""
    plan = make_plan(positioner=False)
    t = plan.trajectory
    n = 301
    rows = {k: np.repeat(v[:1], n, axis=0) for k, v in vars(t).items() if isinstance(v, np.ndarray)}
    turned = np.radians(20.0) * np.arange(n) * t.dt
    rows["quat"] = (Rotation.from_quat(t.quat[0]) * Rotation.from_rotvec(turned[:, None] * [0, 0, 1.0])).as_quat()
    rows["axis"] = Rotation.from_quat(rows["quat"]).as_matrix()[:, :, 2]
    rows |= {"t": np.arange(n) * t.dt, "q": rows["q"] + turned[:, None] * [0, 0, 0, 0, 0, 1.0]}
    parts = vars(plan.cell) | {
        "spherical": True,
        "own": plan.cell.own,
        "besides": plan.cell.besides,
        "rails": 0,
        "tells_posture": True,
        "given": (),
        "station": None,
        "nozzle_name": "",
        "second_arm": None,
        "postures": plan.cell.postures,
    }
    cell = SimpleNamespace(**parts, T_part_nozzle=lambda q: _standing(t.tip[0], rows["axis"][0], len(q)))
    monkeypatch.setattr(writer, "notes_of", lambda *given: ())  # which play the program, for which there are no joints
    text = rapid(replace(plan, cell=cell, trajectory=Trajectory(dt=t.dt, **rows)))
    turning = [line for line in text.split("\n") if "MoveJ" in line][1:]
    name = re.search(r",(vel\w+),", turning[0])
    assert name is not None
    values = re.search(rf"{name[1]}:=\[(.*)\];", text)
    assert values is not None
    assert 19.9 <= float(values[1].split(",")[1]) <= 21.0


def _standing(tip, axis, n):
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, 2], T[:, :3, 3] = axis, tip
    return T


def test_straight_lines_of_constant_speed_need_few_targets():
    """60 mm of straight bead at constant speed: one target every 25 mm at most, none to spare, and no arcs."""
    plan = make_plan(positioner=False)
    moves = moves_of(rapid(_straight(plan, 0.06)))
    bead = [move for move in moves if move.word in ALONG]
    assert [move.trigger for move in bead] == ["trgOn", None, None, "trgOff", None]
    places = np.array([move.position for move in bead[:4]])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1) == pytest.approx([20.0] * 3, abs=0.2)  # evenly
    assert {move.word for move in bead} == {"MoveL", "TriggL"}


def _straight(plan, length):
    """A bead that runs straight along z with run-in and run-out at 40 mm/s; joints are irrelevant and stand still."""
    step = 0.04 * plan.trajectory.dt
    n = round((length + 2 * RUN_IN) / step) + 1
    along = np.arange(n) * step
    deposit = (along >= RUN_IN - 1e-9) & (along <= RUN_IN + length + 1e-9)
    like = plan.trajectory
    tip = np.tile(like.tip[300], (n, 1)) + along[:, None] * [0.0, 0.0, 1.0]
    rows = {k: np.repeat(v[300:301], n, axis=0) for k, v in vars(like).items() if isinstance(v, np.ndarray)}
    # a joint that moves evenly, so that the robot does not seem to stand still
    rows["q"] = rows["q"] + along[:, None] * 2.0
    rows |= {"t": np.arange(n) * like.dt, "tip": tip, "deposit": deposit, "bead": np.where(deposit, 0, -1)}
    return replace(plan, trajectory=Trajectory(dt=like.dt, **rows))


def test_fine_only_at_rest_and_waits_are_kept():
    plan = make_plan()
    text = rapid(plan)
    # start, before each run-in, after each run-out, home
    fine = [move for move in moves_of(text) if move.zone == "fine"]
    assert len(fine) == 6 and "WaitTime" not in text
    t = plan.trajectory
    rest = int(np.flatnonzero(t.deposit)[0]) - 1
    while np.abs(t.q[rest] - t.q[rest - 1]).max() > 1e-5:
        rest -= 1
    rows = np.concatenate([np.arange(rest), np.full(101, rest), np.arange(rest, len(t))])
    held = {k: v[rows] for k, v in vars(t).items() if isinstance(v, np.ndarray)}
    waiting = replace(plan, trajectory=replace(t, **held | {"t": np.arange(len(rows)) * t.dt}))
    program = read_rapid(rapid(waiting))
    assert program.fine.sum() == 6
    assert program.wait.max() == pytest.approx(0.404, abs=0.013)
    assert compare(waiting, program).differences() == []


def test_without_run_in_the_extruder_goes_on_at_the_start_of_the_bead():
    plan = make_plan()
    spec = problem()
    spec.process = spec.process.model_copy(update={"run_in": 0.0})
    text = rapid(replace(plan, problem=spec))
    moves = moves_of(text)
    assert [move.trigger for move in moves if move.trigger] == ["trgOnStart", "trgOff"] * 2
    # joint moves come and go there, in directions that are not those of their chords
    ends = [
        zone for a, b in itertools.pairwise(moves) if (a.word == "MoveJ") != (b.word == "MoveJ") for zone in [a.zone]
    ]
    assert len(ends) == 4 and set(ends) <= {"zon0_1", "z0", "fine"}
    played = read_rapid(text)
    found = judge(plan, played, play(played, plan.cell))
    assert found.corner < 0.05e-3 and found.differences() == []
    assert compare(plan, read_rapid(text)).differences() == []


def test_fixed_bed():
    plan = make_plan(positioner=False)
    text = rapid(plan)
    assert 'PERS wobjdata wobjPart:=[FALSE,TRUE,"",[[450.000,-50.000,380.000],[1.0000000,' in text
    assert "ActUnit" not in text
    assert {tuple(move.external) for move in moves_of(text)} == {(None,) * 6}
    assert compare(plan, read_rapid(text)).differences() == []


def test_lines_strings_and_names_are_within_what_a_controller_takes():
    plan = make_plan()
    odd = replace(plan, strategy="ladder ü" + "x" * 300)
    text = rapid(odd)
    assert text.isascii()
    assert all(len(line) <= 110 for line in text.split("\n") if line.strip().startswith("!"))
    assert all(len(line) <= (300 if "C [[" in line else 200) for line in text.split("\n"))  # an arc has two targets
    assert all(len(string) <= 80 for string in re.findall(r'"([^"]*)"', text))
    names = re.findall(r"(?:PROC|MODULE|tooldata|wobjdata|speeddata|triggdata) (\w+)", text)
    assert all(len(name) <= 32 for name in names) and len({n.lower() for n in names}) == len(names)
    assert "nan" not in text.lower() and "inf" not in text.lower()


def test_module_names():
    assert module_name("cylinder_logo") == "CylinderLogo"
    assert module_name("test") == "PrintTest"  # TEST is a statement of RAPID
    assert module_name("main") == "PrintMain"
    assert module_name("home_1") == "PrintHome1"  # a procedure of programs with several nozzles
    assert module_name("fine") == "PrintFine"
    assert module_name("pose") == "PrintPose"  # a type of RAPID
    assert module_name("3d_part") == "Print3dPart"
    assert len(module_name("a_very_long_name_" * 5)) == 32


def test_comment_is_one_bounded_ascii_line():
    assert comment("a\nMoveL ö" + "b" * 500) == "    ! a?MoveL ?" + "b" * 91


def test_code_of_an_unverified_plan_is_a_mistake(tmp_path):
    bad = replace(make_plan(), checks=(Check("reach", 2.0, 1.0, "mm", False, "bead 1"),))
    with pytest.raises(ValueError, match="verified"):
        write_robot_code(bad, tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert write_plan(bad, tmp_path).name == "plan.json"
    assert write_trajectory(bad, tmp_path).name == "trajectory.csv"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_foreign_parser_accepts_the_program(monkeypatch):
    config = pytest.importorskip("rapidchecker.config")
    monkeypatch.setattr(config.CONFIG, "indentation_size", 4)
    check = pytest.importorskip("rapidchecker.check")
    whitespace = pytest.importorskip("rapidchecker.whitespace_checks")
    text = rapid(make_plan(beads=1, length=0.006, dip=False))
    assert check.check_format(text) == []
    assert whitespace.check_whitespace(text) == []
    assert "MoveC [[" in text and "TriggC [[" in text
    assert check.check_format(text.replace("fine,tPen", "fine tPen", 1)) != []
    arc = next(line for line in text.split("\n") if "MoveC [[" in line)
    assert check.check_format(text.replace(arc, arc.replace("]],[[", "]] [["), 1)) != []


# ---- thinning and rotations ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("thinned", [thin, fewest])
@settings(max_examples=50, deadline=None)
@given(n=st.integers(2, 300), seed=st.integers(0, 2**32 - 1), tolerance=st.floats(0.01, 3.0))
def test_thinning_meets_every_sample(thinned, n, seed, tolerance):
    random = np.random.default_rng(seed)
    y = np.cumsum(random.normal(size=n))
    kept = np.unique(np.concatenate([[0, n - 1], random.integers(0, n, 3)]))

    def misfit(a, b, k):
        return np.abs(y[a] + (k - a) / (b - a) * (y[b] - y[a]) - y[k]) / tolerance

    found = thinned(kept, by_samples(misfit))
    assert len(found) <= len(thin(kept, by_samples(misfit)))
    assert (np.diff(found) > 0).all() and set(kept) <= set(found)
    assert np.abs(np.interp(np.arange(n), found, y[found]) - y).max() <= tolerance * (1 + 1e-9)


def test_thinning_of_an_arc_is_near_the_fewest():
    phi = np.linspace(0.0, np.pi, 3001)
    p = np.column_stack([np.cos(phi), np.sin(phi)]) * 50.0

    def misfit(a, b, k):
        chord = p[b] - p[a]
        across = (p[k] - p[a])[:, 0] * chord[:, 1] - (p[k] - p[a])[:, 1] * chord[:, 0]
        return np.abs(across) / np.linalg.norm(chord, axis=1) / 0.02

    least = np.pi / (2 * np.arccos(1 - 0.02 / 50.0))  # arcs whose sagitta is the tolerance
    assert len(thin(np.array([0, 3000]), by_samples(misfit))) - 1 <= 1.7 * least
    assert len(fewest(np.array([0, 3000]), by_samples(misfit))) - 1 <= 1.05 * least + 1


def test_rotations_against_scipy():
    random = np.random.default_rng(4)
    a, b = Rotation.random(500, rng=random), Rotation.random(500, rng=random)
    u = random.uniform(size=500)
    qa, qb = a.as_quat(), b.as_quat()
    np.testing.assert_allclose(angle(qa, qb), (a.inv() * b).magnitude(), atol=1e-9)
    between = a * Rotation.from_rotvec((a.inv() * b).as_rotvec() * u[:, None])
    assert angle(slerp(qa, qb, u), between.as_quat()).max() < 1e-9
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    both = Rotation.concatenate([a, half_turns])
    assert angle(from_matrix(both.as_matrix()), both.as_quat()).max() < 1e-7
    np.testing.assert_allclose(to_matrix(qa), a.as_matrix(), atol=1e-12)
    signs = np.where(random.uniform(size=500) < 0.5, -2.0, 2.0)[:, None]
    smooth = Rotation.from_rotvec(np.linspace(0, 20, 500)[:, None] * [0.0, 0.6, 0.8]).as_quat()
    assert np.linalg.norm(np.diff(continuous(smooth * signs), axis=0), axis=1).max() < 0.05


# ---- tables -------------------------------------------------------------------------------------------------------


def test_table_holds_the_samples():
    plan = make_plan()
    t = plan.trajectory
    stream = io.StringIO()
    write_table(plan, stream)
    head, body = stream.getvalue().split("\n", 1)
    assert head == HEADER + "," + ",".join(plan.cell.joint_names)
    rows = np.loadtxt(io.StringIO(body), delimiter=",")
    assert rows.shape == (len(t), 14 + t.q.shape[1])
    np.testing.assert_allclose(rows[:, 0], t.t, atol=1e-6)
    np.testing.assert_array_equal(rows[:, 1:4], np.column_stack([t.bead, t.layer, t.deposit]))
    np.testing.assert_allclose(rows[:, 5:8], t.tip * 1e3, atol=1e-6)
    np.testing.assert_allclose(rows[:, 8:11], t.axis, atol=1e-9)
    np.testing.assert_allclose(rows[:, 11], t.speed * 1e3, atol=1e-5)
    np.testing.assert_allclose(rows[:, 12], t.flow * 1e9, atol=1e-6)
    np.testing.assert_allclose(rows[:, 14:], t.q, rtol=1e-11, atol=1e-15)
    # 40 mm of 0.6 x 0.5 mm bead, in filament of 1.75 mm
    assert rows[-1, 13] == pytest.approx(40.0 * 0.3 / (np.pi * 1.75**2 / 4), abs=1e-5)
    assert "-0.0" not in re.sub(r"-0\.0*[1-9]", "", body)


@pytest.mark.parametrize("free", [("rotation",), BOTH], ids=len)
def test_nozzle_poses_follow_from_the_json_alone(free):
    plan = make_plan(free=free)
    data = json.loads(plan_json(plan))["cell"]
    random = np.random.default_rng(1)
    q = random.uniform(-3.0, 3.0, (20, len(data["joints"])))
    assert [j["name"] for j in data["joints"]] == list(plan.cell.joint_names)
    assert [j["moves"] for j in data["joints"]] == ["nozzle"] * 6 + ["part"] * len(free)

    def screw(joint, angle_):
        w, p = np.array(joint["direction"]), np.array(joint["origin_m"])
        S = np.zeros((4, 4))
        S[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
        S[:3, 3] = -np.cross(w, p)
        return expm(S * angle_)

    expected = plan.cell.T_part_nozzle(q)
    for row, T in zip(q, expected, strict=True):
        ends = {"nozzle": np.eye(4), "part": np.eye(4)}
        for joint, value in zip(data["joints"], row, strict=True):
            ends[joint["moves"]] = ends[joint["moves"]] @ screw(joint, value)
        nozzle = ends["nozzle"] @ data["T_world_nozzle_zero"]
        part = ends["part"] @ data["T_world_part_zero"]
        np.testing.assert_allclose(np.linalg.inv(part) @ nozzle, T, atol=1e-10)
    assert data["joints"][-1]["v_max"] == pytest.approx(np.radians(180.0))


def test_json_is_strict_and_complete():
    def refuse(constant):
        raise AssertionError(constant)

    data = json.loads(plan_json(make_plan()), parse_constant=refuse)
    assert set(data) == {
        *(
            "advice",
            "problem",
            "resolved_by",
            "strategy",
            "verified",
            "checks",
            "metrics",
            "cell",
            "timing_s",
            "versions",
            "baseline",
        ),
        *("settings", "files", "dips", "events", "layer_times", "notes", "first_bead"),
        *("problem_file", "problem_sha256"),
    }
    assert data["dips"] == data["events"] == data["notes"] == []
    assert data["verified"] is True and data["metrics"]["sigma_min"] is None
    assert data["baseline"]["fixed"]["at_speed_fraction"] is None
    assert list(data["checks"][0]) == ["name", "worst", "limit", "unit", "ok", "where"]
    assert list(data["checks"][0].values()) == ["position_error", 0.0021, 0.05, "mm", True, "bead 0"]
    assert data["settings"] == {"roll_step_deg": 5.0, "svg": "logo.svg", "count": 3}
    with pytest.raises(TypeError, match="no JSON form"):
        plan_json(replace(make_plan(), settings={"x": object()}))


def test_json_tells_dips_and_events_in_the_units_of_their_names():
    limits = Remedy(
        "limits", (("cell.limits.joint_4.jerk_rad_s3", 1800.0), ("cell.limits.rotation.speed_deg_s", 91.0)), True
    )
    tolerance = Remedy("corner_tolerance", (("process.corner_tolerance_mm", 0.4),), False)
    dip = Dip(3, 1, 0.0121, 0.0136, 0.0125, 7.104, 0.0082, 0.0405, "joint_4", "jerk", 1.2e-9, (limits, tolerance))
    start = replace(dip, joint="", limit="start", over_extruded=0.0, remedies=())
    plan = replace(make_plan(), dips=(dip, start))
    events = (Event("retract", 2, 3.5, 0.2, -0.0015),)
    plan = replace(plan, trajectory=replace(plan.trajectory, events=events))
    data = json.loads(plan_json(plan))
    assert data["dips"][0] == {
        "bead": 3, "layer": 1, "from_mm": 12.1, "to_mm": 13.6, "at_mm": 12.5, "t_s": 7.104, "speed_min_mm_s": 8.2,
        "lost_s": 0.0405, "joint": "joint_4", "limit": "jerk", "over_extruded_mm3": 1.2,
        "avoid": {
            "limits": {
                "exact": True,
                "change": {"cell.limits.joint_4.jerk_rad_s3": 1800.0, "cell.limits.rotation.speed_deg_s": 91.0},
            },
            "corner_tolerance": {"exact": False, "change": {"process.corner_tolerance_mm": 0.4}},
        },
    }  # fmt: skip
    assert (data["dips"][1]["joint"], data["dips"][1]["limit"], data["dips"][1]["avoid"]) == (None, "start", {})
    assert data["events"] == [{"kind": "retract", "bead": 2, "start_s": 3.5, "duration_s": 0.2, "amount_mm": -1.5}]


def test_places_that_cannot_bewritten_with(tmp_path):
    file = tmp_path / "taken"
    file.write_text("a file, not a folder")
    with pytest.raises(OutputError, match="taken"):
        write_trajectory(make_plan(), file / "out")
    assert [path.name for path in Path(tmp_path).iterdir()] == ["taken"]


# ---- G-code -------------------------------------------------------------------------------------------------------


def run_gcode(text):
    """Start [s], duration [s] and filament [mm] of every G1, and the whole duration [s]."""
    now, moves, relative = 0.0, [], False
    for line in text.splitlines():
        code = line.split(";")[0].strip()
        if code == "M83":
            relative = True
        elif code in ("M203 I0.6", "M595 R0", "T0"):
            continue
        elif match := re.fullmatch(r"G4 P(\d+)", code):
            now += int(match[1]) * 1e-3
        elif match := re.fullmatch(r"G1 E([\d.]+) F([\d.]+)", code):
            assert relative
            duration = 60.0 * float(match[1]) / float(match[2])
            moves.append((now, duration, float(match[1])))
            now += duration
        else:
            assert code == "", line
    return np.array(moves), now


@pytest.mark.parametrize("beads", [1, 2, 5])
def test_gcode_feeds_what_the_plan_lays_down_when_it_does(beads):
    plan = make_plan(beads=beads)
    t = plan.trajectory
    text = gcode(with_board(plan, sync="free"))
    moves, duration = run_gcode(text)
    assert moves[:, 2].sum() == pytest.approx(plan.metrics["extruded_mm"], rel=1e-4)
    assert duration == pytest.approx(t.t[-1], rel=1e-3)
    # fed so far, at every instant, against the plan: never more than a block of 20 ms apart
    fed = np.concatenate([[0.0], np.cumsum(moves[:, 2])])
    knots = np.column_stack([moves[:, 0], moves[:, 0] + moves[:, 1]]).ravel()
    so_far = np.interp(t.t, knots, np.column_stack([fed[:-1], fed[1:]]).ravel())
    expected = t.extruded / (np.pi * FILAMENT**2 / 4) * 1e3
    most = 0.045 * BEAD_AREA / (np.pi * FILAMENT**2 / 4) * 1e3  # mm of filament per second
    assert np.abs(so_far - expected).max() < 0.020 * most
    assert text.count("; bead ") == beads
    assert "; bead 0, layer 0" in text and (beads < 5 or "; bead 4, layer 2" in text)
    # chunks of equal flow are one command: far fewer lines than samples
    assert len(moves) < 15 * beads
    assert moves[:, 1].min() > 0.003


def test_gcode_of_a_plan_without_dips_is_one_command_per_bead_or_few():
    moves, _ = run_gcode(gcode(with_board(make_plan(dip=False), sync="free")))
    assert len(moves) <= 2 * 3
