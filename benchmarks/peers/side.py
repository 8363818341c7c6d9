"""What the scripts of all peers share: read a case's folder, write what came out. It knows nothing of the planner."""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Plan = Callable[[list[Array]], tuple[list[Array], str]]
WARM = 40  # waypoints that are planned before the clock starts


@dataclass(frozen=True)
class Case:
    """poses: nozzle in the part frame (n, 4, 4) at any roll; bead (n); the rest as in limits.json, SI units."""

    folder: Path
    bead: NDArray[np.int64]
    poses: Array
    joints: list[str]
    arm_joints: int
    home: Array
    q_min: Array
    q_max: Array
    velocity: Array
    speed: float
    opw: dict[str, float] | None

    @property
    def beads(self) -> list[Array]:
        """The poses of each bead."""
        return [self.poses[self.bead == i] for i in range(int(self.bead[-1]) + 1)]


def read_case(folder: Path) -> Case:
    """Read a case's three files; all are written by `benchmarks.peers.case`."""
    rows = np.loadtxt(folder / "waypoints.csv", delimiter=",", skiprows=1, ndmin=2)
    z, x = rows[:, 4:7], rows[:, 7:10]
    poses = np.zeros((len(rows), 4, 4))
    poses[:, :3, 0], poses[:, :3, 1], poses[:, :3, 2], poses[:, :3, 3] = x, np.cross(z, x), z, rows[:, 1:4]
    poses[:, 3, 3] = 1.0
    data = json.loads((folder / "limits.json").read_text(encoding="utf-8"))
    arrays = {name: np.array(data[name]) for name in ("home", "q_min", "q_max", "velocity")}
    plain = {name: data[name] for name in ("joints", "arm_joints", "speed", "opw")}
    return Case(folder=folder, bead=rows[:, 0].astype(int), poses=poses, **arrays, **plain)


def main(package: str, prepare: Callable[[Case, list[str]], Plan]) -> int:
    """Run one peer: SCRIPT CASE_FOLDER OUT_FOLDER [OPTION ...].

    prepare(case, options) sets up robot and solver, and is not timed; what it returns plans the beads' poses, and gives
    joints (n, nj) in the case's order for each bead and what the peer says of them: empty if it claims success. Writes
    q.csv and facts.json with the seconds of that call alone, made once before on a few waypoints.
    """
    case, out = read_case(Path(sys.argv[1]).resolve()), Path(sys.argv[2])
    plan = prepare(case, sys.argv[3:])
    plan([case.beads[0][:WARM]])
    wall, cpu = time.perf_counter(), time.process_time()
    beads, said = plan(case.beads)
    facts = {
        "seconds": time.perf_counter() - wall,
        "cpu_seconds": time.process_time() - cpu,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        "version": f"{package} {version(package)}",
        "said": said,
    }
    if beads:
        np.savetxt(
            out / "q.csv", np.vstack(beads), fmt="%.15g", delimiter=",", header=",".join(case.joints), comments=""
        )
    (out / "facts.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return 0
