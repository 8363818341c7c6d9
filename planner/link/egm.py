"""Send a plan's joints to a controller by externally guided motion.

python -m planner.link.egm OUT_DIR
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("egm"))
