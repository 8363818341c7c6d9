"""python -m planner.view PROBLEM|OUT_DIR"""

import sys

from planner.view.command import main

if __name__ == "__main__":
    sys.exit(main())
