"""Compiled kernels are used again only as long as nothing has changed that they are made of."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numba.core import errors
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler import Flags
from numba.core.targetconfig import Option, TargetConfig

from planner.base.compiled import call_at, compare_options_quickly, njit, was_compiled

ROOT = Path(__file__).resolve().parents[1]

CALLEE = """
from planner.base.compiled import njit
from constants import STEP

@njit
def inner(x):
    return {0} * x + STEP
"""
CALLER = """
from planner.base.compiled import njit
from callee import inner

@njit
def outer(x):
    return inner(x)
"""
RUN = """
import caller
print(caller.outer(2.0), sum(caller.outer.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in (("callee", CALLEE.format(1.0)), ("caller", CALLER), ("constants", "STEP = 0.5"), ("run", RUN)):
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def run(folder: Path) -> tuple[float, int]:
    """What the caller's kernel returns, and how often its code came from the cache."""
    value, hits = subprocess.run(
        [sys.executable, "run.py"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.split()
    return float(value), int(hits)


@pytest.mark.slow
def test_code_is_compiled_anew_after_a_change_in_another_file(folder: Path) -> None:
    assert run(folder) == (2.5, 0)
    assert run(folder) == (2.5, 1)
    (folder / "callee.py").write_text(CALLEE.format(3.0))
    assert run(folder) == (6.5, 0)
    assert run(folder) == (6.5, 1)
    (folder / "constants.py").write_text("STEP = 0.25")
    assert run(folder) == (6.25, 0)
    (folder / "caller.py").touch()  # its content is the same
    assert run(folder) == (6.25, 1)


KINDS = """
from typing import NamedTuple

class {0}(NamedTuple):
    x: float

class Outer(NamedTuple):
    inner: {0}
"""
TAKER = """
from planner.base.compiled import njit
from kinds import Outer

@njit
def outer(both):
    return both.inner.x
"""
TAKEN = """
import kinds, caller
print(caller.outer(kinds.Outer(kinds.{0}(2.0))), sum(caller.outer.stats.cache_hits.values()))
"""


def test_code_of_what_a_kernel_was_before_does_not_count(tmp_path: Path) -> None:
    def kernel(content: str) -> SimpleNamespace:
        file = IndexDataCacheFile(str(tmp_path), "outer", "")
        file._version = content
        return SimpleNamespace(_cache=SimpleNamespace(_cache_file=file))

    assert not was_compiled(kernel("as it is"))
    kernel("as it is")._cache._cache_file.save("types", "code")
    assert was_compiled(kernel("as it is"))
    assert not was_compiled(kernel("as it was"))
    assert not was_compiled(SimpleNamespace())  # without a cache


@pytest.mark.slow
def test_code_of_a_class_that_has_another_name_now_is_forgotten(tmp_path: Path) -> None:
    for name in ("Inner", "Renamed"):
        texts = {"kinds": KINDS.format(name), "caller": TAKER, "run": TAKEN.format(name)}
        for module, text in texts.items():
            (tmp_path / f"{module}.py").write_text(text)
        assert run(tmp_path) == (2.0, 0)
    assert run(tmp_path) == (2.0, 1)


LOADED = """
import numpy as np
from planner.cell.cell import build_cell
from planner.cell.kinematics import offset_wrist, seven_axes_kernel, skew_wrist_kernel, spherical_wrist
from planner.cell.kinematics.inverse import kind_of, solve_one, solver_of
from planner.problem import load_problem

cell = build_cell(load_problem("peer_cap"))
T = cell.inverse.poses(np.full((1, 6), 0.3))[0]
q, ok = np.empty((8, 6)), np.empty(8, dtype=np.bool_)
solve_one(kind_of(cell.inverse), solver_of(cell.inverse), cell.inverse.parameters, np.zeros(1), T, q, ok)
kinds = spherical_wrist, offset_wrist, seven_axes_kernel, skew_wrist_kernel
print(np.abs(q[ok] - 0.3).max(axis=1).min() < 1e-9, *(len(kind.solve_one.signatures) for kind in kinds))
"""


@pytest.mark.slow
def test_an_arm_compiles_the_solver_of_its_own_kind_alone(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOADED],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["True", "1", "0", "0", "0"]


def test_what_is_called_by_its_address_takes_arrays_in_order_alone() -> None:
    @njit
    def call(address, values):
        call_at(address, (values, values.size))

    with pytest.raises(errors.TypingError, match="in C order"):
        call(1, np.zeros(8)[::2])


def test_options_are_as_equal_as_numba_has_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def read_all(one: TargetConfig, other: TargetConfig) -> bool:
        return bool(one.values() == other.values())

    def of(**changes: object) -> Flags:
        flags = Flags()
        for name, value in changes.items():
            setattr(flags, name, value)
        return flags

    for name in ("__eq__", "__hash__"):  # as they are before, whatever other tests have done
        monkeypatch.setattr(TargetConfig, name, getattr(TargetConfig, name))
    by_default = {name: option.default for name, option in Flags.options.items()}
    several = [of(), of(nrt=True), of(nrt=True), of(nrt=False), of(nrt=True, release_gil=True), of(error_model="numpy")]
    several += [of(error_model=by_default["error_model"]), several[-1].copy(), of(boundscheck=True)]
    numbas = hash(tuple(sorted(Flags.options)))
    compare_options_quickly()
    for one in several:
        assert hash(one) == numbas and {one: 1}[one.copy()] == 1
        for other in several:
            assert (one == other) is read_all(one, other)
    assert several[0] != 1 and several[0] is not None

    class Own(TargetConfig):
        nrt = Option(type=bool, default=False, doc="of another kind")

    assert Own() == Own() and Own() != Flags()


def test_another_release_of_numba_keeps_its_own_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    class Renamed:
        __slots__ = ("_set",)

    monkeypatch.setattr("planner.base.compiled.TargetConfig", Renamed)
    own = Renamed.__eq__
    compare_options_quickly()
    assert Renamed.__eq__ is own
