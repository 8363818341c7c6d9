"""Runs procedures of RAPID without motion, as strictly as the makers' reference describes it.

Positions outside of a string, strings over 80 characters and unknown names are errors that nothing recovers from. An
error goes to the handler of the procedure in which it is raised, and to no caller's; within a handler, and whatever
that calls, there is no second chance.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

_STRING = re.compile(r'("(?:[^"])*")')
_WORDS = [
    (r"<>", "!="),
    (r"(?<![:<>!=])=(?!=)", "=="),
    (r"\bAND\b", "and"),
    (r"\bOR\b", "or"),
    (r"\bNOT\b", "not"),
    (r"\bTRUE\b", "True"),
    (r"\bFALSE\b", "False"),
    (r"\\(\w+):=", r",\1="),
    (r"\\(\w+)", r",\1=True"),
]
_DEFAULTS = {"num": 0, "string": "", "bool": False}


class Ended(Exception):
    """EXIT: the program is over."""


class SystemStop(Exception):
    """The controller's own error handler stops the program."""


class Raised(Exception):
    """An error with a number that a program may handle."""


class _Returned(Exception):
    pass


class Names(dict[str, Any]):
    """Data, routines and instructions; whatever else is a signal or a unit has its name as its value."""

    def __missing__(self, name: str) -> str:
        if name.startswith(("do", "ERR_", "SOCKET_")):
            return name
        raise SystemStop(f"unknown name {name}")


class Runner:
    """Procedures of a module's text, with data in `names`, to be called by name."""

    def __init__(self, text: str, names: dict[str, Any]) -> None:
        self.names = Names({"StrFind": _find, "StrPart": _part, "StrLen": len, "NumToStr": _said, **names})
        self.handling = 0
        lines = [line.strip() for line in text.split("\n")]
        at = 0
        for k, line in enumerate(lines):
            if (data := re.fullmatch(r"(?:VAR|CONST) (num|string|bool) (\w+)(?::=(.*))?;", line)) and not at:
                self.names[data[2]] = eval(_python(data[3]), {}) if data[3] else _DEFAULTS[data[1]]
            if head := re.fullmatch(r"PROC (\w+)\((.*)\)", line):
                at = k + 1
                parameters = [each.split()[1] for each in head[2].split(",") if each]
            elif line == "ENDPROC" and at:
                body = [each for each in lines[at:k] if each and not each.startswith("!")]
                cut = body.index("ERROR") if "ERROR" in body else len(body)
                self.names[head_name(lines[at - 1])] = self._routine(parameters, body[:cut], body[cut + 1 :])

    def _routine(self, parameters: list[str], body: list[str], handler: list[str]) -> Callable[..., None]:
        code, rescue = _block(iter(body)), _block(iter(handler))

        def call(*values: Any) -> None:
            with suppress(_Returned):
                self._run(code, dict(zip(parameters, values, strict=True)), rescue)

        return call

    def _run(self, code: list[Any], own: dict[str, Any], rescue: list[Any]) -> str:
        for step in code:
            try:
                said = self._step(step, own, rescue)
            except Raised as error:
                if self.handling or not rescue:
                    raise SystemStop(str(error)) from error
                self.handling += 1
                self.names["ERRNO"] = str(error)
                said = self._run(rescue, own, [])
                self.handling -= 1
                if said != "TRYNEXT;":
                    raise SystemStop(f"{error} is not handled") from error
                continue
            if said:
                return said
        return ""

    def _step(self, step: Any, own: dict[str, Any], rescue: list[Any]) -> str:
        if isinstance(step, list):
            if step[0] == "WHILE":
                while self._value(step[1][0], own):
                    if said := self._run(step[1][1], own, rescue):
                        return said
                return ""
            for condition, inner in step[1:]:
                if self._value(condition, own):
                    return self._run(inner, own, rescue)
            return ""
        if step in ("TRYNEXT;", "RAISE;"):
            return str(step)
        if step == "RETURN;":
            raise _Returned
        if step == "EXIT;":
            raise Ended
        if data := re.fullmatch(r"VAR (\w+) (\w+)(?::=(.*))?;", step):
            own[data[2]] = self._value(data[3], own) if data[3] else _DEFAULTS[data[1]]
        elif into := re.fullmatch(r"(\w+):=(.*);", step):
            (own if into[1] in own else self.names)[into[1]] = self._value(into[2], own)
        else:
            self._call(step.rstrip(";"), own)
        return ""

    def _call(self, step: str, own: dict[str, Any]) -> None:
        word = re.match(r"\w+", step)
        assert word is not None
        said = step[word.end() :].strip()
        if receives := re.search(r"\\Str:=(\w+)\\ReadNoOfBytes", said):
            got = self._value(f"{word[0]}({said})", own)
            (own if receives[1] in own else self.names)[receives[1]] = got
        else:
            self._value(f"{word[0]}({said})", own)

    def _value(self, text: str, own: dict[str, Any]) -> Any:
        value = eval(_python(text), {"__builtins__": {}}, Names({**self.names, **own}))
        if isinstance(value, str) and len(value) > 80:
            raise SystemStop(f"a string of {len(value)} characters")
        return value


def head_name(line: str) -> str:
    """Name of a procedure."""
    return line.split()[1].split("(")[0]


def _python(text: str) -> str:
    parts = _STRING.split(text)
    for k in range(0, len(parts), 2):
        for old, new in _WORDS:
            parts[k] = re.sub(old, new, parts[k])
        parts[k] = parts[k].replace("(,", "(")
    for k in range(1, len(parts), 2):
        parts[k] = parts[k].replace("\\0A", "\\n")
    return "".join(parts)


def _block(lines: Iterator[str]) -> list[Any]:
    """Statements up to the end of a block; IF as ["IF", [condition, block], …], WHILE as ["WHILE", [condition, block]]."""
    found: list[Any] = []
    for line in lines:
        if line in ("ENDIF", "ENDWHILE", "ELSE") or line.startswith("ELSEIF "):
            return [*found, line]
        if line.startswith("WHILE "):
            found.append(["WHILE", [line[6:-3], _block(lines)[:-1]]])
        elif line.startswith("IF "):
            arms, condition = [], line[3:-5]
            while condition:
                *inner, end = _block(lines)
                arms.append([condition, inner])
                condition = "" if end == "ENDIF" else "TRUE" if end == "ELSE" else end[7:-5]
            found.append(["IF", *arms])
        else:
            found.append(line)
    return found


def _find(text: str, at: int, of: str) -> int:
    if not 1 <= at <= len(text):
        raise SystemStop(f"place {at} of {text!r}")
    return next((k for k in range(at, len(text) + 1) if text[k - 1] in of), len(text) + 1)


def _part(text: str, at: int, count: int) -> str:
    if not (1 <= at <= len(text) and 0 <= count <= len(text) - at + 1):
        raise SystemStop(f"{count} characters from {at} on of {text!r}")
    return text[at - 1 : at - 1 + count]


def _said(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}"
