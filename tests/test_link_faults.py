"""A slice of the benchmark of prints with a fault each, and that its checks notice what must not be."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.link_faults import LAYERS, LINES, REQUESTS, SAFE, STOPPING, Case, case_of, certificate, run, wrong_with


@pytest.mark.slow(keep=("1-web-error-9",))
@pytest.mark.parametrize(
    ("layer", "kind", "at"),
    [
        ("web", "error", 9),  # the program pointer
        ("web", "lose", 11),  # the start: done, and nobody was told
        ("web", "broken", 11),
        ("web", "drop", 14),  # a look
        (STOPPING, "broken", 15),
        (STOPPING, "drip", 15),
        ("controller", "restart", 9),
        ("board", "drop", 9),
        ("ftp", "cut", 4),
    ],
)
@pytest.mark.parametrize("version", [1, 2])
def test_a_fault_loses_and_doubles_nothing_and_leaves_nothing_moving(
    layer: str, kind: str, at: int, version: int, tmp_path: Path
) -> None:
    tls = certificate(tmp_path) if version == 2 else None
    found = run(Case(0, layer, kind, (f"{kind}@{at}:1",), at, version if tls else 1), tls)
    assert found.wrong == () and found.struck and found.seconds < 30.0
    if layer != "web" or at < 13:
        assert found.code == 3


def test_cases_reach_every_layer_and_request() -> None:
    cases = [case_of(seed, tls=True) for seed in range(1000)]
    assert {each.layer for each in cases} == set(LAYERS) and {each.version for each in cases} == {1, 2}
    assert {each.at for each in cases if each.layer == "web"} == set(range(1, REQUESTS + 1))
    assert shutil.which("openssl") is None or case_of(7, tls=True) == case_of(7, tls=True)


@pytest.mark.parametrize(
    ("running", "accepted", "code", "said", "words"),
    [
        (True, [], 3, "stopped", "left moving"),
        (False, [(1, LINES[0]), (3, LINES[2])], 3, "stopped", "lost or doubled"),
        (False, [(1, LINES[0]), (1, LINES[0]), (None, SAFE)], 3, "stopped", "lost or doubled"),
        (False, [(1, LINES[1]), (None, SAFE)], 3, "stopped", "other lines"),
        (False, [(1, LINES[0])], 3, "stopped", "the extruder was not made safe"),
        (False, [(1, LINES[0])], 0, "done", "called done, and is not"),
        (False, [], 3, "", "not told"),
        (False, [], 1, "Traceback", "exit code 1"),
    ],
)
def test_what_must_not_be_is_noticed(
    running: bool, accepted: list[tuple[int | None, str]], code: int, said: str, words: str,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr("benchmarks.link_faults.AFTER", 0.05)
    machine = SimpleNamespace(
        controller=SimpleNamespace(running=running), board_record=lambda: SimpleNamespace(accepted=accepted)
    )
    found = list(wrong_with(Case(0, "web", "drop", (), 1, 1), machine, code, said, tmp_path))  # type: ignore[arg-type]
    assert words in found
