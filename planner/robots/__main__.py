"""The robots that ship, or one of them or of the user's own in detail."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("robots"))
