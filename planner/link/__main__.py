"""Send a program to its controller, and monitor it while it runs."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("link"))
