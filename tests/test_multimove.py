"""A second arm that moves the part: two tasks of RAPID in step, read back, played, and found where they were changed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from export_fixtures import two_arms_plan, written_with
from hypothesis import given, settings
from hypothesis import strategies as st
from solved import solve_alone

from planner.base.errors import InputError
from planner.base.rapid_names import ARMS
from planner.cell.cell import Cell, build_cell
from planner.export.languages import LANGUAGES, chosen
from planner.export.plan_json import plan_json
from planner.export.player.play import limited, play
from planner.export.player.played import laid_spans
from planner.export.program import ProblemSetup, RobotProgram
from planner.export.rapid.multimove import TASKS, second_name
from planner.export.rapid.reader import read_rapid, read_rapid_files
from planner.feedback.identify_program import language_of
from planner.link.connections import Address, LinkError, Secret
from planner.link.guided_motion import read_plan
from planner.link.robot import bring, program_files, programs_of
from planner.link.rws import Rws
from planner.link.streaming import stream_of
from planner.plan import Plan
from planner.problem import load_problem
from planner.simulate.rws import Access
from planner.simulate.start import start

RAPID = LANGUAGES["rapid"]
NOZZLE, SECOND = "TwoArms.mod", "TwoArms_Rob2.mod"
STYLES = ("output", "socket", "demand")
JOINT = 5  # of the second arm's joints, the one that is free


@cache
def plan() -> Plan:
    return two_arms_plan(style="socket")


@cache
def written() -> dict[str, str]:
    return RAPID.write(plan())


def changed(**files: Callable[[str], str]) -> dict[str, str]:
    """The program's files, some of them changed."""
    names = {"nozzle": NOZZLE, "second": SECOND}
    out = dict(written())
    for which, change in files.items():
        out[names[which]] = change(out[names[which]])
        assert out[names[which]] != written()[names[which]]
    return out


def wrong(files: dict[str, str]) -> str:
    """What is found to be wrong with a program, in words; empty where nothing is."""
    try:
        return "; ".join(RAPID.differences(plan(), files))
    except InputError as error:
        return str(error)


def instead(old: str, new: str, which: int = 0) -> Callable[[str], str]:
    """Replaces the which-th match of a pattern."""

    def change(text: str) -> str:
        matches = list(re.finditer(old, text))
        at = matches[which]
        return text[: at.start()] + at.expand(new) + text[at.end() :]

    return change


def by(amount: float, pattern: str, which: int) -> Callable[[str], str]:
    """Adds an amount to the number that a pattern ends with."""

    def change(text: str) -> str:
        at = list(re.finditer(pattern + r"(-?\d+\.\d+)", text))[which]
        return text[: at.start(1)] + f"{float(at[1]) + amount:.5f}" + text[at.end(1) :]

    return change


LAST_OF_SIX = r"MoveAbsJ \[\[(?:-?\d+\.\d+,){5}"
MOVE = r"        Move[JL] \[\["

# ---- what is written ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("style", STYLES)
def test_two_tasks_repeat_the_plan(style: str) -> None:
    own = two_arms_plan(style=style)
    files = RAPID.write(own)
    assert RAPID.differences(own, files) == []
    assert [name for name in files if name.endswith(".pgf")] == ["TwoArms.pgf", "TwoArms_Rob2.pgf"]


def test_all_that_the_nozzle_s_task_does_beside_moving_is_its_own() -> None:
    """The lines for the board, outputs and rests stand in one task; the other only moves, as often."""
    nozzle, second = written()[NOZZLE], written()[SECOND]
    for word in ("BwLine", "SetDO", "TriggIO", "WaitTime", "SocketSend"):
        assert word in nozzle or word == "WaitTime"
        assert word not in second
    identities = [re.findall(r"\\ID:=(\d+)", text) for text in (nozzle, second)]
    assert identities[0] == identities[1] == [str(k + 1) for k in range(len(identities[0]))]
    assert "9E9,9E9,9E9,9E9,9E9,9E9" in nozzle and "ActUnit" not in nozzle
    assert re.search(r'wobjPart:=\[FALSE,FALSE,"ROB_2",\[\[0\.000,0\.000,0\.000\],\[1\.0000000,', nozzle)


def test_long_programs_are_split_in_both_tasks_at_the_same_moves() -> None:
    own = written_with(two_arms_plan(), module_moves=8)
    files = RAPID.write(own)
    assert RAPID.differences(own, files) == []
    counts = [
        [text.count("\\ID:=") for name, text in files.items() if re.fullmatch(pattern, name)]
        for pattern in (r"TwoArms(_\d)?\.mod", r"TwoArms_Rob2(_\d)?\.mod")
    ]
    assert counts[0] == counts[1] and len(counts[0]) > 3
    lost = files | {"TwoArms_Rob2_1.mod": files["TwoArms_Rob2_2.mod"]}
    with pytest.raises(InputError, match=r"twice|unknown name"):
        read_rapid_files(lost)


def test_the_nozzle_s_arm_may_be_either_of_both() -> None:
    own = written_with(two_arms_plan(), station="ROB_1")
    files = RAPID.write(own)
    assert RAPID.differences(own, files) == []
    assert "TwoArms_Rob1.mod" in files and '"ROB_1"' in files["TwoArms.mod"]
    assert "TwoArms.mod in task T_ROB2 and TwoArms_Rob1.mod in T_ROB1" in files["TwoArms.mod"]
    assert tuple(TASKS) == ARMS


def test_the_second_arm_s_module_of_a_rest_keeps_the_bead_that_it_begins_with() -> None:
    assert second_name("TwoArmsFrom12", "ROB_2") == "TwoArmsFrom12_Rob2"
    found = second_name("TurbineBladeSupportLeftFrom12", "ROB_1")
    assert len(found) == 32 and re.fullmatch(r"TurbineBladeSuppor\d{3}From12_Rob1", found)


# ---- played ------------------------------------------------------------------------------------------------------


def test_both_arms_are_played_as_they_are_planned() -> None:
    t, cell = plan().trajectory, plan().cell
    played = play(read_rapid_files(written()), cell)
    assert played.strays == ()
    ((on, off),) = laid_spans(played)
    laid = np.flatnonzero(t.deposit)
    assert abs((off - on) / (len(laid) * t.dt) - 1.0) < 0.02
    assert np.ptp(t.q[laid, 6]) > np.radians(10.0)  # the second arm turns the part while it is printed on
    for share in np.linspace(0.05, 0.95, 19):
        ours = t.q[laid[round(share * (len(laid) - 1))]]
        theirs = played.at(np.array([on + share * (off - on)])).q[0]
        assert np.abs(ours - theirs).max() < np.radians(0.6), share


def test_the_slower_of_two_arms_sets_the_pace_of_both() -> None:
    program, cell = read_rapid_files(written()), plan().cell
    assert program.second is not None
    slow = program.second * np.array([1.0, 0.03, 1.0, 1.0])
    played, slowed = play(program, cell), play(replace(program, second=slow), cell)
    assert slowed.duration > 1.5 * played.duration
    assert [each.by for each in limited(program, played)] == []
    assert limited(program, slowed)[0].by == "the arm that moves the part"
    # its flange turns on the spot: a speed of the flange's centre changes nothing
    still = program.second * np.array([0.01, 1.0, 1.0, 1.0])
    assert play(replace(program, second=still), cell).duration == pytest.approx(played.duration, rel=1e-9)


def test_the_flange_s_own_speed_counts_where_its_centre_moves() -> None:
    """The same program, held by an arm whose first joint turns in place of its last."""
    program = read_rapid_files(written())
    assert program.second is not None
    cell = plan().cell

    def slowed(cell: Cell, share: float) -> float:
        assert program.second is not None
        swung = replace(program, second=program.second * np.array([share, 1.0, 1.0, 1.0]))
        return play(swung, cell).duration

    aside = np.eye(4)
    aside[:3, 3] = [0.3, 0.0, 0.0]
    off_centre = replace(
        cell, T_plate_part=aside @ cell.T_plate_part
    )  # the flange is 0.3 m beside the axis that turns it
    moved = replace(program, oframe=np.concatenate([off_centre.T_plate_part[:3, 3], program.oframe[3:]]))
    program = moved
    assert slowed(off_centre, 0.02) > 1.5 * slowed(off_centre, 1.0)


# ---- changed -----------------------------------------------------------------------------------------------------

TAMPERED: dict[str, tuple[Callable[[], dict[str, str]], str]] = {
    "an identity is missing in the second task": (
        lambda: changed(second=instead(r"\\ID:=7,", ",")),
        r"TwoArms_Rob2\.mod.*no \\ID, though both arms move together",
    ),
    "an identity is missing in the nozzle's task": (
        lambda: changed(nozzle=instead(r"\\ID:=7,", ",")),
        r"TwoArms\.mod.*no \\ID, though both arms move together",
    ),
    "an identity differs": (
        lambda: changed(second=instead(r"\\ID:=(\d+),([^\n]*)\n( *ENDPROC)", r"\\ID:=9\1,\2\n\3", -1)),
        r"meets \\ID:=\d+ of TwoArms\.mod, line \d+: both would wait for ever",
    ),
    "an identity stands twice": (
        lambda: changed(second=instead(r"\\ID:=7,", r"\\ID:=6,")),
        r"\\ID:=6 does not follow \\ID:=6",
    ),
    "identities of two moves are exchanged": (
        lambda: changed(
            second=lambda t: t.replace("\\ID:=7,", "\\ID:=x,").replace("\\ID:=8,", "\\ID:=7,").replace("=x,", "=8,")
        ),
        r"\\ID:=7 does not follow \\ID:=8",
    ),
    "the way to the start has an identity": (
        lambda: changed(second=instead(r"(MoveAbsJ [^\n]*\]),vel", r"\1\\ID:=1,vel")),
        "the way to the start must end at rest, without",
    ),
    "a target of the nozzle alone": (lambda: changed(nozzle=by(0.2, MOVE, 5)), "path differs|travel differs"),
    "a target of the second arm alone": (
        lambda: changed(second=by(0.002, LAST_OF_SIX, 6)),
        "the arm that moves the part goes elsewhere in 1 moves, first move 5",
    ),
    "a held joint of the second arm": (
        lambda: changed(second=by(1.0, r"MoveAbsJ \[\[-?\d+\.\d+,", 6)),
        "positioner_joint_2 of the station is held",
    ),
    "the second arm starts elsewhere": (lambda: changed(second=by(0.5, LAST_OF_SIX, 0)), "frames differs"),
    "a move of the second arm is missing": (
        lambda: changed(
            second=instead(r"        MoveAbsJ [^\n]*\n    ENDPROC\n\nENDMODULE", "    ENDPROC\n\nENDMODULE")
        ),
        r"moves together with \d+ of TwoArms\.mod: one would wait for ever|SyncMoveOff",
    ),
    "the second task never parts": (
        lambda: changed(second=instead(r"        SyncMoveOff bwApart;\n", "")),
        r"TwoArms_Rob2\.mod.*SyncMoveOff is missing",
    ),
    "the nozzle's task never parts": (
        lambda: changed(nozzle=instead(r"        SyncMoveOff bwApart;\n", "")),
        r"TwoArms\.mod.*SyncMoveOff is missing",
    ),
    "one task never moves together": (
        lambda: changed(second=instead(r"        SyncMoveOn bwTogether,bwTasks;\n", "")),
        r"SyncMoveOff bwApart;' is not allowed out of order|no \\ID|\\ID outside SyncMoveOn|the way to the start",
    ),
    "both arms go to their starts at once": (
        lambda: changed(second=instead(r"(        MoveAbsJ [^\n]*\n)(        WaitSyncTask [^\n]*\n)", r"\2\1")),
        "has not gone to its start",
    ),
    "nobody waits before the start": (
        lambda: changed(nozzle=instead(r"        WaitSyncTask [^\n]*\n", "")),
        "out of order",
    ),
    "another point": (
        lambda: changed(second=instead("WaitSyncTask bwPlaced", "WaitSyncTask bwApart")),
        "unknown name 'bwApart'|other points",
    ),
    "points have other names in the two tasks": (
        lambda: changed(second=lambda t: t.replace("bwPlaced", "bwThere")),
        "it meets TwoArms.mod at other points",
    ),
    "a task list of one task": (
        lambda: changed(second=instead(r'\{2\}:=\[\["T_ROB1"\],\["T_ROB2"\]\]', r'{1}:=[["T_ROB2"]]')),
        "unknown statement",
    ),
    "another task list": (lambda: changed(second=lambda t: t.replace("bwTasks", "bwOthers")), "other tasks"),
    "the nozzle's own arm moves the part": (
        lambda: changed(nozzle=instead('"ROB_2"', '"ROB_1"')),
        "the part is moved by ROB_1, not by ROB_2",
    ),
    "a positioner moves the part": (
        lambda: changed(nozzle=instead('"ROB_2"', '"STN1"')),
        "moved by 'STN1', not by an arm",
    ),
    "nothing moves the part": (
        lambda: changed(nozzle=instead('FALSE,"ROB_2"', 'TRUE,""')),
        "moved by '', not by an arm",
    ),
    "the part stands elsewhere on the flange": (
        lambda: changed(nozzle=by(1.0, r'"ROB_2",\[\[[^\]]*\],\[[^\]]*\]\],\[\[', 0)),
        "frames differs",
    ),
    "a zone of the second arm": (
        lambda: changed(second=instead(r"(\\ID:=8,vel\d+),\w+,", r"\1,z1,")),
        r"zone z1, and \w+ in TwoArms\.mod, line \d+",
    ),
    "the second arm does not come to rest at the end": (
        lambda: changed(second=instead(r",fine,(bwFlange;\n    ENDPROC\n\nENDMODULE)", r",z0,\1")),
        "SyncMoveOff.*is not allowed where an arm moves",
    ),
    "a slow second arm": (
        lambda: changed(second=instead(r":=\[\d+,\d+,", ":=[100,1,")),
        "speeds of the arm that moves the part are not the planned ones",
    ),
    "a tool of the second arm that is not its flange": (
        lambda: changed(second=by(10.0, r"bwFlange:=\[TRUE,\[\[", 0)),
        "one tool, at its flange",
    ),
    "a target of the second arm with an external axis": (
        lambda: changed(second=instead("9E9,9E9,9E9,9E9,9E9,9E9", "12,9E9,9E9,9E9,9E9,9E9", 4)),
        "axes other than the arm's six joints",
    ),
    "a target of the nozzle with an external axis": (
        lambda: changed(nozzle=instead("9E9,9E9,9E9,9E9,9E9,9E9", "12,9E9,9E9,9E9,9E9,9E9", 4)),
        "external axes besides a second arm",
    ),
    "a rest in the second task": (
        lambda: changed(second=instead(r"(\n    ENDPROC\n\nENDMODULE)", r"\n        WaitTime 1.000;\1")),
        "in the task that moves the part",
    ),
    "the way to the start in the moving part": (
        lambda: changed(nozzle=instead(r"(MoveAbsJ [^\n]*,fine,tPen);", r"\1\\WObj:=wobjPart;")),
        "unknown name 'wobjPart'",
    ),
    "what unbinds a task is missing": (
        lambda: changed(second=instead(r"    UNDO\n        SyncMoveUndo;\n", "")),
        "main handles errors other",
    ),
    "what ends both tasks ends one": (
        lambda: changed(nozzle=instead(r"SystemStopAction\\StopBlock;", "EXIT;")),
        "the socket's procedures say",
    ),
    "the other module is missing": (
        lambda: {name: text for name, text in written().items() if name != SECOND},
        "one of two modules that belong together is missing",
    ),
    "the nozzle's module is missing": (
        lambda: {name: text for name, text in written().items() if name != NOZZLE},
        "no complete module",
    ),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_a_program_that_was_changed_is_found(what: str) -> None:
    files, words = TAMPERED[what]
    assert re.search(words, wrong(files())), wrong(files())


def test_no_statement_of_the_second_task_can_be_missed() -> None:
    lines = written()[SECOND].split("\n")
    statements = [k for k, line in enumerate(lines) if line.strip() and not line.strip().startswith("!")]
    for k in statements:
        left = "\n".join(lines[:k] + lines[k + 1 :])
        assert wrong(written() | {SECOND: left}), lines[k]


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(st.data())
def test_no_digit_of_the_second_task_can_be_another(data: st.DataObject) -> None:
    """But the last one of a joint, which rounding may be, and those of the load, which is the user's."""
    text = written()[SECOND]
    lines = [
        (match.start(), match[0])
        for match in re.finditer(r"        (?:MoveAbsJ|\w+;|SyncMove|WaitSync)[^\n]*|    CONST speeddata[^\n]*", text)
    ]
    begin, line = data.draw(st.sampled_from(lines))
    shown = re.sub(r"\[9E9[^]]*\]|(?<=\.\d{4})\d", lambda hidden: "-" * len(hidden[0]), line)
    digits = [k for k, each in enumerate(shown) if each.isdigit()]
    if not digits:
        return
    at = begin + data.draw(st.sampled_from(digits))
    other = data.draw(st.sampled_from([each for each in "0123456789" if each != text[at]]))
    spoilt = text[:at] + other + text[at + 1 :]
    assert wrong(written() | {SECOND: spoilt}), spoilt[begin : begin + len(line)]


def test_one_arm_s_program_takes_no_identities() -> None:
    from export_fixtures import make_plan

    single = make_plan()
    text = RAPID.write(single)["TwoBeads.mod"]
    at = re.search(r"MoveJ \[\[.*\]\],", text)
    assert at is not None
    with pytest.raises(InputError, match="an \\\\ID outside SyncMoveOn"):
        read_rapid(text[: at.end() - 1] + "\\ID:=3" + text[at.end() - 1 :])
    with pytest.raises(InputError, match="one of two modules"):
        read_rapid(written()[NOZZLE])
    renamed = {name: each.replace("STN1", "STN2") for name, each in RAPID.write(single).items()}
    assert RAPID.differences(single, renamed) == ["the part is moved by STN2, not by STN1"]


# ---- refused -----------------------------------------------------------------------------------------------------


def cell_of(name: str, *changes: str) -> ProblemSetup:
    problem = load_problem(name, changes)
    return ProblemSetup(problem, build_cell(problem))


UR = ("cell.positioner.robot=ur10e", "cell.positioner.free=[wrist_3_joint]", "cell.positioner.held_deg={}")
IIWA = ("cell.positioner.robot=iiwa", "cell.positioner.free=[joint_7]", "cell.positioner.held_deg={}")
RAIL = ("cell.base={robot: track_3m, free: [rail], home_mm: {rail: 1500}}",)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (UR, "MultiMove moves ABB arms, and the robot file of Universal Robots UR10e, which moves the part, names"),
        (IIWA, "names another language"),
        (RAIL, "rail carries one of the two arms, which MultiMove programs do not support"),
    ],
)
def test_an_arm_that_multimove_cannot_move_gets_no_program(changes: tuple[str, ...], words: str) -> None:
    setup = cell_of("fibre_plane", *changes)
    assert words in str(RAPID.unsupported(setup))
    assert "rapid" not in chosen(setup).names and words in chosen(setup).note
    with pytest.raises(InputError, match="rapid cannot say this") as caught:
        chosen(cell_of("fibre_plane", *changes, "program.languages=[rapid]"))
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("name", ["urscript", "krl", "fanuc", "inform", "val3", "kawasaki", "melfa"])
def test_other_languages_say_why_they_cannot(name: str) -> None:
    words = str(LANGUAGES[name].unsupported(cell_of("fibre_plane")))
    assert re.search("the part is held by an arm|IRB 1200-5/0.9 moves the part|not a Universal Robots arm", words)


@pytest.mark.parametrize("unit", ["STN1", "ROB_3", "arm"])
def test_a_unit_that_is_no_arm_is_refused(unit: str) -> None:
    with pytest.raises(InputError, match="is not an arm of a MultiMove system") as caught:
        chosen(cell_of("fibre_plane", f"program.station={unit}"))
    assert str(caught.value.field).endswith("program.station") and "ROB_1, ROB_2" in str(caught.value)
    assert chosen(cell_of("fibre_plane", "program.station=ROB_1")).names[0] == "rapid"


@pytest.mark.parametrize("key", ["tool", "work_object", "extruder_signal"])
def test_an_arm_s_name_is_not_given_twice(key: str) -> None:
    with pytest.raises(InputError, match="a name of the program's own, or of the controller's"):
        load_problem("fibre_plane", (f"program.{key}=rob_2",))


# ---- what runs programs, or moves arms -----------------------------------------------------------------------------


def test_the_link_takes_the_files_of_both_tasks(tmp_path: Path) -> None:
    for name, text in written().items():
        (tmp_path / name).write_text(text)
    files = program_files(tmp_path / NOZZLE)
    assert set(files) == set(written()) - {"TwoArms_lines.csv"}
    assert programs_of(files) == {"T_ROB1": "TwoArms", "T_ROB2": "TwoArms_Rob2"}
    (tmp_path / SECOND).unlink()
    with pytest.raises(InputError, match=r"TwoArms_Rob2\.mod"):
        program_files(tmp_path / NOZZLE)


def test_each_task_of_a_controller_gets_its_own_program(tmp_path: Path) -> None:
    for name, text in written().items():
        (tmp_path / name).write_text(text)
    files = program_files(tmp_path / NOZZLE)
    with start(access=Access(password="pw"), arms=2) as made:
        rws = Rws(Address(*made.rws), 1, "Default User", Secret("pw"))
        bring(rws, files, lambda text: None)
        assert made.controller.modules("T_ROB1") == ["TwoArms"]
        assert made.controller.modules("T_ROB2") == ["TwoArms_Rob2"]
        with rws.mastership():
            rws.unload("T_ROB2")
            with pytest.raises(LinkError, match="one of two modules that belong together is missing"):
                rws.to_main()
        rws.close()


@pytest.mark.parametrize("arms", [1, 2])
def test_both_tasks_must_be_active(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arms: int) -> None:
    for name, text in written().items():
        (tmp_path / name).write_text(text)
    with start(access=Access(password="pw"), arms=arms) as made:
        rws = Rws(Address(*made.rws), 1, "Default User", Secret("pw"))
        if arms == 2:
            listed = rws._states
            monkeypatch.setattr(
                rws,
                "_states",
                lambda *asked: [
                    {**each, "active": "On" if each["name"] == "T_ROB1" else "Off"} for each in listed(*asked)
                ],
            )
        with pytest.raises(LinkError, match="T_ROB2 is no active task of the controller"):
            bring(rws, program_files(tmp_path / NOZZLE), lambda text: None)
        assert made.controller.files() == []  # nothing was sent
        rws.close()


def test_what_moves_one_arm_refuses_two(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two arms move together, but a stream moves only one"):
        stream_of(read_rapid_files(written()))
    (tmp_path / "plan.json").write_text(plan_json(plan()), encoding="utf-8")
    with pytest.raises(InputError, match="a second arm moves the part, but EGM guides only one"):
        read_plan(tmp_path)
    setup = cell_of("fibre_plane")
    with pytest.raises(InputError, match="moves in a task of its own, but a test program has only one task"):
        language_of(setup.problem, setup.cell, None)


# ---- the shipped problems ----------------------------------------------------------------------------------------


@cache
def solved(name: str) -> Plan:
    clear = (
        "cell.positioner.held_deg={joint_2: 60, joint_3: -40, joint_5: -100}"  # of the forearm, however the panel turns
    )
    return solve_alone(load_problem(name, ("strategy=ladder", *([clear] if name == "fibre_plane" else []))))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fibre_plane", "fibre_bowl", "fibre_corrugated"])
def test_the_fibre_problems_are_programs_of_two_arms(name: str) -> None:
    own = solved(name)
    assert own.verified
    files = RAPID.write(own)
    assert RAPID.differences(own, files) == []
    program: RobotProgram = RAPID.program(own, files)
    t = own.trajectory
    played = play(program, own.cell)
    second = program.external[:, JOINT]
    assert np.ptp(second) > np.radians(45.0)
    # at every target both arms stand where the plan has them at some instant
    q = played.q[played.target]
    off = [np.abs(t.q - each).max(axis=1).min() for each in q]
    assert max(off) < np.radians(1.0)
    assert abs(played.duration / float(t.t[-1]) - 1.0) < 0.05
    (folder,) = {Path(key).stem.split("_")[0] for key in files if key.endswith(".pgf")}
    assert f"{folder}_Rob2.mod" in files and f"{folder}_lines.csv" in files
