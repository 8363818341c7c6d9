"""Simulators of what a print runs on."""

from planner.base.launch import end, launch

if __name__ == "__main__":
    end(launch("simulate"))
