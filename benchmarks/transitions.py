"""Layers that change from one surface into another, compared by method: the height of beads, the lean of layers, and the share
of length at speed.

python -m benchmarks.transitions

Two bodies in the cell of saddle_ring: that ring, whose top bends over its full width, and a block, level below, whose top
has waves that are short compared with its height.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.problem.layers import TRANSITIONS

LENGTH, WIDTH, HEIGHT = 32.0, 14.0, 6.0  # mm, of the block
WAVE, AMPLITUDE = 12.0, 0.6  # mm, along its length
CELLS = 96, 4
BLOCK = ("layers.least_height_mm=0.25", "layers.height_mm=0.6", "process.bead.width_mm=0.8")
COLUMNS = (
    "body", "transition", "layers", "beads' height mm", "greatest tilt deg: first, middle, last layer", "mean tilt deg",
    "at speed", "slowest mm/s", "verified",
)  # fmt: skip


def waved_block() -> Array:
    """Facets (n, 3, 3) [mm] of the block, which stands on z = 0."""
    x = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, CELLS[0] + 1)
    y = np.linspace(-0.5 * WIDTH, 0.5 * WIDTH, CELLS[1] + 1)
    plane = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    top = np.dstack([plane, HEIGHT + AMPLITUDE * np.cos(2.0 * np.pi * plane[..., 0] / WAVE)])
    foot = np.dstack([plane, np.zeros(plane.shape[:2])])
    sheets = [top, foot[:, ::-1]]
    rims = ((np.s_[:, 0], 1), (np.s_[-1, :], 1), (np.s_[:, -1], -1), (np.s_[0, :], -1))
    sheets += [np.stack([foot[rim], top[rim]], axis=1)[::way] for rim, way in rims]
    found = []
    for p in sheets:
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        found += [np.stack(each, axis=-2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))]
    return np.concatenate(found)


def write_stl(path: Path, corners: Array) -> Path:
    """A binary STL file of facets (n, 3, 3)."""
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = corners
    path.write_bytes(bytes(80) + np.uint32(len(corners)).astype("<u4").tobytes() + record.tobytes())
    return path


def row(body: str, transition: str, changes: Sequence[str]) -> tuple[list[str], Plan]:
    """A line of the table, and its plan."""
    plan = solve(load_problem("saddle_ring", (*changes, f"layers.transition={transition}")), baseline=False)
    beads, m = plan.toolpath.beads, plan.metrics
    high = np.concatenate([bead.height for bead in beads]) * 1e3
    tilts = [
        np.degrees(np.arccos(np.clip(np.concatenate([b.normals[:, 2] for b in beads if b.layer == k]), -1.0, 1.0)))
        for k in range(plan.toolpath.layers)
    ]
    some = [tilts[k].max() for k in (0, (len(tilts) - 1) // 2, len(tilts) - 1)]
    cells = [
        body,
        transition,
        str(plan.toolpath.layers),
        f"{high.min():.3f} to {high.max():.3f}",
        ", ".join(f"{tilt:.1f}" for tilt in some),
        f"{np.concatenate(tilts).mean():.2f}",
        f"{m['at_speed_fraction']:.1%}",
        f"{m['speed_min_mm_s']:.1f}",
        "yes" if plan.verified else ", ".join(check.name for check in plan.checks if not check.ok),
    ]
    return cells, plan


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.transitions", description=__doc__)
    parser.parse_args(arguments)
    table, verified = Table(*COLUMNS), True
    with tempfile.TemporaryDirectory() as folder:
        file = write_stl(Path(folder) / "waved_block.stl", waved_block())
        bodies = {"saddle_ring": (), "waved block": (f"layers.source.mesh={file}", *BLOCK)}
        for body, changes in bodies.items():
            for transition in TRANSITIONS:
                cells, plan = row(body, transition, changes)
                table.add_row(*cells)
                verified = verified and plan.verified
    Console(width=180).print(table)
    return EXIT_VERIFIED if verified else EXIT_NOT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
