"""The programs of a problem in every language, each in a folder of its own, with what the plan says of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from planner.export.languages import LANGUAGES
from planner.plan import Plan
from planner.problem.settings import BoardSpec, MachineSpec

# Machines for the G-code of several axes: a head that turns twice and follows the tip, and a trunnion.
FORK = MachineSpec.model_validate(
    {
        "flavour": "linuxcnc",
        "type": "head_head",
        "tcp": True,
        "rotary": (
            {"letter": "C", "direction": (0, 0, 1), "centre_mm": (0, 0, 200)},
            {"letter": "B", "direction": (0, 1, 0), "centre_mm": (0, 0, 150)},
        ),
    }
)
TRUNNION = MachineSpec.model_validate(
    {
        "flavour": "reprap",
        "type": "table_table",
        "rotary": ({"letter": "A", "direction": (1, 0, 0)}, {"letter": "C", "direction": (0, 0, 1)}),
    }
)
MACHINES = (FORK, TRUNNION)
# The extruder's boards; Klipper's cannot wait for the robot.
BOARDS = (BoardSpec(), BoardSpec(firmware="marlin"), BoardSpec(firmware="klipper", sync="free"))


@dataclass(frozen=True)
class Written:
    """Files of one language.

    language  key of LANGUAGES; `axes` with its flavour behind a space, `extruder` with its board's firmware
    files     none where the language cannot say the plan; `reason` says why
    """

    language: str
    files: tuple[Path, ...]
    reason: str = ""

    def of(self, *endings: str) -> tuple[Path, ...]:
        """Files whose names end so."""
        return tuple(file for file in self.files if file.name.endswith(endings))


@dataclass(frozen=True)
class Planned:
    """What the plan says: time of the whole [s], filament [mm], way of the tip while filament is pushed [mm]."""

    time: float
    filament: float
    path: float

    @classmethod
    def of(cls, plan: Plan) -> Planned:
        """That of a plan."""
        t = plan.trajectory
        step = np.linalg.norm(np.diff(t.tip, axis=0), axis=1)
        laid = float(step[np.diff(t.feed) > 0.0].sum())
        return cls(float(t.t[-1] - t.t[0]), 1e3 * float(t.feed[-1] - t.feed[0]), 1e3 * laid)


def written(plan: Plan, folder: Path) -> Iterator[Written]:
    """Write a plan in all languages and for all machines."""
    for name in LANGUAGES:
        for label, changes in _variants(name):
            program = plan.problem.program.model_copy(update={"machine": None, **changes})
            problem = plan.problem.model_copy(update={"program": program})
            yield _one(name, label, replace(plan, problem=problem), folder / label.replace(" ", "_"))


def _variants(name: str) -> list[tuple[str, dict[str, object]]]:
    """What a language is called in the table, and the settings of the program, for each kind that it has."""
    if name == "axes":
        return [(f"axes {machine.flavour}", {"machine": machine}) for machine in MACHINES]
    if name == "extruder":
        return [(f"extruder {board.firmware}", {"board": board}) for board in BOARDS]
    return [(name, {})]


def _one(name: str, label: str, plan: Plan, folder: Path) -> Written:
    language = LANGUAGES[name]
    reason = language.unsupported(plan)
    if reason is not None:
        return Written(label, (), reason)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for file, text in language.write(plan).items():
        paths.append(folder / file)
        paths[-1].write_text(text, encoding="utf-8", newline="\n")
    return Written(label, tuple(paths))
