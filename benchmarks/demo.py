"""Make the report that `beadwise demo` shows, with the present code.

python -m benchmarks.demo
"""

from __future__ import annotations

import argparse
import gzip
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from planner.planning.files import write
from planner.planning.pipeline import solve
from planner.report.demo import PROBLEM, SHIPPED

DT = 0.016  # s between samples: enough for a picture, and small in the package


def main(arguments: Sequence[str] | None = None) -> int:
    """Plan the problem, and pack its report; 1 if it is not verified."""
    argparse.ArgumentParser(prog="python -m benchmarks.demo", description=__doc__).parse_args(arguments)
    plan = solve(PROBLEM, dt=DT)
    if not plan.verified:
        print(f"{PROBLEM} is not verified: {SHIPPED} is as it was", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        write(plan, Path(folder) / PROBLEM)
        report = (Path(folder) / PROBLEM / "report.html").read_bytes()
    SHIPPED.write_bytes(gzip.compress(report, mtime=0))
    print(f"{SHIPPED.name}: {SHIPPED.stat().st_size / 1e3:.0f} kB, {len(report) / 1e3:.0f} kB unpacked")
    return 0


if __name__ == "__main__":
    sys.exit(main())
