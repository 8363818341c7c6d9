"""Read a problem and all that it names, without planning it.

python -m planner.check cylinder_logo.yaml
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("check"))
