"""Prints with one injected fault each, over the link's own command, sockets and threads, against the simulators.

python -m benchmarks.link_faults [--runs 1000] [--seed 0] [--workers 16]

Faults hit the controller's web services at any request of a run (refused, failing, without login, busy, dropped before or
after it was done, slow, dripping, garbage, another kind of text, subscription lost; once, three times, or from there on),
its program's socket, the extruder's board, and FTP. Half of the runs use version 2.0, over TLS. After each run the
simulators are checked: nothing lost, nothing doubled, nothing left moving, and the reason given to the user.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.stream_rate import straight
from planner.base.results import digest
from planner.export.program import RobotProgram
from planner.link import command
from planner.simulate.board import BOARD_FAULTS, CONTROLLER_FAULTS, faults_of
from planner.simulate.ftp import FTP_FAULTS, FtpAccess, FtpServer
from planner.simulate.rws import RWS_FAULTS, Access
from planner.simulate.start import Simulated, start

PASSWORD = "simulated"
MODULE = "Faults"
LINES = ("M83", "T0", *(f"G1 E0.{k} F600" for k in range(100, 118)), "M104 S0")
PACE = 0.7  # the robot moves for 3 s
REQUESTS = 16  # of a run without faults, from the first question to the last look
COMMANDS = 9  # of FTP
STOPPING = "web, stopping"  # the board fails, and so do the web services from then on, which are to stop the robot
LAYERS = ("web",) * 9 + (STOPPING,) * 4 + ("board",) * 3 + ("controller",) * 3 + ("ftp",)
FIRST_WATCHED = 13  # request after the start
AFTER = 5.0  # s after a run that failed, in which the robot is looked at
SAFE = "M106 P0 S0"


@dataclass(frozen=True)
class Case:
    """What goes wrong in a run: the layer, the kind, the words for the simulators, and the version that is spoken."""

    seed: int
    layer: str
    kind: str
    faults: tuple[str, ...]
    at: int
    version: int


@dataclass(frozen=True)
class Finding:
    """How a run ended: exit code, time [s], last words, what must not be, in words, and whether the fault came about."""

    case: Case
    code: int
    seconds: float
    said: str
    wrong: tuple[str, ...]
    by_hand: bool
    struck: bool


def case_of(seed: int, tls: bool) -> Case:
    """The case of a seed."""
    rng = random.Random(seed)
    layer = rng.choice(LAYERS)
    version = 2 if tls and rng.random() < 0.5 else 1
    if layer in ("web", STOPPING):
        first, last = (1, REQUESTS) if layer == "web" else (FIRST_WATCHED, FIRST_WATCHED + 7)
        kind, at = rng.choice(sorted(RWS_FAULTS)), rng.randint(first, last)
        value = {"slow": rng.uniform(0.2, 20.0), "drip": rng.uniform(0.02, 4.0)}.get(kind, 1.0)
        times = rng.choice((1, 1, 3, 300))
        return Case(seed, layer, kind, tuple(f"{kind}@{at + k}:{value:.2f}" for k in range(times)), at, version)
    kinds = {"board": BOARD_FAULTS, "controller": CONTROLLER_FAULTS, "ftp": FTP_FAULTS}[layer]
    kind = rng.choice(sorted(kinds))
    at = rng.randint(1, COMMANDS if layer == "ftp" else len(LINES))
    value = {"delay": rng.uniform(0.2, 8.0), "mute": rng.uniform(0.2, 30.0)}.get(kind, 1.0)
    return Case(seed, layer, kind, (f"{kind}@{at}:{value:.2f}",), at, version)


def made_program() -> RobotProgram:
    """A straight line of moves at 0.1 m/s that sends a line after each, as the simulator's reader would give it."""
    sends = {k: (text,) for k, text in enumerate(LINES)}
    return straight(MODULE, 0.01 * np.arange(len(LINES)), 0.1, 1.0, 1.0, 1.0, sends=sends)


def written(folder: Path) -> Path:
    """The program's files, as far as the link reads them."""
    path = folder / f"{MODULE}.mod"
    hello = f'        SocketSend bwClient\\Str:="H {MODULE} {len(LINES)}\\0A";\n'
    path.write_text(f"MODULE {MODULE}\n    ! Problem faults\n    PROC main()\n{hello}    ENDPROC\nENDMODULE\n")
    rows = [
        f"{n},{(n - 2) // 6 if 1 < n < len(LINES) else -1},0,{0.1 * n:.3f},{text}" for n, text in enumerate(LINES, 1)
    ]
    table = folder / f"{MODULE}_lines.csv"
    table.write_text("\n".join(["n,bead,layer,t_s,text", *rows, ""]))
    (folder / "plan.json").write_text(json.dumps({"files": {each.name: digest(each) for each in (path, table)}}))
    return path


def run(case: Case, tls: tuple[Path, Path] | None) -> Finding:
    """One print with its fault."""
    os.environ[command.PASSWORD] = PASSWORD
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        program = written(folder)
        made = made_program()
        faults = {layer: case.faults if case.layer == layer else () for layer in LAYERS}
        certificate_of_it, key = tls if tls is not None and case.version == 2 else (None, None)
        access = Access(password=PASSWORD, version=case.version, certificate=certificate_of_it, key=key)
        machine = start(
            pace=PACE, read=lambda modules: (made,), in_use=True, access=access, rws_faults=faults["web"] + faults[STOPPING],
            board_faults=faults["board"] + (("error@9",) if case.layer == STOPPING else ()),
            controller_faults=faults["controller"],
        )  # fmt: skip
        stack.enter_context(machine)
        words = [str(program), "--controller", address(machine.rws), "--head", address(machine.board), "--quiet"]
        words += [
            "--socket-port",
            str(machine.program[1]),
            "--log",
            str(folder / "log.jsonl"),
            "--rws",
            str(case.version),
        ]
        if case.version == 2 and tls is not None:
            words += ["--certificate", str(tls[0])]
        ftp = None
        if case.layer == "ftp":
            who = FtpAccess(password=PASSWORD)
            ftp = FtpServer("127.0.0.1", 0, machine.controller, who, faults_of(case.faults, FTP_FAULTS))
            stack.enter_context(closing(ftp))
            words += ["--upload", "ftp", "--ftp-port", str(ftp.address[1])]
        said, since = io.StringIO(), time.monotonic()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            code = command.main(words)
        seconds, text = time.monotonic() - since, said.getvalue()
        reached = len(machine.board_record().accepted)
        if case.layer in ("web", STOPPING):
            reached = len(machine.requests())
        elif ftp is not None:
            reached = ftp.commands
        wrong = tuple(wrong_with(case, machine, code, text, folder))
        return Finding(case, code, seconds, text, wrong, "by hand" in text, reached >= case.at)


def address(where: tuple[str, int]) -> str:
    """HOST:PORT."""
    return f"{where[0]}:{where[1]}"


def wrong_with(case: Case, machine: Simulated, code: int, said: str, folder: Path) -> Iterator[str]:
    """What must not be after a run."""
    moving = machine.controller.running
    if moving:
        end = time.monotonic() + AFTER
        while machine.controller.running and time.monotonic() < end:
            time.sleep(0.02)
        yield "left moving" if machine.controller.running else "moving when the link had ended"
    record = machine.board_record().accepted
    numbered = [(n, gcode) for n, gcode in record if n is not None]
    if [n for n, _ in numbered] != list(range(1, len(numbered) + 1)):
        yield "lost or doubled"
    if [gcode for _, gcode in numbered] != list(LINES[: len(numbered)]):
        yield "other lines"
    log = folder / "log.jsonl"
    notes = [json.loads(row) for row in log.read_text().splitlines()] if log.exists() else []
    acknowledged = sum(note["what"] == "acknowledged" for note in notes)
    if not acknowledged <= len(numbered) <= acknowledged + 1:
        yield f"{len(numbered)} done, {acknowledged} acknowledged"
    if code == 0 and len(numbered) != len(LINES):
        yield "called done, and is not"
    if code not in (0, 2, 3):
        yield f"exit code {code}"
    if code != 0 and numbered and case.layer != "board" and (not record or record[-1][1] != SAFE):
        yield "the extruder was not made safe"
    if "Traceback" in said or (code and not said.strip()):
        yield "not told"


def certificate(folder: Path) -> tuple[Path, Path] | None:
    """A certificate for this computer, and its key; None without openssl."""
    if shutil.which("openssl") is None:
        return None
    out = folder / "cert", folder / "key"
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    made += ["-addext", "subjectAltName=IP:127.0.0.1", "-out", str(out[0]), "-keyout", str(out[1])]
    subprocess.run(made, check=True, capture_output=True)
    return out


def show(findings: Sequence[Finding]) -> int:
    """Print a table; the number of runs with which something is wrong."""
    struck = [each for each in findings if each.struck]
    missed = len(findings) - len(struck)
    table = Table(title=f"{len(struck)} prints with a fault ({missed} more were over before it came)")
    for column in ("layer", "fault", "runs", "printed all the same", "stopped or refused", "worst, s", "wrong"):
        table.add_column(column, justify="left" if column in ("layer", "fault") else "right")
    for layer, kind in sorted({(each.case.layer, each.case.kind) for each in struck}):
        group = [each for each in struck if (each.case.layer, each.case.kind) == (layer, kind)]
        printed = sum(each.code == 0 for each in group)
        worst = max(each.seconds for each in group)
        bad = sum(bool(each.wrong) for each in group)
        table.add_row(layer, kind, str(len(group)), str(printed), str(len(group) - printed), f"{worst:.1f}", str(bad))
    Console(width=110).print(table)
    codes = Counter(each.code for each in struck)
    print("exit codes:", ", ".join(f"{code}: {n}" for code, n in sorted(codes.items())))
    print("told to stop the robot by hand:", sum(each.by_hand for each in struck))
    wrong = [each for each in findings if each.wrong]
    for what in ("lost or doubled", "other lines", "left moving", "moving when the link had ended"):
        print(f"{what}: {sum(what in each.wrong for each in findings)}")
    for each in wrong[:20]:
        print(f"seed {each.case.seed}, {each.case.faults[:2]}: {'; '.join(each.wrong)}\n    {each.said.strip()[-300:]}")
    return len(wrong)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what became of all runs; 1 where something is wrong with one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.link_faults")
    parser.add_argument("--runs", type=int, default=1000, help="in which the fault came about")
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--workers", type=int, default=16, help="runs at a time; they mostly wait")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        tls = certificate(Path(folder))
        findings: list[Finding] = []
        seed = options.seed
        with multiprocessing.get_context("fork").Pool(options.workers) as pool:
            while (left := options.runs - sum(each.struck for each in findings)) > 0:
                cases = [case_of(seed + k, tls is not None) for k in range(left)]
                findings += pool.imap_unordered(partial(run, tls=tls), cases)
                seed += left
    return 1 if show(findings) else 0


if __name__ == "__main__":
    sys.exit(main())
