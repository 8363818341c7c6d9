"""Correct a program by what the robot did in its last run.

python -m planner.feedback.learn cylinder_logo run.csv
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("learn"))
