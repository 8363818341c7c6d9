"""Where the part really is, from places that the nozzle touched.

python -m planner.register contacts.csv fibre_bowl
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("register"))
