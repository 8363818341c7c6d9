"""Send a plan's joint references to a controller by externally guided motion."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("egm"))
