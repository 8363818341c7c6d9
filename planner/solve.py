"""Plan a print: from its problem file to a verified robot program.

python -m planner.solve cylinder_logo.yaml
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("solve"))
