"""Send a plan's moves to a controller while it runs them.

python -m planner.link.stream OUT_DIR --controller HOST
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("stream"))
