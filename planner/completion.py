"""Print a script with which a shell completes the commands of beadwise.

python -m planner.completion bash
"""

from __future__ import annotations

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("completion"))
