"""Write a test program that shows a robot's limits, and read the limits off its recording."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("identify"))
