"""Plan the rest of a print on the surface that a scan has found."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("scan"))
