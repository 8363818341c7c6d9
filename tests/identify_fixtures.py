"""Cells, test programs and recordings of robots with known limits, for tests of `identify`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.recordings import Recording, TrueRobot, recorded, write_recording
from planner.base.arrays import Array
from planner.cell.cell import Cell, build_cell
from planner.collision.scene import NOTHING
from planner.feedback.identify_fit import fit_joints
from planner.feedback.identify_match import MatchedLog, match
from planner.feedback.identify_program import (
    AskedMoves,
    asked_moves,
    free_spaces,
    greatest_lengths,
    language_of,
)
from planner.feedback.recordings import read_log
from planner.problem import Problem, load_problem

NOISE = np.radians(0.01)
RPI = Path(__file__).resolve().parents[2] / "shared" / "data" / "rpi"


@cache
def cell_of(name: str, *overrides: str) -> tuple[Problem, Cell]:
    problem = load_problem(name, overrides)
    return problem, build_cell(problem)


@cache
def asked_of(
    name: str, language: str | None = None, joints: tuple[int, ...] | None = None, most: float = 180.0, overrides=()
) -> AskedMoves:
    """What is asked of a cell in which nothing is in the way, of some of its joints."""
    problem, cell = cell_of(name, *overrides)
    spaces = free_spaces(cell, NOTHING, cell.home, greatest_lengths(cell, [most]))
    asked = asked_moves(problem, cell, cell.home, spaces, language_of(problem, cell, language))
    kept = asked.moves if joints is None else tuple(move for move in asked.moves if move.joint in joints)
    return replace(asked, moves=kept)


def truth_of(cell: Cell, seed: int = 1, **more: float) -> TrueRobot:
    """A robot that is not that of the file: slower, its accelerations and jerks others."""
    random, limits, n = np.random.default_rng(seed), cell.limits, len(cell.joint_names)
    return TrueRobot(
        0.85 * limits.velocity,
        limits.acceleration * random.uniform(0.6, 1.4, n),
        limits.jerk * random.uniform(0.25, 0.7, n),
        **more,
    )


def header(cell: Cell, unit: str = "deg", commanded: bool = False) -> list[str]:
    names = [f"{name}_{unit}" for name in cell.joint_names]
    return ["t_s", *names, *([f"target_{name}" for name in names] if commanded else [])]


def found_in(path: Path, asked: AskedMoves, cell: Cell, recording: Recording, commanded: bool = False):
    """What is read from a recording that was written and read back."""
    file = write_recording(path / "run.csv", recording, header(cell, commanded=commanded), commanded=commanded)
    log = match(read_log(file, cell), asked)
    limits = cell.limits
    return fit_joints(log, asked, (limits.velocity, limits.acceleration, limits.jerk))


UR = ("cell.arm=ur5e", "cell.limits={}", "cell.home_deg=[0, -90, 90, -90, -90, 0]")


def matched(tmp_path: Path, text: str, asked: AskedMoves, columns: Sequence[str] | None = None) -> MatchedLog:
    """What a recording of the logo's cell is matched to, that is written as a text."""
    file = tmp_path / "run.csv"
    file.write_text(text, encoding="utf-8")
    return match(read_log(file, cell_of("cylinder_logo")[1], columns), asked)


@cache
def sample() -> tuple[AskedMoves, Recording]:
    """A test program of three joints, and its recording."""
    asked = asked_of("cylinder_logo", joints=(1, 3, 6), most=20.0)
    return asked, recorded(asked, truth_of(cell_of("cylinder_logo")[1], delay=0.02))


def table_text(head: str, table: Array, separator: str = ",") -> str:
    return "\n".join([head, *(separator.join(f"{v:.13g}" for v in row) for row in table)]) + "\n"
