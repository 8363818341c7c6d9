"""python -m planner.new my_print.yaml"""

import sys

from planner.new.command import main

if __name__ == "__main__":
    sys.exit(main())
