"""References that are made from the code."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("reference"))
