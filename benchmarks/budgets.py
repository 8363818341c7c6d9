"""Demanding inputs: how much time and memory each takes, or how soon it is refused.

python -m benchmarks.budgets                  all, about half an hour on two free cores
python -m benchmarks.budgets curves uses      some of them
python -m benchmarks.budgets --list           list them
python -m benchmarks.budgets --model          the model of time and memory against the committed runs

Each input is generated into its own folder and given to a command in its own process; peak memory is that of all its
processes together. The exit code is 1 if one exceeds its budget of time or memory, or ends in another way.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import parser_of
from benchmarks.memory import held_mb
from benchmarks.usage import ROOT, cpu_seconds, machine
from planner.base.errors import EXIT_INPUT, EXIT_VERIFIED
from planner.planning.estimate import estimate
from planner.planning.options import DEFAULT_DT
from planner.toolpath.workload import Workload

QUICK_S, QUICK_MB = 20.0, 1500.0  # of a check
LOOK = 0.2  # s between two looks at memory, at least
SELDOM = 30.0  # of the time that a look takes: the kernel counts the pages of large processes for long
RESULTS = ROOT / "benchmarks" / "results"  # a folder a day
SPEED = 0.04  # m/s, of all committed runs of the model

CELL = """\
name: budget
cell:
  arm: irb140
  nozzle: {tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}
  home_deg: [0, 0, 0, 0, 45, 0]
  bed_mm: [480, 0, 150]
"""
TURNTABLE = """\
name: budget
cell:
  arm: irb140
  nozzle: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 0, 1], diameter_mm: 0.6}
  home_deg: [30, 20, 30, 90, -80, 60]
  positioner:
    robot: irbp_a250
    origin_mm: [633.5, 9.87, 320]
    part_mm: [0, 0, 60]
    free: [rotation]
    held_deg: {tilt: 0}
part:
  cylinder: {radius_mm: 34, height_mm: 100, centre_mm: [31.4, 37]}
"""
PROCESS = """\
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
"""
BEAD = "  bead: {width_mm: 0.6, height_mm: 0.5}\n"


@dataclass(frozen=True)
class Case:
    """An input: what it is, what writes it into a folder and returns the problem's file, and its budget.

    command: check or solve; code: with which it ends; seconds and mb: at most
    """

    what: str
    make: Callable[[Path], Path]
    command: str
    code: int
    seconds: float
    mb: float


@dataclass(frozen=True)
class Outcome:
    """What a run took, CPU seconds of all its processes too, and the last line that it said."""

    code: int
    seconds: float
    cpu_s: float
    mb: float
    said: str

    def kept(self, case: Case) -> bool:
        """Whether the budget was kept."""
        return self.code == case.code and self.seconds <= case.seconds and self.mb <= case.mb


def _drawing(folder: Path, svg: str, layers: int = 1, width: float = 78.0) -> Path:
    (folder / "drawing.svg").write_text(svg, encoding="utf-8")
    spec = f"layers:\n  source: {{svg: drawing.svg, width_mm: {width:g}}}\n  wrap: cylinder\n  count: {layers}\n  height_mm: 0.5\n"
    return _problem(folder, TURNTABLE + spec + PROCESS + BEAD)


def _problem(folder: Path, text: str) -> Path:
    file = folder / "problem.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def _svg(inside: str) -> str:
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1000 1000">{inside}</svg>'


def _path_of(length: int, seed: int = 0) -> str:
    """Path data of so many characters: random curves through all of the page."""
    numbers = np.random.default_rng(seed).integers(0, 1000, (length // 20, 6))
    return "M0 0" + "".join("C" + " ".join(map(str, row)) for row in numbers.tolist())


def curves(folder: Path) -> Path:
    """A drawing of 99 kB whose curves cross all of it."""
    return _drawing(folder, _svg(f'<path d="{_path_of(99_000)}"/>'), width=60.0)


def curves_in_layers(folder: Path) -> Path:
    """The same in 100 layers."""
    return _drawing(folder, _svg(f'<path d="{_path_of(99_000)}"/>'), 100)


def clipped(folder: Path) -> Path:
    """The same, filled and cut by a circle: each crossing begins a face."""
    inside = f'<clipPath id="c"><circle cx="500" cy="500" r="300"/></clipPath><path clip-path="url(#c)" d="{_path_of(99_000)}"/>'
    return _drawing(folder, _svg(inside))


def tiny(folder: Path) -> Path:
    """A path of 20 MB in steps of a unit."""
    return _drawing(folder, _svg(f'<path d="M0 0{"h1v1" * 4_900_000}"/>'))


def uses(folder: Path) -> Path:
    """Groups that use each other twice, thirty levels deep: a thousand million squares."""
    levels = [f'<g id="g{k}"><use href="#g{k + 1}"/><use href="#g{k + 1}" x="1"/></g>' for k in range(30)]
    return _drawing(folder, _svg("".join(levels) + '<rect id="g30" width="9" height="9"/>'))


def rules(folder: Path) -> Path:
    """Twenty thousand style rules for as many elements."""
    style = "".join(f".c{k}{{fill:none}}" for k in range(20_000))
    return _drawing(folder, _svg(f"<style>{style}</style>" + '<path class="c1" d="M0 0h9"/>' * 20_000))


def blocks(folder: Path) -> Path:
    """A DXF file whose blocks hold each other ten times, eight levels deep."""
    parts = ["0", "SECTION", "2", "BLOCKS"]
    for k in range(8):
        parts += ["0", "BLOCK", "8", "0", "2", f"b{k}", "70", "0", "10", "0", "20", "0", "30", "0", "3", f"b{k}"]
        inside = ["0", "INSERT", "8", "0", "2", f"b{k + 1}", "10", "1", "20", "1", "30", "0"]
        line = ["0", "LINE", "8", "0", "10", "0", "20", "0", "30", "0", "11", "9", "21", "9", "31", "0"]
        parts += (inside if k < 7 else line) * 10
        parts += ["0", "ENDBLK", "8", "0"]
    parts += ["0", "ENDSEC", "0", "SECTION", "2", "ENTITIES", "0", "INSERT", "8", "0", "2", "b0"]
    parts += ["10", "0", "20", "0", "30", "0", "0", "ENDSEC", "0", "EOF"]
    (folder / "drawing.dxf").write_text("\n".join(parts) + "\n", encoding="ascii")
    spec = "layers:\n  source: {dxf: drawing.dxf, width_mm: 50}\n  wrap: cylinder\n  count: 1\n  height_mm: 0.5\n"
    return _problem(folder, TURNTABLE + spec + PROCESS + BEAD)


def yaml(folder: Path) -> Path:
    """A problem file of 2 MB."""
    return _problem(folder, CELL + "layers: [" + "[1, 2], " * 250_000 + "]\n")


def facets(folder: Path) -> Path:
    """A mesh that announces, and holds, three million facets."""
    count = 3_000_000
    with (folder / "body.stl").open("wb") as stream:
        stream.write(b"\0" * 80 + count.to_bytes(4, "little"))
        stream.write(b"\0" * (50 * count))
    spec = "part:\n  mesh: {file: body.stl}\nlayers:\n  source: {pattern: zigzag, cell_mm: 5, size_mm: [50, 50]}\n"
    spec += "  project: z\n  count: 1\n  height_mm: 0.5\n"
    return _problem(folder, CELL + spec + PROCESS + BEAD)


def _gcode() -> str:
    """Cell, layers and process of a file of G-code, whose bed's middle is at x 110, y 110."""
    spec = "layers:\n  source: {gcode: print.gcode, origin_mm: [-110, -110, 0]}\n"
    return CELL + spec + PROCESS + "  bead: {width_mm: 0.5}\n"


def _level(folder: Path, layers: int, side: float, height: float) -> Path:
    """A column with square layers of one bead."""
    filament = side * 0.5 * height / (0.25 * np.pi * 1.75**2)
    with (folder / "print.gcode").open("w", encoding="ascii") as stream:
        stream.write("G21\nG90\nM83\n")
        for k in range(1, layers + 1):
            stream.write(
                f";LAYER_CHANGE\n;Z:{height * k:.3f}\n;HEIGHT:{height:g}\nG1 Z{height * k:.3f}\nG1 X110 Y110\n"
            )
            for x, y in ((side, 0.0), (side, side), (0.0, side), (0.0, 0.5)):
                stream.write(f"G1 X{110 + x:g} Y{110 + y:g} E{filament:.6f}\n")
    return _problem(folder, _gcode())


def layers_250(folder: Path) -> Path:
    """250 layers 0.05 mm high, of 8 mm each."""
    return _level(folder, 250, 2.0, 0.05)


def layers_1000(folder: Path) -> Path:
    """1,000 such layers."""
    return _level(folder, 1_000, 2.0, 0.05)


def layers_5000(folder: Path) -> Path:
    """5,000 such layers."""
    return _level(folder, 5_000, 2.0, 0.05)


def layers_too_long(folder: Path) -> Path:
    """5,000 such layers of 80 mm each."""
    return _level(folder, 5_000, 20.0, 0.05)


def moves(folder: Path) -> Path:
    """A file of G-code of 199 MB that extrudes 1,700 m."""
    rng = np.random.default_rng(0)
    with (folder / "print.gcode").open("w", encoding="ascii") as stream:
        stream.write("G21\nG90\nM83\nG1 Z0.2\nG1 X100 Y100\n")
        block = "".join(f"G1 X{x:.3f} Y{y:.3f} E0.01500\n" for x, y in 100 + 0.5 * rng.random((100_000, 2)))
        for _ in range(190_000_000 // len(block)):
            stream.write(block)
    return _problem(folder, _gcode())


def _dots(folder: Path, count: int) -> Path:
    """So many beads of 1.2 mm in layers of 1,000."""
    with (folder / "dots.csv").open("w", encoding="ascii") as stream:
        stream.write("x,y,z,nx,ny,nz,bead,layer\n")
        for i in range(count):
            layer, k = divmod(i, 1_000)
            row, column = divmod(k, 25)
            column = 24 - column if row % 2 else column
            for way in (0.0, 0.6, 1.2):
                x, y = 2.2 * (column - 12) + way, 2.0 * (row - 20)
                stream.write(f"{x:.3f},{y:.3f},{0.5 * (layer + 1):.2f},0,0,1,{i},{layer}\n")
    return _problem(folder, CELL + "layers:\n  source: {waypoints: dots.csv}\n" + PROCESS + BEAD)


def dots_2000(folder: Path) -> Path:
    """2,000 beads of 1.2 mm."""
    return _dots(folder, 2_000)


def dots_20000(folder: Path) -> Path:
    """20,000 beads of 1.2 mm."""
    return _dots(folder, 20_000)


def links(folder: Path) -> Path:
    """A robot whose URDF is a chain of 20,000 links."""
    parts = ["<robot name='r'>"]
    for k in range(20_000):
        parts.append(f"<link name='l{k}'/>")
        if k:
            joint = f"<joint name='j{k}' type='fixed'><parent link='l{k - 1}'/><child link='l{k}'/></joint>"
            parts.append(joint)
    (folder / "robot.urdf").write_text("".join([*parts, "</robot>"]), encoding="utf-8")
    shipped = (ROOT / "robots" / "irb140.yaml").read_text(encoding="utf-8")
    (folder / "robot.yaml").write_text(shipped.replace("irb140.urdf", "robot.urdf"), encoding="utf-8")
    (folder / "path.txt").write_text("0 0 1 0 0 1\n9 0 1 0 0 1\n", encoding="ascii")
    cell = CELL.replace("arm: irb140", "arm: robot.yaml")
    return _problem(folder, cell + "layers:\n  source: {waypoints: path.txt}\n" + PROCESS + BEAD)


def _refused(what: str, make: Callable[[Path], Path], command: str = "check") -> Case:
    return Case(what, make, command, EXIT_INPUT, QUICK_S, QUICK_MB)


CASES = {
    "curves": Case("99 kB of curves", curves, "check", EXIT_VERIFIED, QUICK_S, QUICK_MB),
    "curves-100": _refused("99 kB of curves in 100 layers", curves_in_layers),
    "clipped": _refused("99 kB of curves, filled and clipped", clipped),
    "tiny": _refused("20 MB of tiny steps", tiny),
    "uses": _refused("2^30 squares by <use>", uses),
    "rules": _refused("20,000 style rules on as many elements", rules),
    "blocks": _refused("10^8 lines in DXF blocks", blocks),
    "yaml": _refused("a problem file of 2 MB", yaml),
    "facets": _refused("3,000,000 facets", facets),
    "links": _refused("a URDF of 20,000 links", links),
    "moves": Case("199 MB of G-code", moves, "check", EXIT_VERIFIED, QUICK_S, QUICK_MB),
    "moves-solve": Case("the same, solved", moves, "solve", EXIT_INPUT, 60.0, 3000.0),
    "layers-5000-long": _refused("5,000 layers, 4 million waypoints", layers_too_long, "solve"),
    "layers-250": Case("250 thin layers", layers_250, "solve", EXIT_VERIFIED, 60.0, 1500.0),
    "layers-1000": Case("1,000 thin layers", layers_1000, "solve", EXIT_VERIFIED, 180.0, 2000.0),
    "layers-5000": Case("5,000 thin layers", layers_5000, "solve", EXIT_VERIFIED, 600.0, 4000.0),
    "dots-2000": Case("2,000 tiny beads", dots_2000, "solve", EXIT_VERIFIED, 60.0, 1500.0),
    "dots-20000": Case("20,000 tiny beads", dots_20000, "solve", EXIT_VERIFIED, 300.0, 4000.0),
}


def run(case: Case, limit: float) -> Outcome:
    """Generate an input and give it to its command; ended after `limit` times the seconds that it may take."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = [sys.executable, "-m", f"planner.{case.command}", str(case.make(folder))]
        words += ["--quiet", "--out", str(folder / "out")] if case.command == "solve" else []
        began, used = time.perf_counter(), cpu_seconds()
        process = subprocess.Popen(
            words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        )
        most, ended = [0.0], threading.Event()

        def watch() -> None:
            pause = LOOK
            while not ended.wait(pause):
                looked = time.perf_counter()
                most[0] = max(most[0], held_mb(process.pid))
                pause = max(LOOK, SELDOM * (time.perf_counter() - looked))

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        try:
            said, _ = process.communicate(timeout=limit * case.seconds)
        except subprocess.TimeoutExpired:
            process.terminate()
            said, _ = process.communicate()
        seconds = time.perf_counter() - began
        ended.set()
        watcher.join()
    lines = [line for line in said.replace(f"{folder}/", "").splitlines() if line.strip()]
    return Outcome(process.returncode, seconds, cpu_seconds() - used, most[0], lines[-1] if lines else "")


def committed() -> Iterator[tuple[str, float, float, float, float]]:
    """Of the committed runs of the default strategy: problem, seconds taken and expected, memory taken and expected [MB]."""
    for name in ("runs.csv", "scaling.csv"):
        newest = max(RESULTS.glob(f"*/{name}"))
        with newest.open(encoding="utf-8") as stream:
            rows = [row for row in csv.DictReader(stream) if row["strategy"] == "sqp" and row["peak_mb"]]
        for row in rows:
            if row["planner"].startswith("beadwise") and row["print_time_s"]:
                metres = float(row["deposited_length_mm"]) * 1e-3
                balls = round(metres / 0.5e-3 * 1.5)  # of beads that are some 0.7 mm wide and half a millimetre high
                work = Workload(int(row["beads"]), int(row["layers"]), int(row["waypoints"]), metres, balls)
                expected = estimate(work, metres / float(row["deposition_time_s"]), DEFAULT_DT)
                yield (
                    row["problem"],
                    float(row["seconds_total"]),
                    expected.seconds,
                    float(row["peak_mb"]),
                    expected.bytes / 1e6,
                )


def show_model(console: Console) -> None:
    """Print the model's figures beside those of the committed runs."""
    table = Table("problem", "s", "expected", "ratio", "MB", "expected", "ratio")
    ratios = []
    for name, seconds, expected, mb, expected_mb in committed():
        ratios.append((expected / seconds, expected_mb / mb))
        table.add_row(
            name,
            f"{seconds:.1f}",
            f"{expected:.1f}",
            f"{ratios[-1][0]:.2f}",
            f"{mb:.0f}",
            f"{expected_mb:.0f}",
            f"{ratios[-1][1]:.2f}",
        )
    console.print(table)
    time_ratios, memory_ratios = np.array(ratios).T
    console.print(
        f"expected over taken: time {time_ratios.min():.2f} to {time_ratios.max():.2f}, median {np.median(time_ratios):.2f}; "
        f"memory {memory_ratios.min():.2f} to {memory_ratios.max():.2f}, median {np.median(memory_ratios):.2f}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = parser_of("budgets", __doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(CASES)}; default: all")
    parser.add_argument(
        "--wait", type=float, default=2.0, metavar="TIMES", help="end a case after this many times its seconds"
    )
    parser.add_argument("--list", action="store_true", help="list the cases, and run nothing")
    parser.add_argument("--model", action="store_true", help="time and memory as estimated, against the committed runs")
    options = parser.parse_args(arguments)
    console = Console(width=150)
    unknown = [name for name in options.names if name not in CASES]
    if unknown:
        parser.error(f"there is no {unknown[0]!r}; there are {', '.join(CASES)}")
    if options.list:
        for name, case in CASES.items():
            console.print(f"{name:<18}{case.command:<7}{case.what}", highlight=False)
        return 0
    if options.model:
        show_model(console)
        return 0
    table = Table("input", "command", "s", "at most", "CPU s", "MB", "at most", "exit", "", title=machine())
    kept = True
    for name in options.names or CASES:
        case = CASES[name]
        outcome = run(case, options.wait)
        kept = kept and outcome.kept(case)
        console.print(f"{name}: {outcome.said}", highlight=False, markup=False, soft_wrap=True)
        table.add_row(
            case.what,
            case.command,
            f"{outcome.seconds:.1f}",
            f"{case.seconds:.0f}",
            f"{outcome.cpu_s:.1f}",
            f"{outcome.mb:.0f}",
            f"{case.mb:.0f}",
            f"{outcome.code}",
            "kept" if outcome.kept(case) else "NOT KEPT",
        )
    console.print(table)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
