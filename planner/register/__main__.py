"""Where the part really is, from places that the nozzle touched."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("register"))
