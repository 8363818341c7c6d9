"""Read a problem and all that it names, without planning it.

python -m planner.check cylinder_logo.yaml
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("check"))
