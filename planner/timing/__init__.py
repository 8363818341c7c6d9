"""Timing of a bead: the commanded speed wherever joint speed, acceleration and jerk allow it, and minimal dips."""

from planner.timing.profile import HEADROOM
from planner.timing.reachability import bound_time
from planner.timing.timed_path import TimedPath, time_path

__all__ = ["HEADROOM", "TimedPath", "bound_time", "time_path"]
