"""Style `socket`, read back: do the lines move the filament that the plan has, by the right tool and where it has it?"""

from __future__ import annotations

import csv
import io
import re
from typing import TYPE_CHECKING

import numpy as np

from planner.export.extruder.check import AMOUNT
from planner.export.extruder.orders import orders
from planner.export.moves import deposits
from planner.export.program import Program
from planner.export.rapid.lines import COLUMNS, RELATIVE
from planner.materials import used

if TYPE_CHECKING:
    from planner.plan import Plan

_EXTRUDES = re.compile(r"G1 E(-?\d+\.\d+) F(\d+\.\d+)", re.ASCII)
_SELECTS = re.compile(r"T(\d+)", re.ASCII)


def line_complaints(plan: Plan, program: Program, table: str) -> list[str]:
    """Every difference, in words, between the lines of a program and its plan, or the table that goes with them."""
    sent = [text for move in sorted(program.sends) for text in program.sends[move]]
    said = [text for order in orders(plan) for text in order.lines if not text.startswith(";")]
    found = [] if _listed(table) == list(enumerate(sent, 1)) else ["the table of lines lists others than are sent"]
    if [text for text in sent if not _EXTRUDES.fullmatch(text)] != [RELATIVE, *said]:
        found.append("the board is told other things than the plan's, or in another order")
    return found + _fed_otherwise(plan, sent) + _fed_elsewhere(plan, program)


def _listed(table: str) -> list[tuple[int, str]]:
    rows = list(csv.DictReader(io.StringIO(table)))
    if not rows or list(rows[0]) != COLUMNS.split(",") or any(None in row or None in row.values() for row in rows):
        return []
    return [(int(row["n"]) if row["n"].isdecimal() else 0, row["text"]) for row in rows]


def _fed_otherwise(plan: Plan, sent: list[str]) -> list[str]:
    """Tools that get another amount of filament than planned."""
    filament: dict[int | None, float] = {}
    tool = None
    for text in sent:
        if selects := _SELECTS.fullmatch(text):
            tool = int(selects[1])
        elif extrudes := _EXTRUDES.fullmatch(text):
            filament[tool] = filament.get(tool, 0.0) + float(extrudes[1]) * 1e-3
    t = plan.trajectory
    takes: dict[int | None, float] = {each.material.tool: each.filament for each in used(plan) if each.beads}
    takes = takes or {None: float(t.feed[-1] - t.feed[0])}
    off = {tool: filament.get(tool, 0.0) - takes.get(tool, 0.0) for tool in {*takes, *filament}}
    return [
        f"{'the extruder' if tool is None else f'tool T{tool}'} gets {amount * 1e3:+.3g} mm of filament"
        for tool, amount in sorted(off.items(), key=str)
        if not abs(amount) <= AMOUNT
    ]


def _fed_elsewhere(plan: Plan, program: Program) -> list[str]:
    """Whether what was sent until a bead begins, or ends, is what the plan has fed by then, to a sample and a bit."""
    t = plan.trajectory
    amounts = np.zeros(len(program.linear) + 1)  # sent behind each move; the last one before all moves
    for move, texts in program.sends.items():
        amounts[move] += sum(float(match[1]) * 1e-3 for match in map(_EXTRUDES.fullmatch, texts) if match)
    sent = np.concatenate([[0.0], np.cumsum(amounts[:-1])])
    first, last = deposits(t)
    places = {True: iter(first), False: iter(last)}
    near = 2.0 * float(np.abs(np.diff(t.feed)).max(initial=0.0)) + AMOUNT
    worst = 0.0
    for move, triggers in sorted(program.triggers.items()):
        for trigger in triggers:
            sample = int(next(places[trigger.value], len(t) - 1))
            if not trigger.from_start:  # at a start the line for the bead may have been sent, or not
                worst = max(worst, abs(float(sent[move] - (t.feed[sample] - t.feed[0]))))
    words = f"where a bead begins or ends, {worst * 1e3:.3g} mm of filament are fed too early or too late"
    return [] if worst <= near else [words]
