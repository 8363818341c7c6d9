"""Recordings of robots that are spoilt: tables and bags of a test program, and runs of a plan that are identified and learned
from.

python -m benchmarks.attack --only recordings bags runs

A recording is spoilt as interfaces, loggers, editors and disks do it. It is refused by name, or what is found in it is what
the robot did: limits and deviations within what the true recording shows.
"""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.attack import files
from benchmarks.attack.cases import ACCEPTED, ESCAPED, HARMLESS, Case, Chance, Kind, Outcome
from benchmarks.attack.in_process import Said, attack_command, numbers_after, own_folder
from benchmarks.attack.prints import NAME, ON_POSITIONER, solved, write_print
from benchmarks.learn import ROBOTS
from benchmarks.learn import recorded as recorded_run
from benchmarks.recordings import TrueRobot, recorded
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.cell.robot import read_robot
from planner.collision.scene import NOTHING
from planner.feedback.identify_command import main as identify
from planner.feedback.identify_program import asked_moves, asked_text, free_spaces, greatest_lengths
from planner.feedback.learn_command import main as learn
from planner.motion.as_run import read_corrections
from planner.plan import Plan
from planner.problem import load_problem

COUNT = 300
JOINT, MOST_DEG = 3, 30.0  # that moves in the test program, and how far
MOVES = 8  # of it that are asked: the first, and the last ones
LIMIT_OFF = 0.05  # share by which a limit may be off that is told, or a few standard errors
ERRORS = 4.0
RUN_OFF = 0.1e-3  # m by which a correction, or a deviation, may be another one than the true recording's

# ---- recordings, and how they stand in files ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A recording: time (m) [s], executed and commanded joints (m, n) [rad, m], the latter in the file only if `told`."""

    time: Array
    q: Array
    commands: Array
    names: tuple[str, ...]
    told: bool = False

    def rows(self, k: Any) -> Table:
        """The same of some samples."""
        return replace(self, time=self.time[k], q=self.q[k], commands=self.commands[k])


def degrees_text(table: Table) -> bytes:
    """As `beadwise` itself names columns."""
    head = ["t_s", *(f"{name}_deg" for name in table.names)]
    return _text(table, head, ",", 1.0, np.degrees(1.0), [f"target_{name}_deg" for name in table.names])


def abb_text(table: Table) -> bytes:
    """Six axes and one beside them, numbered."""
    n = len(table.names)
    head = ["timestamp", *(f"J{k}" for k in range(1, n)), "E1"]
    return _text(table, head, ", ", 1.0, np.degrees(1.0), [f"cmd_J{k}" for k in range(1, n)] + ["cmd_E1"])


def kuka_text(table: Table) -> bytes:
    """Milliseconds and semicolons."""
    n = len(table.names)
    head = ["t_ms", *(f"A{k}" for k in range(1, n)), "E1"]
    return _text(table, head, ";", 1e3, np.degrees(1.0), [f"target A{k}" for k in range(1, n)] + ["target E1"])


def ros_text(table: Table) -> bytes:
    """Radians, at seconds since 1970."""
    head = ["time", *(f"/joint_states/{name}/position" for name in table.names)]
    later = replace(table, time=table.time + 1.7e9)
    return _text(later, head, ",", 1.0, 1.0, [f"/goal/{name}/position" for name in table.names])


def _text(table: Table, head: Sequence[str], mark: str, second: float, radian: float, told: Sequence[str]) -> bytes:
    columns = [table.time * second, *(table.q.T * radian), *(table.commands.T * radian if table.told else ())]
    lines = [mark.join([*head, *(told if table.told else ())])]
    lines += [mark.join(f"{value:.7f}" for value in row) for row in np.column_stack(columns).tolist()]
    return ("\n".join(lines) + "\n").encode()


FORMS: dict[str, Callable[[Table], bytes]] = {
    "degrees": degrees_text, "ABB": abb_text, "KUKA": kuka_text, "ROS": ros_text,
}  # fmt: skip

# ---- changes: (table, random) → table ---------------------------------------------------------------------------------


def _span(table: Table, by: random.Random, most: int) -> slice:
    k = by.randrange(len(table.time))
    return slice(k, k + by.randint(1, most))


def missing(table: Table, by: random.Random) -> Table:
    """Samples that the interface lost."""
    kept = np.ones(len(table.time), dtype=bool)
    for _ in range(by.choice([1, 1, 5, 40])):
        kept[_span(table, by, by.choice([1, 3, 30, 400]))] = False
    return table.rows(kept)


def thinned(table: Table, by: random.Random) -> Table:
    return table.rows(slice(None, None, by.choice([2, 3, 5, 20])))


def cut(table: Table, by: random.Random) -> Table:
    """The recording was begun late, or ended early."""
    k = by.randrange(len(table.time))
    return table.rows(by.choice([slice(k, None), slice(None, k)]))


def written_twice(table: Table, by: random.Random) -> Table:
    """Samples that a logger wrote again, with the same stamps."""
    rows = np.arange(len(table.time))
    for _ in range(by.choice([1, 10, 200])):
        k = by.randrange(len(rows))
        rows = np.insert(rows, k, rows[k])
    return table.rows(rows)


def held(table: Table, by: random.Random) -> Table:
    """An interface that repeats its last sample for a while, of one joint or of all."""
    q = table.q.copy()
    span = _span(table, by, by.choice([2, 10, 60]))
    columns = slice(None) if by.random() < 0.5 else by.randrange(q.shape[1])
    q[span, columns] = q[span.start, columns]
    return replace(table, q=q)


def swapped_samples(table: Table, by: random.Random) -> Table:
    rows = np.arange(len(table.time))
    a, b = by.randrange(len(rows)), by.randrange(len(rows))
    if by.random() < 0.5:
        b = min(a + 1, len(rows) - 1)
    rows[[a, b]] = rows[[b, a]]
    if by.random() < 0.5:
        return table.rows(rows)
    return replace(table, q=table.q[rows])  # the stamps stay in order


def clock_jumps(table: Table, by: random.Random) -> Table:
    time = table.time.copy()
    time[by.randrange(len(time)) :] += by.choice([-1.0, -0.01, 0.01, 0.03, 0.2, 3.0, 3600.0, 1e9])
    return replace(table, time=time)


def clock_uneven(table: Table, by: random.Random) -> Table:
    """Stamps of a busy computer."""
    late = np.random.default_rng(by.getrandbits(30)).uniform(0.0, by.choice([1e-3, 3e-3, 0.02, 0.1]), len(table.time))
    return replace(table, time=table.time + late)


def clock_coarse(table: Table, by: random.Random) -> Table:
    """Stamps of few digits."""
    digit = by.choice([1e-3, 5e-3, 0.01, 0.1, 1.0])
    return replace(table, time=np.floor(table.time / digit) * digit)


def clock_scaled(table: Table, by: random.Random) -> Table:
    """Another unit."""
    return replace(table, time=table.time * by.choice([0.0, 1e-6, 1e-3, 60.0, 1e3, 1e6, 1e9, -1.0]))


def no_numbers(table: Table, by: random.Random) -> Table:
    """A column, or some samples of it, that the interface did not know."""
    q, value = table.q.copy(), by.choice([np.nan, np.inf, -np.inf, 1e300, 1e30])
    q[by.choice([slice(None), _span(table, by, 50)]), by.randrange(q.shape[1])] = value
    return replace(table, q=q)


def noughts(table: Table, by: random.Random) -> Table:
    """What many interfaces write where they know nothing."""
    q = table.q.copy()
    q[by.choice([slice(None), _span(table, by, 50)]), by.choice([slice(None), by.randrange(q.shape[1])])] = 0.0
    return replace(table, q=q)


def spikes(table: Table, by: random.Random) -> Table:
    """Samples that are wrong for an instant."""
    q = table.q.copy()
    for _ in range(by.choice([1, 1, 5, 50])):
        k = by.randrange(len(q))
        q[k, by.choice([slice(None), by.randrange(q.shape[1])])] += by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-3, 2)
    return replace(table, q=q)


def noisy(table: Table, by: random.Random) -> Table:
    deviation = np.radians(by.choice([0.003, 0.03, 0.1, 1.0]))
    return replace(table, q=table.q + np.random.default_rng(by.getrandbits(30)).normal(0.0, deviation, table.q.shape))


def rounded(table: Table, by: random.Random) -> Table:
    """Joints with few digits."""
    digit = np.radians(by.choice([1e-4, 1e-3, 0.01, 0.1, 1.0]))
    return replace(table, q=np.round(table.q / digit) * digit)


def joints_swapped(table: Table, by: random.Random) -> Table:
    order = list(range(table.q.shape[1]))
    a, b = by.sample(order, 2)
    order[a], order[b] = order[b], order[a]
    return replace(table, q=table.q[:, order])


def joint_turned(table: Table, by: random.Random) -> Table:
    """Another sense or zero of a joint."""
    q, j = table.q.copy(), by.randrange(table.q.shape[1])
    q[:, j] = by.choice([-q[:, j], q[:, j] + by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(-2.0, 0.5)])
    return replace(table, q=q)


def joint_scaled(table: Table, by: random.Random) -> Table:
    """Another unit than the header says, of one joint or all."""
    q, columns = table.q.copy(), by.choice([slice(None), by.randrange(table.q.shape[1])])
    q[:, columns] *= by.choice([np.pi / 180.0, 180.0 / np.pi, 1e-3, 1e3, 1.0 / 360.0, 0.5, 2.0])
    return replace(table, q=q)


def twice_over(table: Table, by: random.Random) -> Table:
    """Two recordings in a file, the second one later, or not."""
    time = table.time + by.choice([0.0, float(table.time[-1]) + 4e-3, 1e4])
    return replace(
        table,
        time=np.concatenate([table.time, time]),
        q=np.vstack([table.q, table.q]),
        commands=np.vstack([table.commands, table.commands]),
    )


def backwards(table: Table, by: random.Random) -> Table:
    out = table.rows(slice(None, None, -1))
    return out if by.random() < 0.5 else replace(out, time=table.time)


def commands_spoilt(table: Table, by: random.Random) -> Table:
    """Commands of another clock, unit or order, or the executed joints in their place."""
    told = table.commands
    changed = by.choice([
        np.roll(told, by.choice([-200, -20, 20, 200]), axis=0), np.degrees(told), np.radians(told), told[:, ::-1], table.q,
        0.0 * told, told + 0.1, np.full_like(told, np.nan),
    ])  # fmt: skip
    return replace(table, commands=changed, told=True)


TABLE_CHANGES: dict[str, Callable[[Table, random.Random], Table]] = {
    "missing": missing, "thinned": thinned, "cut": cut, "written twice": written_twice, "held": held,
    "swapped samples": swapped_samples, "clock jumps": clock_jumps, "clock uneven": clock_uneven, "clock coarse": clock_coarse,
    "clock scaled": clock_scaled, "no numbers": no_numbers, "noughts": noughts, "spikes": spikes, "noisy": noisy,
    "rounded": rounded, "joints swapped": joints_swapped, "joint turned": joint_turned, "joint scaled": joint_scaled,
    "twice over": twice_over, "backwards": backwards, "commands": commands_spoilt,
}  # fmt: skip


def header(data: bytes, by: random.Random) -> bytes:
    """Names of columns that are others, missing, twice, or not there at all."""
    head, _, rest = data.partition(b"\n")
    mark = next((each for each in (b";", b",") if each in head), b",")
    words = head.split(mark)
    i, k = by.randrange(len(words)), by.randrange(len(words))
    how = by.randrange(9)
    if how == 0:
        words[i] = by.choice(
            [b"", b"x", b"J9", b"speed", b"\xff", b"actual_qd_3", b"temperature_1", b"t_s", b"J-1", b"J" + b"9" * 400]
        )
    elif how == 1:
        words[i], words[k] = words[k], words[i]
    elif how == 2:
        words[i] = words[k]
    elif how == 3:
        del words[i]
    elif how == 4:
        return rest
    elif how == 5:
        return head + b"\n" + data
    elif how == 6:
        words = [word.replace(b"_deg", by.choice([b"_rad", b"", b" [\xb0]", b"_mm"])) for word in words]
    elif how == 7:
        words = [word.upper() for word in words]
    else:
        return b"# a comment\n\n" + data.replace(b"\n", by.choice([b"\r\n", b"\r", b"\n\n", b";\n", b",\n"]))
    return mark.join(words) + b"\n" + rest


BYTE_CHANGES = files.CHANGES | {"header": header}


def spoilt_table(table: Table, by: Chance) -> tuple[str, Table]:
    """A recording with one change or two, and which."""
    whats = [by.choice([*TABLE_CHANGES]) for _ in range(by.choice([1, 1, 1, 2]))]
    for what in whats:
        if len(table.time) > 1:
            table = TABLE_CHANGES[what](table, by)
    return ", ".join(whats), table


def spoilt_file(table: Table, by: Chance) -> tuple[str, bytes]:
    """The file of a recording that is spoilt, as a table or byte by byte; and how."""
    form = by.choice([*FORMS])
    table = replace(table, told=by.random() < 0.3)
    if by.random() < 0.65:
        what, table = spoilt_table(table, by)
        return f"{form}: {what}", FORMS[form](table)
    data, whats = FORMS[form](table), []
    for _ in range(by.choice([1, 1, 2])):
        if data:
            whats.append(by.choice([*BYTE_CHANGES, "header", "header", "number"]))
            data = BYTE_CHANGES[whats[-1]](data, by)
    return f"{form}: {', '.join(whats)}", data


# ---- a test program -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ProgramRun:
    """A cell's test program, a robot that ran it, and what was recorded."""

    folder: Path
    cell: Cell
    truth: TrueRobot
    table: Table


def program_run(folder: Path) -> ProgramRun:
    """Of the small print's cell: some moves of one joint."""
    problem = load_problem(write_print(folder, **ON_POSITIONER))
    cell = build_cell(problem)
    spaces = free_spaces(cell, NOTHING, cell.home, greatest_lengths(cell, [MOST_DEG]))
    whole = asked_moves(problem, cell, cell.home, spaces, "rapid")
    own = [move for move in whole.moves if move.joint == JOINT]
    asked = replace(whole, moves=(own[0], *own[1 - MOVES :]))
    limits = cell.limits
    truth = TrueRobot(0.4 * limits.velocity, 0.8 * limits.acceleration, 0.5 * limits.jerk, delay=0.02)
    made = recorded(asked, truth)
    (folder / f"{NAME}_asked.json").write_text(asked_text(asked), encoding="utf-8")
    return ProgramRun(folder, cell, truth, Table(made.time, made.executed, made.commanded, cell.joint_names))


def read_as_test_program(given: ProgramRun, file: Path, own: Path, what: str) -> Outcome:
    """`identify read`, and the limits that it has written."""
    out = own / "out"
    arguments = ["read", str(file), str(given.folder / f"{NAME}.yaml"), "--asked", str(own / f"{NAME}_asked.json")]
    return attack_command(
        identify,
        [*arguments, "--out", str(out)],
        out,
        (file.name, "_asked.json"),
        what,
        partial(_limits, given, out, what),
    )


def _limits(given: ProgramRun, out: Path, what: str, said: Said) -> Outcome:
    """Whether limits that are told are the robot's."""
    for path in out.glob("*.yaml"):
        read_robot(path)
    told = _told(said.out)
    truth = [float(values[JOINT]) for values in (given.truth.speed, given.truth.acceleration, given.truth.jerk)]
    wrong = []
    for value, (found, percent) in zip(truth, told, strict=True):
        off = found / value - 1.0
        # what is told without an error is what was reached at least
        if off > LIMIT_OFF if percent is None else abs(off) > max(LIMIT_OFF, 0.01 * ERRORS * percent):
            wrong.append(f"{found:g} of {value:g}")
    return Outcome(what, ESCAPED if wrong else HARMLESS, "; ".join(wrong))


def _told(said: str) -> list[tuple[float, float | None]]:
    """Speed, acceleration and jerk of the joint that moves, each with its standard error in percent if it is told."""
    line = next(line for line in said.splitlines() if line.startswith("joint_4 ") and "file" in line)
    found = numbers_after(line, r"(?:at least )?([0-9.e+-]+)(?= (?:±|\(file))")
    out: list[tuple[float, float | None]] = []
    for (value,), part in zip(found, line.split("(file"), strict=False):
        error = numbers_after(part, r"±([0-9.]+) %")
        out.append((value, error[0][0] if error else None))
    return out


def attack_recording(given: ProgramRun, by: Chance) -> Outcome:
    """Spoil a table of the test program's run, or what it asked, and read it."""
    own = own_folder(given.folder, by)
    try:
        asked = (given.folder / f"{NAME}_asked.json").read_bytes()
        if by.random() < 0.12:
            what, data = "asked", FORMS["degrees"](given.table)
            for _ in range(by.choice([1, 2])):
                change = by.choice([*files.CHANGES, "number", "number"])
                asked, what = files.CHANGES[change](asked, by) if asked else asked, f"{what}, {change}"
        else:
            what, data = spoilt_file(given.table, by)
        (own / f"{NAME}_asked.json").write_bytes(asked)
        (own / "run.csv").write_bytes(data)
        return read_as_test_program(given, own / "run.csv", own, what)
    finally:
        shutil.rmtree(own)


def _prepared_recordings(folder: Path) -> Case:
    given = program_run(folder)
    _as_it_is(lambda by: _true_recording(given, by))
    return partial(attack_recording, given)


def _true_recording(given: ProgramRun, by: Chance) -> Outcome:
    own = own_folder(given.folder, by)
    shutil.copy(given.folder / f"{NAME}_asked.json", own)
    (own / "run.csv").write_bytes(FORMS["ABB"](given.table))
    return read_as_test_program(given, own / "run.csv", own, "nothing")


def _as_it_is(case: Case) -> None:
    outcome = case(Chance("true"))
    if outcome.verdict not in (ACCEPTED, HARMLESS):
        raise RuntimeError(f"as it is: {outcome.told}")


# ---- bags -----------------------------------------------------------------------------------------------------------

Messages = list[tuple[int, list[str], list[float]]]  # stamps [ns], names, places
SINCE = 1_700_000_000 * 10**9  # ns
STORES = ("bag", "sqlite3", "mcap")


def write_bag(path: Path, kind: str, topics: dict[str, Messages]) -> Path:
    """Write joint states of topics as a bag of STORES; the file of it that holds them."""
    from rosbags.rosbag1 import Writer as FirstWriter
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as SecondWriter
    from rosbags.typesys import Stores, get_typestore

    first, of = kind == "bag", "sensor_msgs/msg/JointState"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    types, nothing = store.types, np.empty(0)
    path = path.with_suffix(".bag") if first else path
    writer: Any = (
        FirstWriter(path) if first else SecondWriter(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    )
    with writer:
        for topic, messages in topics.items():
            connection = writer.add_connection(topic, of, typestore=store)
            for k, (stamp, names, places) in enumerate(messages):
                time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
                head = types["std_msgs/msg/Header"](stamp=time, frame_id="", **({"seq": k} if first else {}))
                message = types[of](head, names, np.array(places, dtype=np.float64), nothing, nothing)
                raw = (store.serialize_ros1 if first else store.serialize_cdr)(message, of)
                writer.write(connection, SINCE + 4_000_000 * k, raw)
    return path if first else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))


def messages_of(table: Table) -> Messages:
    """A recording as messages. Raises ValueError for what no stamp can hold."""
    stamps = SINCE + np.round(1e9 * np.nan_to_num(table.time)).astype(np.int64)
    if not (stamps.min() >= 0 and stamps.max() < 2**31 * 10**9):
        raise ValueError("beyond what stamps can hold")
    return [(s, list(table.names), row) for s, row in zip(stamps.tolist(), table.q.tolist(), strict=True)]


def spoilt_messages(messages: Messages, by: random.Random) -> tuple[str, Messages]:
    """Some messages that are others, and how."""
    how = by.choice(
        [
            "unstamped",
            "reordered",
            "names",
            "no places",
            "too few places",
            "no names",
            "a stamp",
            "a name twice",
            "stamps far off",
        ]
    )
    out = list(messages)
    for _ in range(by.choice([1, 3, 30, 2000])):
        k = by.randrange(len(out))
        stamp, names, places = messages[k]
        order = list(range(len(names)))
        by.shuffle(order)
        out[k] = {
            "unstamped": (0, names, places),
            "reordered": (stamp, [names[i] for i in order], [places[i] for i in order]),
            "names": (stamp, [by.choice(["x", "joint_1", "", "\u00e9"]), *names[1:]], places),
            "no places": (stamp, names, []),
            "too few places": (stamp, names, places[:-1]),
            "no names": (stamp, [], places),
            "a stamp": (max(stamp + by.choice([-(10**9), 10**7, -(10**6), 10**12]), 0), names, places),
            "a name twice": (stamp, [names[0], *names[:-1]], places),
            "stamps far off": (by.choice([1, 2**31 * 10**9 - 1]), names, places),
        }[how]  # fmt: skip
    return how, out


def attack_bag(given: ProgramRun, by: Chance) -> Outcome:
    """Spoil a bag's messages, topics or bytes, and read it as the test program's recording."""
    own = own_folder(given.folder, by)
    kind, table, whats = by.choice(STORES), given.table, []
    try:
        how = by.random()
        if how < 0.35:
            what, table = spoilt_table(table, by)
            whats.append(what)
        try:
            messages = messages_of(table)
        except ValueError:
            return Outcome(f"{kind}: {', '.join(whats)}", ACCEPTED, "no bag can hold that")
        if 0.35 <= how < 0.6:
            what, messages = spoilt_messages(messages, by)
            whats.append(what)
        topics = {"/joint_states": messages}
        if by.random() < 0.25:
            told = messages_of(replace(given.table, q=given.table.commands))
            topics[by.choice(["/joint_commands", "/other/joint_states", "/a/target", "/b/cmd"])] = told
            whats.append("two topics")
        inside = write_bag(own / "run", kind, topics)
        if how >= 0.6:
            change = by.choice([*files.CHANGES])
            whats.append(change)
            inside.write_bytes(files.CHANGES[change](inside.read_bytes(), by))
        shutil.copy(given.folder / f"{NAME}_asked.json", own)
        file = inside if kind == "bag" or by.random() < 0.5 else inside.parent
        return read_as_test_program(given, file, own, f"{kind}: {', '.join(whats) or 'nothing'}")
    finally:
        shutil.rmtree(own)


def _prepared_bags(folder: Path) -> Case:
    return partial(attack_bag, program_run(folder))


# ---- runs of a plan -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlanRun:
    """A plan, saved, a run of its program, and what the true recording of that shows and teaches."""

    folder: Path
    plan: Plan
    table: Table
    laid: float
    shift: Array


def plan_run(folder: Path) -> PlanRun:
    """Of the small print on a simulated IRC5."""
    plan = solved(folder, **ON_POSITIONER)
    plan.save(folder / f"{NAME}.plan")
    time, q = recorded_run(plan, ROBOTS["as fitted"])
    q = q + np.random.default_rng(1).normal(0.0, np.radians(0.001), q.shape)
    given = PlanRun(folder, plan, Table(time, q, q, plan.joint_names), np.nan, np.empty((0, 3)))
    (folder / "run.csv").write_bytes(FORMS["degrees"](given.table))
    found: dict[str, Any] = {}

    def laid(said: Said) -> Outcome:
        found["laid"] = _laid(said)
        return Outcome("nothing", HARMLESS)

    def taught(said: Said) -> Outcome:
        found["shift"] = read_corrections(folder / "out" / "corrections.csv", plan.toolpath, ValueError).shift
        return Outcome("nothing", HARMLESS)

    file = folder / "run.csv"
    for told in (_identified(given, file, folder, "nothing", laid), _learned(given, file, folder, "nothing", taught)):
        if told.verdict != HARMLESS:
            raise RuntimeError(f"as it is: {told.told}")
    return replace(given, **found)


def _identified(given: PlanRun, file: Path, own: Path, what: str, judged: Callable[[Said], Outcome]) -> Outcome:
    out = own / "out"
    arguments = ["read", str(file), str(given.folder / f"{NAME}.yaml"), "--plan", str(given.folder / f"{NAME}.plan")]
    return attack_command(identify, [*arguments, "--out", str(out)], out, (file.name,), what, judged)


def _learned(given: PlanRun, file: Path, own: Path, what: str, judged: Callable[[Said], Outcome]) -> Outcome:
    out = own / "out"
    arguments = [str(given.folder / f"{NAME}.plan"), str(file), "--out", str(out), "--quiet"]
    return attack_command(learn, arguments, out, (file.name,), what, judged)


def _laid(said: Said) -> float:
    """How far the tip is off the path on beads, on the mean [m]."""
    found = numbers_after(said.out, r"where material is laid: mean ([0-9.]+), most ([0-9.]+) mm")
    return 1e-3 * found[0][0] if found else 0.0


def _noise(said: Said) -> float:
    """The noise of a recorded tip, as it is told [m]."""
    found = numbers_after(said.out, r"noise of a recorded tip: ([0-9.]+) mm") or numbers_after(
        said.out, r"\(noise ([0-9.]+) mm\)"
    )
    return 1e-3 * max((value for (value,) in found), default=0.0)


def attack_run(given: PlanRun, by: Chance) -> Outcome:
    """Spoil the recording of a plan's run, and have it read by `identify` and by `learn`."""
    own = own_folder(given.folder, by)
    try:
        what, data = spoilt_file(given.table, by)
        (own / "run.csv").write_bytes(data)

        def laid(said: Said) -> Outcome:
            off, noise = abs(_laid(said) - given.laid), _noise(said)
            told = f"{1e3 * off:.3f} mm off what is to be found, noise {1e3 * noise:.3f} mm"
            return Outcome(what, ESCAPED if off > RUN_OFF + noise else HARMLESS, told)

        def taught(said: Said) -> Outcome:
            shift = read_corrections(own / "out" / "corrections.csv", given.plan.toolpath, ValueError).shift
            # what a recording does not show is not learned: any part of the true correction will do
            share = (shift * given.shift).sum(axis=1) / np.maximum((given.shift**2).sum(axis=1), 1e-18)
            part = np.clip(share, 0.0, 1.0)[:, None] * given.shift
            off, noise = float(np.linalg.norm(shift - part, axis=1).max()), _noise(said)
            verdict = ESCAPED if off > RUN_OFF + noise else HARMLESS
            return Outcome(what, verdict, f"{1e3 * off:.3f} mm off what is to be learned, noise {1e3 * noise:.3f} mm")

        if by.random() < 0.5:
            return _identified(given, own / "run.csv", own, f"identify, {what}", laid)
        return _learned(given, own / "run.csv", own, f"learn, {what}", taught)
    finally:
        shutil.rmtree(own)


def _prepared_runs(folder: Path) -> Case:
    return partial(attack_run, plan_run(folder))


KINDS = {
    "recordings": Kind("tables of a test program's recording, and what it asked", COUNT, _prepared_recordings),
    "bags": Kind("bags of ROS of the same", COUNT, _prepared_bags),
    "runs": Kind("recordings of a plan's run, identified and learned from", COUNT, _prepared_runs),
}
