"""References that are made from the code.

python -m planner.reference all
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("reference"))
