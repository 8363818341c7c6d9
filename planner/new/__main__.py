"""A new problem file, from a few questions or from a problem that ships."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("new"))
