"""Send a plan's moves to a controller while it runs them.

python -m planner.link.stream OUT_DIR --controller HOST
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("stream"))
