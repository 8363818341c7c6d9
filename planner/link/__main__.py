"""A program to its controller, watched while it runs."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("link"))
