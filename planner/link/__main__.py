"""python -m planner.link PROGRAM.mod --controller HOST --head HOST"""

import sys

from planner.link.command import main

if __name__ == "__main__":
    sys.exit(main())
