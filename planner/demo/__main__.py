"""Show a print that ships planned.

python -m planner.demo
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("demo"))
