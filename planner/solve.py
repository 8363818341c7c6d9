"""Plan a print: from its problem file to a verified robot program."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("solve"))
