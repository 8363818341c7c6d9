"""Problem files that are spoilt: each is read, or refused with its file and its line or field; never a traceback.

python -m benchmarks.attack --only problems

Text and values of every shipped problem and of a small print of its own. What is accepted of the latter is solved.
"""

from __future__ import annotations

import contextlib
import io
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.events import MappingEndEvent, MappingStartEvent, ScalarEvent, SequenceEndEvent, SequenceStartEvent

from benchmarks.attack.cases import (
    ACCEPTED,
    BUGS,
    ESCAPED,
    REFUSED,
    STOPPED,
    Case,
    Kind,
    Outcome,
    TimeLimit,
    time_limit,
)
from benchmarks.attack.prints import NAME, ON_POSITIONER, write_print
from planner.base.errors import InputError, PlannerError, Refusal
from planner.base.shipped import PROBLEMS
from planner.planning.check_command import examine
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.describe import lines_of

COUNT = 1500
OWN = 0.3  # of the cases spoil the small print, which is then solved
BY_OPTION = 0.15  # of the values come by --set
LONGEST_CHECK, LONGEST_SOLVE = 60.0, 30.0  # s, on a busy machine
LONGEST_MESSAGE = 2000  # characters

# What may stand in the place of any value.
TOKENS = (
    "nan", ".nan", ".inf", "-.inf", "1e308", "-1e308", "1e-308", "9" * 400, "1e9999", "0", "-0.0", "-1", "1", "0x7fffffff",
    "99999999999999999999", "true", "no", "null", "~", "''", "[]", "{}", "[[[]]]", "[1, 2]", "[nan, nan, nan]", "{a: 1}",
    "40 mm", "40mm", "4O", "1,5", "1_000", "0o17", "1:30", "2026-01-01", "\u0661\u0662", "\u2212" "5", "\U0001f600",
    "\u202e40", "caf\u00e9", "x" * 5000, "../../../etc/passwd", "/dev/zero", "/dev/null", "/proc/self/mem", ".", "/", "''''",
    "&a 1", "*a", "!!python/object:os.system", "!!float 3", "|", ">", "'", '"', "\\", "%", "@", "`", "- 1", "? 1", "# 1", "",
    "'\\0'", '"\\0"', '"\\ud800"', "<<", "peer_cap", "cylinder_logo.yaml", "irb140", "__import__", "${HOME}", "[[1, 2], [3]]",
)  # fmt: skip
FACTORS = (-1.0, 0.0, 1e-6, 1e-3, 0.1, 0.5, 2.0, 10.0, 100.0, 1e3, 1e6, 1e12)


@dataclass(frozen=True)
class Value:
    """A value of a problem's text: where it stands, what it is called, and whether it is a key."""

    first: int
    last: int
    path: tuple[str, ...]
    key: bool


def values_of(text: str) -> list[Value]:
    """All keys and values of a problem's text."""
    found: list[Value] = []
    events = YAML(typ="safe", pure=True).parse(text)

    def span(path: tuple[str, ...], first: object, last: object, key: bool = False) -> None:
        found.append(Value(first.start_mark.index, last.end_mark.index, path, key))  # type: ignore[attr-defined]

    def node(event: object, path: tuple[str, ...]) -> None:
        if isinstance(event, ScalarEvent):
            span(path, event, event)
        elif isinstance(event, SequenceStartEvent):
            while not isinstance(item := next(events), SequenceEndEvent):
                node(item, path)
            span(path, event, item)
        elif isinstance(event, MappingStartEvent):
            while not isinstance(item := next(events), MappingEndEvent):
                own = (*path, item.value)
                span(own, item, item, key=True)
                node(next(events), own)

    for event in events:
        if isinstance(event, (ScalarEvent, MappingStartEvent)):
            node(event, ())
    return found


# ---- changes: (text, random) → text -----------------------------------------------------------------------------------


def _put(text: str, value: Value, new: str) -> str:
    return text[: value.first] + new + text[value.last :]


def _any(text: str, by: random.Random, key: bool) -> Value:
    return by.choice([value for value in values_of(text) if value.key == key and value.last > value.first])


def token(text: str, by: random.Random) -> str:
    return _put(text, _any(text, by, False), by.choice(TOKENS))


def number(text: str, by: random.Random) -> str:
    chosen = [value for value in values_of(text) if not value.key and _is_number(text[value.first : value.last])]
    value = by.choice(chosen)
    return _put(text, value, f"{float(text[value.first : value.last]) * by.choice(FACTORS):.12g}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def other_value(text: str, by: random.Random) -> str:
    a, b = _any(text, by, False), _any(text, by, False)
    return _put(text, a, text[b.first : b.last])


def other_key(text: str, by: random.Random) -> str:
    a, b = _any(text, by, True), _any(text, by, True)
    return _put(text, a, text[b.first : b.last])


def misspelt(text: str, by: random.Random) -> str:
    value = _any(text, by, True)
    key = text[value.first : value.last]
    k = by.randrange(len(key))
    return _put(
        text,
        value,
        by.choice([key.upper(), key[:k] + key[k + 1 :], key[:k] + "\u0435" + key[k + 1 :], key + "_", key + " "]),
    )


def _lines(text: str, by: random.Random, change: Callable[[list[str], int, int], None]) -> str:
    lines = text.split("\n")
    change(lines, by.randrange(len(lines)), by.randrange(len(lines)))
    return "\n".join(lines)


def missing(text: str, by: random.Random) -> str:
    return _lines(text, by, lambda lines, i, k: lines.__delitem__(i))


def doubled(text: str, by: random.Random) -> str:
    return _lines(text, by, lambda lines, i, k: lines.insert(i, lines[i]))


def swapped(text: str, by: random.Random) -> str:
    def change(lines: list[str], i: int, k: int) -> None:
        lines[i], lines[k] = lines[k], lines[i]

    return _lines(text, by, change)


def indented(text: str, by: random.Random) -> str:
    def change(lines: list[str], i: int, k: int) -> None:
        lines[i] = by.choice(["  " + lines[i], lines[i].lstrip(), "\t" + lines[i], "\u00a0" + lines[i]])

    return _lines(text, by, change)


def added(text: str, by: random.Random) -> str:
    line = by.choice(
        ["unknown: 1", "process: {}", "cell: 3", "---", "...", "- a", "%YAML 1.1", "? {a: b}", "? [a]", "<<: *a", "1: 2", "~: 3",
         "a: &x [*x]", "include: other.yaml", "? ", ": ", "layers: {source: {svg: logo.svg}}", "name: ../../x", "name: ''"]
    )  # fmt: skip
    return _lines(text, by, lambda lines, i, k: lines.insert(i, line))


def nested(text: str, by: random.Random) -> str:
    deep = by.choice([10, 25, 1000, 50_000])
    opened, closed = by.choice([("[", "]"), ("{a: ", "}")])
    return _put(text, _any(text, by, False), opened * deep + "1" + (closed * deep if by.random() < 0.7 else ""))


def anchored(text: str, by: random.Random) -> str:
    bomb = "a0: &a0 [1, 1]\n" + "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12))
    return by.choice([bomb + text, text + bomb, text.replace(": ", ": &x ", 1)])


def large(text: str, by: random.Random) -> str:
    item = by.choice(["1, ", "a, ", "[1, 2, 3], ", "{a: 1}, "])
    return _put(text, _any(text, by, False), "[" + item * by.choice([100, 30_000]) + "]")


def cut(text: str, by: random.Random) -> str:
    return text[: by.randrange(len(text))]


def inserted(text: str, by: random.Random) -> str:
    k = by.randrange(len(text))
    return (
        text[:k]
        + by.choice(
            [
                "\0",
                "\x1b[2J",
                "\u2028",
                "\ufeff",
                "\u200b",
                "\r",
                "\x85",
                "\x7f",
                "{",
                "[",
                '"',
                "'",
                "#",
                ":",
                "\t",
                "\ud800",
            ]
        )
        + text[k:]
    )


def character(text: str, by: random.Random) -> str:
    k = by.randrange(len(text))
    return text[:k] + chr(ord(text[k]) ^ 1 << by.randrange(7)) + text[k + 1 :]


def shuffled(text: str, by: random.Random) -> str:
    lines = text.split("\n")
    by.shuffle(lines)
    return "\n".join(lines)


CHANGES: dict[str, Callable[[str, random.Random], str]] = {
    "token": token, "number": number, "value of another field": other_value, "key of another field": other_key,
    "misspelt": misspelt, "missing": missing, "twice": doubled, "swapped": swapped, "indented": indented, "added": added,
    "nested": nested, "anchored": anchored, "large": large, "cut": cut, "inserted": inserted, "character": character,
    "shuffled": shuffled,
}  # fmt: skip
OFTEN = ("token", "token", "token", "token", "number", "number", "number", "number")


def written(text: str, path: Path, by: random.Random) -> None:
    """Write a problem's text, now and then as another program would: line ends, mark, encoding, or no text at all."""
    data = text.encode("utf-8", "surrogatepass")
    how = by.random()
    if how < 0.02:
        data = data.replace(b"\n", b"\r\n")
    elif how < 0.03:
        data = b"\xef\xbb\xbf" + data
    elif how < 0.04:
        data = text.encode("utf-16", "surrogatepass")
    elif how < 0.05:
        data = text.encode("latin-1", "replace") + b"\xe9"
    elif how < 0.06:
        k = by.randrange(max(1, len(data)))
        data = data[:k] + by.randbytes(40) + data[k:]
    path.write_bytes(data)


# ---- what becomes of it -----------------------------------------------------------------------------------------------


def attack_problem(texts: dict[str, str], folder: Path, by: random.Random) -> Outcome:
    """Spoil a problem once or twice, in its text or by --set, and read it."""
    name = NAME if by.random() < OWN else by.choice(sorted(texts))
    text, whats = texts[name], []
    for _ in range(by.choice([1, 1, 1, 2])):
        what = by.choice([*CHANGES, *OFTEN])
        with contextlib.suppress(Exception):  # what is no YAML any more has no values to change
            text = CHANGES[what](text, by)
            whats.append(what)
    settings = []
    if by.random() < BY_OPTION:
        text = texts[name]
        whats = ["--set"]
        dotted = ".".join(_any(text, by, True).path)
        settings = [
            by.choice(
                [f"{dotted}={by.choice(TOKENS)}", f"{dotted}{by.choice(TOKENS)}", f"{dotted}.x=1", f".{dotted}=1"]
            )
        ]
    path = folder / f"spoilt_{by.getrandbits(60):x}.yaml"
    written(text, path, by)
    try:
        return read(path, settings, f"{name}: {', '.join(whats)}", solved=name == NAME)
    finally:
        path.unlink()


def read(path: Path, settings: list[str], what: str, solved: bool, whole: bool = False) -> Outcome:
    """Read a problem as `planner.check` does, and solve it if that is wanted: what a user would be told."""
    told: list[InputError] = []
    try:
        with time_limit(LONGEST_CHECK):
            try:
                problem = load_problem(path, settings)
            except InputError as error:
                told += error.all or (error,)
            else:
                found = examine(problem, whole)
                told += found.mistakes
                if not told and found.cell is not None:
                    "\n".join(lines_of(problem, found.cell, found.toolpath, found.first_layer)).encode()
    except TimeLimit:
        verdict = STOPPED if whole else ESCAPED  # all beads may take long, and are only laid where they are asked for
        return Outcome(what, verdict, f"check takes more than {LONGEST_CHECK:.0f} s")
    if told:
        bad = [wrong for error in told if (wrong := badly_told(error))]
        return Outcome(what, ESCAPED if bad else REFUSED, "; ".join(bad or map(str, told)))
    if not solved:
        return Outcome(what, ACCEPTED)
    return solved_outcome(partial(load_problem, path, settings), what)


def solved_outcome(problem: Callable[[], object], what: str) -> Outcome:
    """What a solve comes to: a plan, a refusal with its reason; nothing else."""
    try:
        with time_limit(LONGEST_SOLVE), contextlib.redirect_stderr(io.StringIO()):
            plan = solve(problem(), baseline=False)  # type: ignore[arg-type]
    except TimeLimit:
        return Outcome(what, STOPPED, f"solve takes more than {LONGEST_SOLVE:.0f} s")
    except InputError as error:
        wrong = badly_told(error)
        return Outcome(what, ESCAPED if wrong else REFUSED, wrong or str(error))
    except Refusal as error:
        return Outcome(what, REFUSED, str(error))
    except PlannerError as error:
        return Outcome(what, ESCAPED, str(error), {BUGS: 1})
    return Outcome(what, ACCEPTED, "verified" if plan.verified else "not verified")


def badly_told(error: InputError) -> str:
    """What is wrong with a message: that it names no place, cannot be printed, or is endless."""
    said = str(error)
    if error.file is None and error.field is None:
        return f"no file and no field: {said}"
    if not all(c.isprintable() for c in said):
        return f"not printable: {said!r}"
    if len(said) > LONGEST_MESSAGE:
        return f"{len(said)} characters: {said[:100]}"
    return ""


def prepared(folder: Path) -> Case:
    """All shipped problems with their files, and the small print, in a folder."""
    for path in PROBLEMS.iterdir():
        if path.is_file():
            shutil.copy(path, folder / path.name)
    write_print(folder, **ON_POSITIONER)
    texts = {path.stem: path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.yaml"))}
    with contextlib.suppress(TimeLimit):
        solve(load_problem(folder / f"{NAME}.yaml"), baseline=False)  # what it takes is compiled
    return partial(attack_problem, texts, folder)


KINDS = {"problems": Kind("text and values of problem files", COUNT, prepared)}
