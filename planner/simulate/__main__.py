"""Simulate the hardware of a print."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("simulate"))
