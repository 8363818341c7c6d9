"""Long programs in several modules, which the main one loads when it needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planner.export.rapid.procedures import Procedure
from planner.export.rapid.text import LONGEST_NAME

HOME = "HOME:"  # the folder on the controller from which modules are loaded
# What was loaded when a program was stopped may be older than the files: it is taken out before all motion, where it is.
NOT_LOADED = (
    "    ERROR",
    "        IF ERRNO=ERR_UNLOAD THEN",
    "            TRYNEXT;",
    "        ENDIF",
    "        RAISE;",
)


@dataclass(frozen=True)
class Loaded:
    """A module that is loaded on the way: its name, and its procedures."""

    name: str
    procedures: tuple[Procedure, ...]

    @property
    def text(self) -> str:
        """The whole module."""
        inner = [line for procedure in self.procedures for line in procedure.text]
        return "\n".join([f"MODULE {self.name}", *inner, "ENDMODULE", ""])


Batch = tuple[Loaded, ...]  # modules that are loaded together: a bead that fills several must not wait within


def batches_of(name: str, procedures: Sequence[Procedure], most: int) -> tuple[Batch, ...]:
    """Procedures in modules of at most `most` moves, loaded where the robot rests, or where it travels if it never does.

    name: of the main module, from which those of the others are made.
    """
    groups: list[list[list[Procedure]]] = []  # batches of modules of procedures
    gathered: list[Procedure] = []
    for procedure in procedures:
        parts = procedure.parts(most)
        while gathered and sum(len(each.steps) for each in gathered) + len(procedure.steps) > most:
            rest = max((k for k, each in enumerate(gathered, 1) if each.rests), default=len(gathered))
            groups.append([gathered[:rest]])
            gathered = gathered[rest:]
        if len(parts) > 1:
            groups += [[gathered]] if gathered else []
            gathered = []
            groups.append([[part] for part in parts])
        else:
            gathered.append(procedure)
    groups += [[gathered]] if gathered else []
    out, count = [], 0
    for group in groups:
        group[-1][-1] = group[-1][-1].resting()
        out.append(tuple(Loaded(_named(name, count + k), tuple(own)) for k, own in enumerate(group, 1)))
        count += len(group)
    return tuple(out)


def _named(name: str, k: int) -> str:
    """Name of the k-th module, and of its file."""
    ending = f"_{k}"
    return name[: LONGEST_NAME - len(ending)] + ending


def unloading(batches: Sequence[Batch]) -> list[str]:
    """Statements of main that take out what an earlier run has left, in the order of the modules."""
    return [_unload(module) for batch in batches for module in batch]


def _unload(module: Loaded) -> str:
    return f'        UnLoad "{HOME}"\\File:="{module.name}.mod";'


def running(batch: Batch) -> list[str]:
    """Statements of main that load a batch, call its procedures, and take it out again."""
    return [
        *(f'        Load \\Dynamic,"{HOME}"\\File:="{module.name}.mod";' for module in batch),
        *(f'        %"{procedure.name}"%;' for module in batch for procedure in module.procedures),
        *(_unload(module) for module in batch),
    ]
