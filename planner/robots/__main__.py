"""The robots that ship, or one of them or of the user's own in detail.

python -m planner.robots [NAME or my_robot.yaml]
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("robots"))
