"""Draw the pictures of the concept pages.

python -m benchmarks.drawings                     all of them, into docs/pictures
python -m benchmarks.drawings frames rolls
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from benchmarks.drawings import cells, plans, sketches

DRAWINGS: dict[str, Callable[[Path], None]] = {
    "frames": cells.frames,
    "rolls": cells.rolls,
    "map": plans.roll_map,
    "dip": plans.dip,
    "tip_rule": sketches.tip_rule,
    "sections": sketches.sections,
    "around": sketches.around,
}
PICTURES = Path("docs/pictures")
COLOURS = 256  # of a palette: drawings need no more, and stay small


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.drawings", description="Draw the concept pages.")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(DRAWINGS)}; default: all")
    parser.add_argument("--pictures", type=Path, default=PICTURES, metavar="DIR", help="draw there")
    options = parser.parse_args(arguments)
    for name in options.names or DRAWINGS:
        if name not in DRAWINGS:
            parser.error(f"no drawing {name!r}; there are {', '.join(DRAWINGS)}")
        target = options.pictures / f"concept_{name}.png"
        DRAWINGS[name](target)
        Image.open(target).convert("RGB").quantize(COLOURS, kmeans=2).save(target, optimize=True)
        print(target, f"{target.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
