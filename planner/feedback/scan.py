"""Lay the rest of a print on what a scan finds of it."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("scan"))
