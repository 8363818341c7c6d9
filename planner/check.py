"""Read a problem and all files that it names, without planning it."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("check"))
