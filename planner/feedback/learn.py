"""Correct a program by what the robot did in its last run."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("learn"))
