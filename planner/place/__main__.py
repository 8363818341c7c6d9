"""Where the part should stand: a map, and the best places, solved and verified.

python -m planner.place hemisphere_honeycomb.yaml
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("place"))
