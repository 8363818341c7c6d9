"""A test program that shows a robot's limits, and the limits read off its recording."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("identify"))
