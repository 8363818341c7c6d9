"""Stream a plan's moves to a controller while it runs them."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("stream"))
