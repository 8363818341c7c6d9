"""Simulators of what a print runs on.

python -m planner.simulate controller|board|stream|egm
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("simulate"))
