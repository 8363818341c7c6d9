"""python -m benchmarks.attack."""

import sys

from benchmarks.attack.command import main

if __name__ == "__main__":
    sys.exit(main())
