"""The live view: a report in the browser, solved anew whenever its files are saved.

python -m planner.view PROBLEM|OUT_DIR
"""

from __future__ import annotations

import sys

from planner.base.launch import launch

if __name__ == "__main__":
    sys.exit(launch("view"))
