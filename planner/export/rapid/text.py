"""Names, comments, procedures and modules of RAPID."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.base.rapid_names import LONGEST_NAME, OWN_NAMES, RAPID_WORDS
from planner.export.parts import numbered
from planner.export.text import ascii_comment

# ----------------------------------------------------------------------------------------------------
# Names and comments.

# ABB, RAPID reference: data, types, instructions and functions that a problem may be named after, but not a module
PREDEFINED = """abs acos add asin atan base bool break byte clear clock close cos decr dim distance dnum exp incr load num offs
    open orient pos pose pow present reset rewind round save set sin sqrt stop string switch tan task trunc unload user
    write"""
# ABB, RAPID reference, zonedata: radius of the zone of the tool's path [m]
ZONES = {"fine": 0.0, "z0": 0.3e-3, "z1": 1e-3, "z5": 5e-3, "z10": 10e-3}
# our own zonedata, for corners that z0, or zon0_1, would cut too much: radius for tool path, reorientation and external
# axes [mm], then as angles [deg]
OWN_ZONES = {"zon0_1": "[FALSE,0.1,0.1,0.1,0.01,0.1,0.01]", "zon0_02": "[FALSE,0.02,0.02,0.02,0.002,0.02,0.002]"}
ZONES |= {"zon0_1": 0.1e-3, "zon0_02": 0.02e-3}
LONGEST_STRING = 80
NOTE = "Note: "  # begins a header comment that users should read
_NOTE = re.compile(rf" {{4}}! {NOTE}(.*)\n {{4}}!   (first .*)\n")


def module_name(name: str, longest: int = LONGEST_NAME) -> str:
    """CamelCase module name, at most `longest` letters and digits, from a problem's name."""
    words = re.findall(r"[A-Za-z0-9]+", name)
    joined = "".join(word[0].upper() + word[1:] for word in words)
    # RAPID ignores case: a problem named "test" would open a TEST statement
    taken = joined.lower() in RAPID_WORDS.union(PREDEFINED.split()) or OWN_NAMES.fullmatch(joined)
    similar = re.fullmatch(r"(?i)(bead|vel|trg|bw)\w*", joined)
    whole = "Print" + joined if taken or similar or not joined[:1].isalpha() else joined
    resumed = re.search(r"From\d+$", whole)  # distinguishes programs of the same problem
    tail = resumed[0] if resumed else ""
    return whole[: longest - len(tail)] + tail if len(whole) > longest else whole


def comment(text: str, indent: int = 4) -> str:
    """One comment line, ASCII, of bounded length."""
    return ascii_comment("!", text, indent)


def written_notes(text: str) -> tuple[str, ...]:
    """The notes in the header of a main module."""
    return tuple(f"{words}; {where}" for words, where in _NOTE.findall(text))


# ----------------------------------------------------------------------------------------------------
# Procedures with moves.


@dataclass(frozen=True)
class Procedure:
    """A procedure without parameters.

    about  comments at its beginning
    steps  statements of each move: the move, then whatever is done after it
    rests  the robot is at rest when the procedure ends
    """

    name: str
    about: tuple[str, ...]
    steps: tuple[tuple[str, ...], ...]
    rests: bool

    @property
    def text(self) -> list[str]:
        """Its lines, followed by an empty one."""
        inner = [statement for step in self.steps for statement in step]
        return [f"    PROC {self.name}()", *self.about, *inner, "    ENDPROC", ""]

    def resting(self) -> Procedure:
        """The procedure, with the robot at rest when it ends."""
        if self.rests:
            return self
        move, *rest = self.steps[-1]
        for zone in ZONES:
            move = move.replace(f",{zone},", ",fine,")
        return replace(self, steps=(*self.steps[:-1], (move, *rest)), rests=True)

    def parts(self, most: int) -> list[Procedure]:
        """The same motion in procedures of at most `most` moves, to be called one after the other without a stop."""
        count = -(-len(self.steps) // most)
        if count <= 1:
            return [self]
        bounds = np.linspace(0, len(self.steps), count + 1).astype(int).tolist()
        return [
            replace(
                self,
                name=f"{self.name}Part{k + 1}",
                about=self.about if k == 0 else (comment(f"{self.name}, part {k + 1} of {count}", 8),),
                steps=self.steps[a:b],
                rests=self.rests and k == count - 1,
            )
            for k, (a, b) in enumerate(zip(bounds[:-1], bounds[1:], strict=True))
        ]


# ----------------------------------------------------------------------------------------------------
# Modules of a long program, which main loads when it needs them.

HOME = "HOME:"  # the folder on the controller from which modules are loaded
# Modules still loaded from a stopped run may be older than the files, so they are unloaded before any motion.
NOT_LOADED = (
    "    ERROR",
    "        IF ERRNO=ERR_UNLOAD THEN",
    "            TRYNEXT;",
    "        ENDIF",
    "        RAISE;",
)


@dataclass(frozen=True)
class Loaded:
    """A module that is loaded at run time: its name, and its procedures."""

    name: str
    procedures: tuple[Procedure, ...]

    @property
    def text(self) -> str:
        """The whole module."""
        inner = [line for procedure in self.procedures for line in procedure.text]
        return "\n".join([f"MODULE {self.name}", *inner, "ENDMODULE", ""])


Batch = tuple[Loaded, ...]  # modules loaded together: a bead that spans several must not wait within


def batches_of(name: str, procedures: Sequence[Procedure], most: int) -> tuple[Batch, ...]:
    """Procedures in modules of at most `most` moves, loaded where the robot rests, or during travel if it never does.

    name: of the main module, from which the others' names are derived.
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
        out.append(tuple(Loaded(numbered(name, count + k, LONGEST_NAME), tuple(own)) for k, own in enumerate(group, 1)))
        count += len(group)
    return tuple(out)


def unloading(batches: Sequence[Batch]) -> list[str]:
    """Statements of main that unload what an earlier run has left loaded, in the order of the modules."""
    return [_unload(module) for batch in batches for module in batch]


def _unload(module: Loaded) -> str:
    return f'        UnLoad "{HOME}"\\File:="{module.name}.mod";'


def running(batch: Batch) -> list[str]:
    """Statements of main that load a batch, call its procedures, and unload it again."""
    return [
        *(f'        Load \\Dynamic,"{HOME}"\\File:="{module.name}.mod";' for module in batch),
        *(f'        %"{procedure.name}"%;' for module in batch for procedure in module.procedures),
        *(_unload(module) for module in batch),
    ]
