"""FANUC, INFORM, VAL3, AS and MELFA-BASIC: golden files, readings with nothing of ours, and programs that were tampered with."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import export_fixtures
import numpy as np
import pytest
from export_fixtures import GOLDEN, arm_texts, make_plan, resting_in_a_bead
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from solved import bed_plan

from planner.base.arrays import Array
from planner.base.errors import InputError
from planner.export.arms import Convention
from planner.export.fanuc import FANUC
from planner.export.inform import FRAME, YASKAWA, frame_comments
from planner.export.kawasaki import KAWASAKI
from planner.export.languages import LANGUAGES
from planner.export.melfa import MITSUBISHI
from planner.export.moves import MoveSection, Wait, plan_moves, sections
from planner.export.parts import cut, in_files, numbered, packed
from planner.export.speeds import stepped_speeds
from planner.export.val3 import STAUBLI
from planner.plan import Plan

Files = dict[str, str]
ARMS = ("fanuc", "inform", "val3", "kawasaki", "melfa")


def module(language: str) -> Any:
    return import_module(f"planner.export.{language}")


@cache
def arc(**changes: object) -> Plan:
    """Beads round a cylinder on a bed, by an arm with a spherical wrist."""
    return make_plan(**{"positioner": False, "arm": "kr6_r900", **changes})  # type: ignore[arg-type]


@cache
def written(language: str, **changes: object) -> Files:
    files: Files = module(language).write(arc(**changes))
    return files


def differences(language: str, files: Mapping[str, str], plan: Plan | None = None) -> list[str]:
    found: list[str] = module(language).differences(plan or arc(), files)
    return found


# ---- how makers count ---------------------------------------------------------------------------------------------
# Joints as the makers' own or ROS-Industrial's URDF files have them: place in the link before, roll pitch yaw, axis; with
# the lengths of a KR 6 R900 (a1 25, a2 -35, c1 400, c2 455, c3 420, c4 80 mm), so that our arm is theirs.

A1, A2, C1, C2, C3, C4 = 0.025, -0.035, 0.4, 0.455, 0.42, 0.08
RIGHT = 0.5 * np.pi
Joints = tuple[tuple[tuple[float, ...], tuple[float, ...], tuple[int, ...]], ...]
NO = (0.0, 0.0, 0.0)
# forearm level at zero: fanuc_m10ia, motoman_gp12; their own base is level with joint 2, their flange's x points up
LEVEL: Joints = (
    ((0, 0, C1), NO, (0, 0, 1)),
    ((A1, 0, 0), NO, (0, 1, 0)),
    ((0, 0, C2), NO, (0, -1, 0)),
    ((0, 0, -A2), NO, (-1, 0, 0)),
    ((C3, 0, 0), NO, (0, -1, 0)),
    ((C4, 0, 0), NO, (-1, 0, 0)),
)
LEVEL_TOOL = Rotation.from_euler("xyz", [np.pi, -RIGHT, 0.0]).as_matrix()
# upright at zero: staubli_rx160; rv7frl of melfa_description, whose own base is at the foot; and khi_rs007n, likewise, whose
# arm looks along y
UPRIGHT: Joints = (
    ((0, 0, C1), NO, (0, 0, 1)),
    ((A1, 0, 0), NO, (0, 1, 0)),
    ((0, 0, C2), NO, (0, 1, 0)),
    ((A2, 0, 0), NO, (0, 0, 1)),
    ((0, 0, C3), NO, (0, 1, 0)),
    ((0, 0, C4), NO, (0, 0, 1)),
)
KHI: Joints = (
    ((0, 0, C1), NO, (0, 0, -1)),
    ((0, A1, 0), (0, -RIGHT, 0), (0, 0, 1)),
    ((C2, 0, 0), NO, (0, 0, -1)),
    ((0, A2, 0), (0, RIGHT, 0), (0, 0, 1)),
    ((0, 0, C3), (0, -RIGHT, 0), (0, 0, -1)),
    ((C4, 0, 0), (0, RIGHT, 0), (0, 0, 1)),
)


def flange(joints: Joints, axes: Array) -> Array:
    T = np.eye(4)
    for (origin, rpy, axis), value in zip(joints, axes, strict=True):
        step = np.eye(4)
        turn = Rotation.from_rotvec(np.array(axis) * value)
        step[:3, :3], step[:3, 3] = (Rotation.from_euler("xyz", rpy) * turn).as_matrix(), origin
        T = T @ step
    return T


def fanuc_flange(axes: Array) -> Array:
    """J3 is coupled: the URDF's third joint is J3 + J2 (fanuc_driver, J23_factor)."""
    T = flange(LEVEL, axes + np.array([0, 0, axes[1], 0, 0, 0]))
    T[:3, :3] = T[:3, :3] @ LEVEL_TOOL
    return T


def yaskawa_flange(axes: Array) -> Array:
    T = flange(LEVEL, axes)
    T[:3, :3] = T[:3, :3] @ LEVEL_TOOL
    return T


MAKERS: dict[str, tuple[Convention, Callable[[Array], Array], Array]] = {
    "fanuc": (FANUC, fanuc_flange, np.array([0, 0, C1])),
    "inform": (YASKAWA, yaskawa_flange, np.array([0, 0, C1])),
    "val3": (STAUBLI, lambda axes: flange(UPRIGHT, axes), np.array([0, 0, C1])),
    "kawasaki": (KAWASAKI, lambda axes: flange(KHI, axes), np.zeros(3)),
    "melfa": (MITSUBISHI, lambda axes: flange(UPRIGHT, axes), np.zeros(3)),
}


def controller(language: str, axes: Array) -> Array:
    """The maker's flange in the maker's base frame."""
    _, of, base = MAKERS[language]
    T = of(axes)
    T[:3, 3] -= base
    return T


@pytest.mark.parametrize("language", ARMS)
def test_axes_and_frames_are_the_makers(language: str) -> None:
    """The same posture as the maker's own joints have it and as our closed form has it: one flange, in one base."""
    convention, cell = MAKERS[language][0], arc().cell
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (50, 6))
    np.testing.assert_allclose(convention.joints(convention.counted(q)), q, atol=1e-12)
    base = convention.T_world_base(cell)
    for own, T in zip(q, cell.wrist.poses(q), strict=True):
        seen = base @ controller(language, convention.counted(own[None])[0]) @ convention.T_flange_maker.T
        np.testing.assert_allclose(seen, cell.T_world_base @ T, atol=1e-9)


@pytest.mark.parametrize(
    ("language", "ours", "theirs"),
    [
        ("fanuc", (0, 0, 0, 0, 90, 0), (0, 0, 0, 0, -90, 0)),  # the usual posture with the tool down, N U T
        ("fanuc", (0, 30, -30, 0, 0, 0), (0, 30, 0, 0, 0, 0)),  # the forearm stays level while J2 leans
        ("inform", (10, 20, 30, 40, 50, 60), (10, 20, -30, -40, -50, -60)),
        ("val3", (0, 0, 0, 0, 90, 0), (0, 0, 90, 0, 90, 0)),
        ("kawasaki", (0, 0, 0, 0, 90, 0), (0, 0, -90, 0, -90, 0)),
        ("melfa", (0, 0, 0, 0, 90, 0), (0, 0, 90, 0, 90, 0)),  # where A, B and C are 180, 0 and 180 degrees
    ],
)
def test_postures_that_makers_show(language: str, ours: tuple[int, ...], theirs: tuple[int, ...]) -> None:
    counted = MAKERS[language][0].counted(np.radians([ours]))
    np.testing.assert_allclose(np.degrees(counted), [theirs], atol=1e-9)


# ---- what is written ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(arm_texts()))
def test_golden_files(name: str) -> None:
    assert arm_texts()[name] == (GOLDEN / name).read_text(encoding="utf-8")


def test_an_application_is_xml() -> None:
    files = module("val3").write(replace(arc(), strategy="ladder, as in plan[first[0]]>M4 & <b>"))
    assert "plan[first[0]] >M4" in files["start.pgx"]
    for name, text in files.items():
        root = ElementTree.fromstring(text)
        assert root.tag.rsplit("}")[-1] == {"pjx": "Project", "dtx": "Database", "pgx": "Programs"}[name.split(".")[1]]


def matrix(values: tuple[float, ...], order: str) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler(order, values[3:], degrees=True).as_matrix(), np.array(values[:3]) * 1e-3
    return T


def numbers(pattern: str, text: str) -> list[tuple[float, ...]]:
    """Six numbers of each place where a pattern matches."""
    found = [re.findall(r"-?\d+\.\d+", match[0]) for match in re.finditer(pattern, text)]
    return [tuple(float(value) for value in each) for each in found]


def said(language: str, files: Files) -> tuple[list[tuple[float, ...]], list[tuple[float, ...]], Array, Array]:
    """Poses and axes [deg] that files have, tool and part, as regular expressions find them."""
    text = "\n".join(files.values())
    if language == "fanuc":
        poses = numbers(r"X =.*\n.*R =.*deg", text)
        axes = numbers(r"J1=.*\n.*deg", text)
        tool, part = (
            matrix(tuple(v[0] for v in numbers(r"PR\[9,\d\]=.*", t)), "xyz") for t in re.split("UTOOL_NUM", text)[:2]
        )
    elif language == "inform":
        split = re.split("/{3}POSTYPE (?=USER|ANGLE)", text)
        poses = [each for part in split if part.startswith("USER") for each in numbers(r"C\d+=.*", part)]
        axes = [each for part in split if part.startswith("ANGLE") for each in numbers(r"C\d+=.*", part)]
        frames = {m[1]: float(m[2]) for m in re.finditer(r"^'(\w+ R?[XYZ]) (-?\d+\.\d+)$", text, re.MULTILINE)}
        tool, part = (
            matrix(tuple(frames[f"{name} {axis}"] for axis in ("X", "Y", "Z", "RX", "RY", "RZ")), "xyz")
            for name in ("TOOL1", "USER1")
        )
    elif language == "val3":
        (tool,), (part,) = (
            [matrix(v, "XYZ") for v in numbers(rf'x=.*fatherId="{father}\[0\]"', text)]
            for father in ("flange", "world")
        )
        poses, axes = (
            numbers(r"x=.*fPart\[0\]", text),
            numbers(r'j1="[^/]*/>', re.sub(r'j\d="', '"', text).replace('key="', 'j1="')),
        )
        axes = [each[-6:] for each in numbers(r'j1=".*" />', text)]
    elif language == "melfa":
        part, (tool,) = np.eye(4), (matrix(v, "xyz") for v in numbers(r"Tool .*", text))
        poses, axes = numbers(r"P\d+=\(.*\)\(", text), numbers(r"J\d+=.*", text)
    else:
        found = {
            m[1]: matrix(tuple(map(float, m[2].split(","))), "ZYZ")
            for m in re.finditer(r"(TOOL|BASE) TRANS\((.*)\)", text)
        }
        tool, part = found["TOOL"], found["BASE"]
        poses, axes = numbers(r"(?:LMOVE|C2MOVE) TRANS.*", text), numbers(r"JMOVE #PPOINT.*", text)
    return poses, axes, tool, part


ORDER = {"fanuc": "xyz", "inform": "xyz", "melfa": "xyz", "val3": "XYZ", "kawasaki": "ZYZ"}


@pytest.mark.slow(keep=1)
@pytest.mark.parametrize("language", ARMS)
def test_targets_are_where_the_plan_has_the_nozzle(language: str) -> None:
    """The maker's axes, tool and part frame alone put each target where the plan's joints have it."""
    plan = arc()
    poses, axes, tool, part = said(language, written(language))
    if language == "melfa":  # whose positions are in the base frame
        part = np.eye(4)
    q = plan.trajectory.q
    convention = MAKERS[language][0]
    planned = np.array([np.linalg.inv(part) @ controller(language, row) @ tool for row in convention.counted(q)])
    moves = plan_moves(plan, arcs=language != "inform")
    # which stand among the positions there, with the beginnings of arcs where no line or arc ends
    middles = int(moves.circular.sum()) if language in ("fanuc", "val3", "melfa") else 0
    if language == "melfa":
        middles += int((moves.circular & ~np.append(False, moves.linear[:-1])).sum())
    assert len(poses) == moves.linear.sum() + middles and len(axes) == len(moves) + 1 - moves.linear.sum()
    near = 2.0 * plan.problem.program.chord
    for values in poses:
        T = matrix(values, ORDER[language])
        off = np.linalg.norm(planned[:, :3, 3] - T[:3, 3], axis=1)
        k = int(np.argmin(off))
        assert off[k] < near
        assert Rotation.from_matrix(planned[k, :3, :3].T @ T[:3, :3]).magnitude() < np.radians(0.5)
    for values in axes:
        assert np.abs(convention.counted(q) - np.radians(values)).max(axis=1).min() < 1e-5


@pytest.mark.slow(keep=5)
@pytest.mark.parametrize("language", ARMS)
@pytest.mark.parametrize(
    "changes", [{}, {"arm": "irb140"}, {"beads": 3, "dip": False}, {"materials": ("pla", "pva")}], ids=str
)
def test_the_program_repeats_the_plan(language: str, changes: dict[str, object]) -> None:
    assert differences(language, written(language, **changes), arc(**changes)) == []


@pytest.mark.parametrize("language", ["fanuc", "val3", "kawasaki", "melfa"])
def test_arcs_are_written_unless_they_are_not_wanted(language: str) -> None:
    word = {"fanuc": r"\d:C P\[", "val3": r"movec\(", "kawasaki": "C1MOVE ", "melfa": "Mvr "}[language]
    count = plan_moves(arc(), arcs=True).circular.sum()
    assert count > 3 and len(re.findall(word, "".join(written(language).values()))) == count
    spec = SimpleNamespace(**vars(arc().problem))
    spec.program = arc().problem.program.model_copy(update={"arcs": False})
    plain = replace(arc(), problem=spec)  # type: ignore[arg-type]
    files = module(language).write(plain)
    assert not re.search(word, "".join(files.values())) and differences(language, files, plain) == []


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("language", ARMS)
def test_rests_in_a_bead_are_kept(language: str) -> None:
    plan = resting_in_a_bead(arc(dip=False))
    files = module(language).write(plan)
    pattern = {
        "fanuc": r"FINE DB    0.0mm,DO\[1\]=OFF ;\n *\d+:  !cut, bead 0 ;\n *\d+:  WAIT   0.50\(sec\) ;",
        "inform": r"PL=0\nDOUT OT#\(1\) OFF\n' cut, bead 0\nTIMER T=0.50\n",
        "val3": r"  nAt1\[\d+\]=move[lc]\(.*\)\n  // cut, bead 0\n  waitEndMove\(\)\n  delay\(0.500\)\n",
        "kawasaki": r"  BREAK\n  SIGNAL -1\n  ; cut, bead 0\n  TWAIT 0.500\n",
        "melfa": r" Cnt 0\n\d+ M_Out\(1\)=0\n\d+ ' cut, bead 0\n\d+ Dly 0.500\n",
    }[language]
    name = next(name for name, text in files.items() if re.search(pattern, text))
    assert differences(language, files, plan) == []
    longer = re.sub(pattern, lambda match: match[0].replace("0.50", "0.60"), files[name])
    assert any("wait" in each for each in differences(language, files | {name: longer}, plan))


@pytest.mark.parametrize(
    ("language", "time", "lines"),
    [
        ("fanuc", 700.126, ["WAIT   300.00(sec)", "WAIT   300.00(sec)", "WAIT   100.13(sec)"]),
        ("fanuc", 300.0, ["WAIT   300.00(sec)"]),
        ("inform", 700.126, ["TIMER T=600.00", "TIMER T=100.13"]),
        ("inform", 0.004, []),
    ],
)
def test_waits_are_no_longer_than_a_controller_takes(language: str, time: float, lines: list[str]) -> None:
    moves = SimpleNamespace(waits={0: (Wait("cool", time),)})
    assert module(language)._rests(moves, 0)[1:] == lines  # behind the remark


@pytest.mark.parametrize("language", ARMS)
def test_without_run_in_the_extruder_goes_on_at_the_start_of_the_bead(language: str) -> None:
    spec = SimpleNamespace(**vars(arc().problem))
    spec.process = arc().problem.process.model_copy(update={"run_in": 0.0})
    plan = replace(arc(), problem=spec)  # type: ignore[arg-type]
    assert differences(language, module(language).write(plan), plan) == []


@pytest.mark.parametrize("language", ARMS)
def test_a_longer_program_is_programs_that_are_called(language: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module(language), "MOST_MOVES", 12)
    files: Files = module(language).write(arc())
    assert differences(language, files) == []
    move = {
        "fanuc": r"\d:[JLC] ",
        "inform": "MOV[JL]",
        "val3": "move[jlc]",
        "kawasaki": "JMOVE|LMOVE|C2MOVE",
        "melfa": r"\d (?:Mov|Mvs|Mvr) ",
    }[language]
    texts = files.values() if language != "kawasaki" else re.split(r"(?=\.PROGRAM)", next(iter(files.values())))[1:]
    counts = [len(re.findall(move, text)) for text in texts]
    assert max(counts) == 12 and sum(counts) == len(plan_moves(arc(), arcs=language != "inform")) + 1
    last = max(re.findall(r"(?:_|part)(\d)\b", "\n".join([*files, *files.values()])))
    for gone in ([f"TWOBEADS_{last}.ls"], [f"TWOBEADS_{last}.JBI"], [f"part{last}.pgx"], [f"TWOBEADS_{last}.prg"]):
        if set(gone) <= set(files):
            with pytest.raises(InputError):
                differences(language, {name: text for name, text in files.items() if name not in gone})


@pytest.mark.parametrize(
    ("most", "value", "noted"), [("MOST_LINES", 50, True), ("MOST_POSITIONS", 50, True), ("MOST_LINES", 5000, False)]
)
def test_programs_that_are_more_than_a_controller_holds_say_so(
    most: str, value: int, noted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module("melfa"), most, value)
    main, *parts = module("melfa").write(arc()).values()
    positions = sum(len(re.findall(r"^[PJ]\d+=", text, re.MULTILINE)) for text in parts)
    lines = sum(len(re.findall(r"^\d+ ", text, re.MULTILINE)) for text in parts)
    assert f"' Calls {len(parts)} programs with {positions} positions and {lines} lines in all" in main
    assert ("' Note: a CR750 is said to hold" in main) == noted


def test_more_switches_than_an_array_holds_are_in_several(monkeypatch: pytest.MonkeyPatch) -> None:
    val3 = module("val3")
    monkeypatch.setattr(val3, "MOST_SWITCHES", 3)
    files: Files = val3.write(arc())
    sizes = re.findall(r'name="(nAt|nOut|bOn)(\d)" .* size="(\d)"', files["TwoBeads.dtx"])
    assert sizes == [(name, k, size) for k, size in (("1", "3"), ("2", "1")) for name in ("nAt", "nOut", "bOn")]
    assert "nAt2[0]=move" in files["part1.pgx"] and differences("val3", files) == []
    with pytest.raises(InputError, match="other switches than the tables"):
        differences("val3", files | {"part1.pgx": files["part1.pgx"].replace("nAt2[0]", "nAt1[3]")})
    monkeypatch.setattr(val3, "MOST_ELEMENTS", 20)
    with pytest.raises(InputError, match="has more than 20 elements"):
        differences("val3", files)


@pytest.mark.slow(keep=2)
@pytest.mark.parametrize("language", ARMS)
def test_a_solved_print(language: str) -> None:
    """On a base that stands elsewhere than the world's origin."""
    plan = bed_plan()
    assert differences(language, module(language).write(plan), plan) == []


@pytest.mark.parametrize("language", ARMS)
def test_lines_are_ascii_and_bounded(language: str) -> None:
    for text in module(language).write(replace(arc(), strategy="ladder ü" + "x" * 300)).values():
        assert text.isascii() and all(len(line) <= 170 for line in text.split("\n"))
        remarks = re.findall(r"^ *\d+:  !(.*) ;$", text, re.MULTILINE) + re.findall(r"^'(.*)$", text, re.MULTILINE)
        assert all(len(remark) <= 32 for remark in remarks)


def test_each_number_of_a_frame_has_a_comment_that_is_short_enough() -> None:
    T = matrix((1234.567, -1234.567, -1000.0, -179.1234, -45.1234, -120.0), "xyz")
    lines = frame_comments("TOOL1", T)
    assert [line.split(" ")[1] for line in lines] == list(FRAME) and max(map(len, lines)) <= 32
    assert lines[0] == "'TOOL1 X 1234.567" and lines[3] == "'TOOL1 RX -179.1234"


# ---- what cannot be said ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("language", ARMS)
def test_what_cannot_be_said(language: str) -> None:
    def reason(cell: Any, problem: Any = None) -> str:
        return str(LANGUAGES[language].unsupported(SimpleNamespace(problem=problem or arc().problem, cell=cell)))

    assert reason(arc().cell) == "None"
    assert "which Universal Robots UR5e does not have" in reason(make_plan(positioner=False, arm="ur5e").cell)
    moved = make_plan(arm="kr6_r900")
    assert reason(moved.cell) == "it moves the arm alone, and here ABB IRBP A250 moves the part"
    with pytest.raises(ValueError, match="moves the part"):
        LANGUAGES[language].write(moved)
    if language == "melfa":  # whose outputs count from 0, and are as many as the cell has
        return
    wanted = 40 if language == "val3" else 0
    spec = SimpleNamespace(**vars(arc().problem))
    spec.program = arc().problem.program.model_copy(update={"extruder_output": wanted})
    assert ("the last one is 15" if wanted else "outputs count from 1") in reason(arc().cell, spec)


# ---- what is read back --------------------------------------------------------------------------------------------

MM, DEGREE = 0.25, 0.6


def more(amount: float, which: int = 0) -> Callable[[re.Match[str]], str]:
    """The number at a place of what was matched, and more."""

    def change(match: re.Match[str]) -> str:
        spots = list(re.finditer(r"-?\d+\.\d+", match[0]))
        spot = spots[which]
        decimals = len(spot[0].split(".")[1])
        return f"{match[0][: spot.start()]}{float(spot[0]) + amount:.{decimals}f}{match[0][spot.end() :]}"

    return change


def to(old: str, new: str) -> Callable[[re.Match[str]], str]:
    return lambda match: match[0].replace(old, new, 1)


def gone(match: re.Match[str]) -> str:
    """What was matched is left out."""
    return ""


Tampering = tuple[str, str, Callable[[re.Match[str]], str], int, str]
TAMPERED: dict[str, list[Tampering]] = {
    "fanuc": [
        (".ls", r"X =.*", more(MM), 5, "path"),
        (".ls", r"W =.*", more(DEGREE, 1), 5, "differs"),
        (".ls", r"J1=.*", more(0.01), 5, "axes differ"),
        (".ls", r"J1=.*", more(0.01, 2), 9, "axes differ"),
        (".ls", r"CONFIG : '.", lambda m: m[0][:-1] + "FN"["NF".index(m[0][-1])], 0, "CONFIG"),
        (".ls", r"CONFIG : '. . ., 0", to(", 0", ", 1"), 0, "CONFIG"),
        (".ls", r"PR\[9,3\]=.*", more(0.1), 0, "frames"),
        (".ls", r"PR\[9,1\]=.*", more(0.1), 1, "frames"),
        (".ls", r" \d+cm/min", lambda m: " 99cm/min", 6, "speeds of lines"),
        (".ls", r"J .*%", lambda m: re.sub(r"\d+%", "100%", m[0]), 4, "speeds of axes"),
        (".ls", r"\d:L .*CNT100", to("CNT100", "FINE"), 3, "stops"),
        (".ls", r"\d:J .*CNT100", to("CNT100", "FINE"), 3, "stops elsewhere"),
        (".ls", r"DB .*ON", to("=ON", "=OFF"), 0, "path"),
        (".ls", r"DB .*ON", to("[1]", "[2]"), 0, "output"),
        (".ls", r" DB .*OFF", gone, 0, "path"),
        (".ls", r"DO\[1\]=OFF ;\n", to("1", "2"), 0, "outputs"),
        (".ls", r"DO\[1\]=OFF ;\n/POS", to("1", "2"), 0, "outputs"),
    ],
    "inform": [
        (".JBI", r"RCONF (?:.*\n){9}", more(MM, -12), 0, "path"),
        (".JBI", r"RCONF .*\n.*\n", more(DEGREE, 5), 0, ""),
        (".JBI", r"ANGLE\n(?:C.*\n){6}", more(0.01, -4), 1, "axes differ"),
        (".JBI", r"RCONF 0", to("0", "1"), 0, "RCONF"),
        (".JBI", r"'TOOL1 .*", more(0.1), 0, "frames"),
        (".JBI", r"'USER1 RY .*", more(0.5), 0, "a"),
        (".JBI", r"MOVL .* V=.*", more(5.0), 4, "speeds of lines"),
        (".JBI", r"MOVJ .* VJ=.*", more(5.0), 4, "speeds of axes"),
        (".JBI", r"MOVL .*\d\n", lambda m: m[0][:-1] + " PL=0\n", 4, "stops"),
        (".JBI", r"MOVJ .* PL=0", to(" PL=0", ""), 1, "stops elsewhere"),
        (".JBI", r"DOUT .* ON", to("ON", "OFF"), 0, "path"),
        (".JBI", r"DOUT .* ON", to("(1)", "(2)"), 0, "output"),
    ],
    "val3": [
        (".dtx", r"<Value.*fPart", more(MM), 5, "path"),
        (".dtx", r"<Value.*fPart", more(DEGREE, 4), 5, "a"),
        (".dtx", r"<Value.*j6=.*", more(0.01), 5, "axes differ"),
        (".dtx", r"<Value.*flange", more(0.1), 0, "frames"),
        (".dtx", r"<Value.*world", more(0.1), 0, "frames"),
        (".dtx", r'tmax="\d+\.\d+" rmax="99999" blend="Cart', more(5.0), 1, "speeds of lines"),
        (".dtx", r'vel="\d+" .*Joint', lambda m: re.sub(r'vel="\d+"', 'vel="100"', m[0]), 0, "speeds of axes"),
        (".dtx", r'vel="100" .*Cart', to('vel="100"', 'vel="50"'), 1, "may limit"),
        (".dtx", r'tmax="99999.00" .*Joint', to("99999.00", "900.00"), 0, "may limit"),
        (".dtx", r'blend="Cartesian".*', to("Cartesian", "off"), 2, "stops"),
        (".dtx", r'leave="[^/]*/>', lambda m: re.sub(r'"[\d.]+"', '"9.000"', m[0]), 9, "middle of a line"),
        (".dtx", r'value="true"', to("true", "false"), 0, "path"),
        (".dtx", r'type="num" size="4">\n.*value="0"', to('value="0"', 'value="1"'), 0, "there is no output"),
        ("part1.pgx", r"nAt1\[(\d)\]=(move.*)\n(.*)(move.*)", lambda m: f"{m[2]}\n  nAt1[{m[1]}]={m[4]}", 0, "event"),
    ],
    "melfa": [
        ("_1.prg", r"P1=.*", more(2.0), 0, ""),
        ("_1.prg", r"P2=.*", more(DEGREE, 4), 0, "at via points of arcs"),
        ("_1.prg", r"J5=.*", more(0.01, 3), 0, "axes differ"),
        ("_1.prg", r"P1=.*\)\(\d", lambda m: m[0][:-1] + str(int(m[0][-1]) ^ 1), 0, "flags"),
        ("_1.prg", r"P1=.*,0\)", lambda m: m[0][:-2] + "16)", 0, "flags"),
        ("S.prg", r"Tool .*", more(0.1), 0, "frames"),
        ("_1.prg", r"Spd .*", more(5.0), 0, "speeds of lines"),
        ("_1.prg", r"JOvrd \d+", lambda m: "JOvrd 99", 0, "speeds of axes"),
        ("_1.prg", r"Cnt 1,.*", lambda m: "Cnt 1,9.00,9.00", 3, "blends"),
        ("_1.prg", r"Cnt 1,.*", lambda m: "Cnt 0", 9, "stops"),
        ("_1.prg", r"Wth M_Out\(1\)=1", to("=1", "=0"), 0, "path"),
        ("_1.prg", r"Wth M_Out\(1\)=1", to("(1)", "(2)"), 0, "output"),
        ("_1.prg", r" Wth M_Out\(1\)=0", gone, 0, "path"),
        ("S.prg", r"M_Out\(1\)=0", to("(1)", "(2)"), 0, "outputs"),
        ("_1.prg", r"Mvr (P\d+),(P\d+),(P\d+)", lambda m: f"Mvr {m[1]},{m[3]},{m[2]}", 1, ""),
    ],
    "kawasaki": [
        (".as", r"C2MOVE .*", more(MM), 2, "path"),
        (".as", r"C1MOVE .*", more(0.5), 2, "path"),
        (".as", r"C2MOVE .*", more(DEGREE, 4), 2, "differs"),
        (".as", r"LMOVE .*", more(2.0), 2, "differs"),
        (".as", r"JMOVE .*", more(0.01, 3), 5, "axes differ"),
        (".as", r"TOOL .*", more(0.1), 0, "frames"),
        (".as", r"BASE T.*", more(0.1), 0, "frames"),
        (".as", r"SPEED .* MM/S", more(5.0), 1, "speeds of lines"),
        (".as", r"SPEED \d+ ALWAYS", lambda m: "SPEED 100 ALWAYS", 1, "speeds of axes"),
        (".as", r"ACCURACY .*\n  LMOVE", lambda m: "ACCURACY 9.00 ALWAYS\n  LMOVE", 0, "middle of a line"),
        (".as", r"LMOVE .*\n", lambda m: m[0] + "  BREAK\n", 1, "stops"),
        (".as", r"  SIGNAL 1\n", to("1", "-1"), 0, "path"),
        (".as", r"  SIGNAL 1\n", to("1", "2"), 0, "output"),
        (".as", r"  SIGNAL -1\n", gone, 2, "path"),
        (".as", r"  SIGNAL -1\n", gone, 0, "outputs"),
        (".as", r"  SIGNAL -1\n", gone, 1, "outputs"),
    ],
}


@pytest.mark.slow(keep=16)
@pytest.mark.parametrize(
    ("language", "ending", "pattern", "change", "which", "named"),
    [
        pytest.param(name, *row, id=f"{name}-{i}-{row[4]}")
        for name, rows in TAMPERED.items()
        for i, row in enumerate(rows)
    ],
)
def test_a_program_that_says_something_else_is_found(
    language: str, ending: str, pattern: str, change: Callable[[re.Match[str]], str], which: int, named: str
) -> None:
    files = written(language)
    name = next(name for name in files if name.endswith(ending))
    matches = list(re.finditer(pattern, files[name]))
    match = matches[which % len(matches)]
    changed = files[name][: match.start()] + change(match) + files[name][match.end() :]
    assert changed != files[name]
    try:
        found = differences(language, files | {name: changed})
    except InputError as error:
        found = [str(error)]
    assert any(named in difference for difference in found), found


@pytest.mark.parametrize(
    ("language", "ending", "old", "new", "message"),
    [
        ("fanuc", ".ls", ":L P", ":A P", "unknown statement"),
        ("fanuc", ".ls", "/POS", "/OTHER", "no complete program"),
        ("fanuc", ".ls", "X =", "X =nan", "unknown position"),
        ("fanuc", ".ls", "P[5]{", "P[4]{", "twice"),
        ("fanuc", ".ls", "P[5]{", "P[500]{", r"P\[5\] is missing"),
        ("fanuc", ".ls", "   3:", "   4:", "number is missing or out of order"),
        ("fanuc", ".ls", "UTOOL_NUM=9", "UTOOL_NUM=8", "unknown statement"),
        ("fanuc", ".ls", "UTOOL[9]=PR[9]", "UFRAME[9]=PR[9]", "selected but not set"),
        ("fanuc", ".ls", "/PROG  TWOBEADS", "/PROG  OTHERS", "no complete program TWOBEADS"),
        ("inform", ".JBI", "MOVL C", "MOVS C", "unknown statement"),
        ("inform", ".JBI", "///NPOS ", "///NPOS 1", "NPOS says"),
        ("inform", ".JBI", "C00005=", "C00006=", "out of order"),
        ("inform", ".JBI", "///RCONF 0", "///RCONF 2", "unknown statement"),
        ("inform", ".JBI", "///RECTAN\n", "", "without tool"),
        ("inform", ".JBI", "MOVL C0", "MOVL C9", "is missing"),
        ("inform", ".JBI", "'USER1 ", "' ", "no tool or user frame"),
        ("inform", ".JBI", "\nEND\n", "\n", "no complete job"),
        ("val3", "part1.pgx", "movel(", "moveq(", "unknown statement"),
        ("val3", "part1.pgx", "movel(pPath1[", "movel(pPath1[9", "there is no element"),
        ("val3", "part1.pgx", "begin", "start", "no complete program"),
        ("val3", "start.pgx", '  taskKill("extruder")\n', "", "does not run from before"),
        ("val3", "start.pgx", "nAt1[nSwitch]=-1", "nAt1[nSwitch]=0", "not cleared"),
        ("val3", "start.pgx", "  waitEndMove()\n", "", "before the arm has come to rest"),
        ("val3", "extruder.pgx", ">=nAt", ">nAt", "not the program of this application"),
        ("val3", ".pjx", "part1", "part2", "no complete application"),
        ("val3", ".dtx", 'key="3"', 'key="4"', "out of order"),
        ("val3", ".dtx", 'size="1"', 'size="2"', "does not have the size"),
        ("val3", ".dtx", 'shoulder="ssame"', 'shoulder="lefty"', "unknown statement"),
        ("val3", ".dtx", 'name="nAt1"', 'name="nAr1"', "data are missing"),
        ("melfa", "_1.prg", "Mvs P", "Mva P", "unknown statement"),
        ("melfa", "_1.prg", "\n5 ", "\n6 ", "number is missing or out of order"),
        ("melfa", "_1.prg", " End\n", " Cnt 0\n", "whose number is missing"),
        ("melfa", "_1.prg", "Mvs P1", "Mvs P999", "there is no position P999"),
        ("melfa", "_1.prg", "\nP2=(", "\nP1=(", "twice"),
        ("melfa", "_1.prg", "\nP2=(", "\nP2=(nan", "unknown position"),
        ("melfa", "_1.prg", "Mvr P1,", "Mvr P2,", "does not begin where"),
        ("melfa", "S.prg", "Ovrd 100", "Ovrd 10", "unknown statement"),
        ("melfa", "S.prg", "Base P_NBase", "Ovrd 100", "base and override"),
        ("melfa", "S.prg", "TWOBEADS_1", "TWOBEADS_2", "is not a program"),
        ("kawasaki", ".as", "LMOVE TRANS", "XMOVE TRANS", "unknown statement"),
        ("kawasaki", ".as", "  CP ON\n", "", "switches are not set"),
        ("kawasaki", ".as", "  BASE NULL\n", "", "not set and reset"),
        ("kawasaki", ".as", "C1MOVE", "LMOVE", "must come in pairs"),
        ("kawasaki", ".as", "CALL twobeads_1", "CALL twobeads_2", "is not a program"),
        ("kawasaki", ".as", "  JMOVE", "  TOOL TRANS(0,0,0,0,0,0)\n  JMOVE", "twice"),
        ("kawasaki", ".as", ".END\n.PROGRAM", ".PROGRAM", "inside a program"),
    ],
)
def test_reader_refuses_what_it_does_not_know(language: str, ending: str, old: str, new: str, message: str) -> None:
    files = written(language)
    name = next(name for name in files if name.endswith(ending))
    assert old in files[name]
    with pytest.raises(InputError, match=message):
        differences(language, files | {name: files[name].replace(old, new, 1)})


@pytest.mark.slow(cases=("kawasaki", "inform"))
@pytest.mark.parametrize("language", ARMS)
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_file_that_lacks_a_line_or_has_one_twice_is_found(language: str, data: st.DataObject) -> None:
    """Never an error of another kind, and never taken for the plan, unless the line is a remark."""
    files = written(language)
    name = data.draw(st.sampled_from(sorted(files)))
    lines = files[name].split("\n")
    k = data.draw(st.integers(0, len(lines) - 2))
    twice = data.draw(st.booleans())
    changed = "\n".join([*lines[: k + twice], *lines[k + (not twice) :]])
    try:
        found = differences(language, files | {name: changed})
    except InputError:
        return
    bare = re.sub(r"^ *\d+:|^\d+ (?=[A-Z'])", "", lines[k]).strip()
    harmless = bare.startswith(("!", "'", "//", ";", "<!--")) or re.match(r"[A-Z_]+\t+= ", bare)
    repeated = twice and re.match(
        r"SPEED|ACCURACY|BASE NULL|Spd|JOvrd|Cnt|PR\[9|U[A-Z]+(\[9\]=|_NUM)|///|waitEnd|SIGNAL|DOUT|DO\[|dOut|nAt", bare
    )
    # the same speed may stand in what is called
    spared = not twice and re.match(r"SPEED \d+ |///TOOL|PR\[9", bare)
    assert found or harmless or repeated or spared, lines[k]


# ---- parts and speeds ---------------------------------------------------------------------------------------------


@given(st.lists(st.integers(1, 30), max_size=40), st.integers(5, 60), st.integers(1, 6))
def test_packing_keeps_order_and_bounds(sizes: list[int], most: int, count: int) -> None:
    groups = packed(range(len(sizes)), sizes, most, count)
    assert [item for group in groups for item in group] == list(range(len(sizes)))
    for group in groups:
        assert 0 < len(group) <= count
        assert len(group) == 1 or sum(sizes[item] for item in group) <= most


def test_a_section_has_the_number_of_its_bead() -> None:
    """Two beads without travel between are one section, and the next one keeps its number."""
    bead = np.array([-1, 0, 0, 1, 1, -1, 2, 2, -1])
    t = SimpleNamespace(bead=bead, deposit=bead >= 0, s=np.zeros(9), layer=np.zeros(9, dtype=int), events=())
    beads = tuple(SimpleNamespace(material="") for _ in range(3))
    plan: Any = SimpleNamespace(trajectory=t, toolpath=SimpleNamespace(beads=beads), first_bead=0)
    moves: Any = SimpleNamespace(after=np.array([0, 0, 0, 1, 1, 2]))
    assert [section.number for section in sections(plan, moves)] == [1, 3, 0]


@given(st.lists(st.integers(1, 50), min_size=1, max_size=20), st.integers(1, 30))
def test_sections_are_cut_to_size(lengths: list[int], most: int) -> None:
    ends = np.cumsum([0, *lengths]).tolist()
    whole = [MoveSection(k + 1, range(a, b), f"Bead {k}") for k, (a, b) in enumerate(zip(ends, ends[1:], strict=False))]
    pieces = list(cut(whole, most))
    assert [i for piece in pieces for i in piece.moves] == list(range(ends[-1]))
    assert all(len(piece.moves) <= most for piece in pieces)
    assert all(sum(len(piece.moves) for piece in group) <= most for group in in_files(whole, most))


def straight(distance: Array, length: float, z: float, turn: float) -> tuple[Array, Array]:
    """Tip and normal (k, 3) at the distance from the start of a straight bead."""
    normal = np.tile([-1.0, 0.0, 0.0], (len(distance), 1))
    place = np.append(export_fixtures.CENTRE, z) + export_fixtures.RADIUS * normal
    return place + np.outer(distance - 0.5 * length, [0.0, 1.0, 0.0]), normal


def slow(speed: float, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """A straight bead of 80 mm at a speed [m/s]: four moves."""
    monkeypatch.setattr(export_fixtures, "SPEED", speed)
    monkeypatch.setattr(export_fixtures, "_bead_pose", straight)
    plan: Plan = make_plan.__wrapped__(positioner=False, arm="kr6_r900", beads=1, dip=False, length=0.08)
    return plan


@pytest.mark.parametrize(
    ("language", "speed", "written"),
    [("inform", 5.05e-3, ("V=5.1", "V=5.0", "V=5.2")), ("fanuc", 5.3e-3, ("32cm/min", "31cm/min", "33cm/min"))],
)
def test_speeds_between_the_steps_of_a_language(
    language: str, speed: float, written: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long move misses its time by half a step, which the next ones make up for."""
    plan = slow(speed, monkeypatch)
    ((name, text),) = module(language).write(plan).items()
    near, other, wrong = written
    assert near in text and other in text
    assert differences(language, {name: text}, plan) == []
    found = differences(language, {name: text.replace(other, wrong, 1)}, plan)
    assert "speeds of lines are not the planned ones" in found and any(each.startswith("late") for each in found)


@pytest.mark.parametrize("language", ["inform", "fanuc"])
def test_a_speed_that_steps_are_too_coarse_for_is_told(language: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = slow(0.93e-3, monkeypatch)
    (found,) = differences(language, module(language).write(plan), plan)
    assert found.startswith("late differs by")


def test_parts_of_a_resumed_print_keep_their_place_in_the_name() -> None:
    assert numbered("TwoBeads", 3, 24) == "TwoBeads_3"
    for name, k, longest, form in (
        ("AVeryLongNameOfAPrFrom12", 3, 24, r"AVeryLongName\d{3}From12_3"),
        ("TWOBEADFROM1", 12, 12, r"T\d{3}FROM1_12"),
        ("TWOBEFROM123", 12, 12, r"T\dFROM123_12"),
    ):
        found = numbered(name, k, longest)
        assert len(found) == longest and re.fullmatch(form, found)


def test_programs_whose_names_are_alike_share_no_part() -> None:
    """Cut to the length of a part's name, both are one: the second one copied would be called by the first, too."""
    names = ["AerofoilCoreTaperedRevA", "AerofoilCoreTaperedRevB"]
    first, second = (numbered(name, 1, 24) for name in names)
    assert first != second and len(first) == len(second) == 24
    assert first[:19] == second[:19] == "AerofoilCoreTapered" and first[-2:] == "_1"
    assert first == numbered(names[0], 1, 24) and numbered(names[0], 1, 32) == "AerofoilCoreTaperedRevA_1"


def test_speeds_in_steps_never_let_a_bead_run_late() -> None:
    rng = np.random.default_rng(7)
    speed, length = rng.uniform(0.003, 0.05, 5000), rng.uniform(0.5e-3, 5e-3, 5000)
    laid = np.ones(5000, dtype=bool)
    laid[::500] = False
    moves: Any = SimpleNamespace(speed=speed, length=length, laid=laid)
    for step in (1e-3, 1.0 / 6000.0, 1e-4):
        found = stepped_speeds(moves, step)
        assert (
            np.abs(found / step - np.round(found / step)).max() < 1e-6 and np.abs(found - speed).max() <= step + 1e-12
        )
        late = np.where(laid, length / found - length / speed, 0.0).reshape(10, 500).cumsum(axis=1)
        assert np.abs(late).max() <= (length / (speed - step) - length / speed).max()
