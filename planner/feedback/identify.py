"""A test program that shows a robot's limits, and the limits read off its recording.

python -m planner.feedback.identify write cylinder_logo
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("identify"))
