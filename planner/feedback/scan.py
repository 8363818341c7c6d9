"""Lay the rest of a print on what a scan finds of it.

python -m planner.feedback.scan cylinder_logo cloud.ply --after-layer 4
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("scan"))
