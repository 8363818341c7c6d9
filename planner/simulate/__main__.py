"""Simulators of what a print runs on.

python -m planner.simulate controller|board|stream|egm
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("simulate"))
