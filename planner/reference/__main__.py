"""References that are made from the code.

python -m planner.reference all
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("reference"))
