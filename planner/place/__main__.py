"""Where to place the part: a map, and the best places, solved and verified."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("place"))
