"""Send a plan's joints to a controller by externally guided motion.

python -m planner.link.egm OUT_DIR
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("egm"))
