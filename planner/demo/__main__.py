"""Show a print that ships planned.

python -m planner.demo
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("demo"))
