"""List the shipped robots, or describe one, shipped or the user's own, in full."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("robots"))
