"""Plan a print: from its problem file to a verified robot program.

python -m planner.solve cylinder_logo.yaml
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("solve"))
