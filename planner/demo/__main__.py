"""Show a print that ships planned."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("demo"))
