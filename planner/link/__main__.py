"""A program to its controller, watched while it runs.

python -m planner.link PROGRAM.mod --controller HOST --head HOST
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("link"))
