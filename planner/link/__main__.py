"""A program to its controller, watched while it runs.

python -m planner.link PROGRAM.mod --controller HOST --head HOST
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("link"))
