"""Print a script with which a shell completes the commands of beadwise."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("completion"))
