"""The Plan: everything known when planning ends. Export and report see only this."""

from planner.plan.plan import (
    RAPID_EXTERNAL_AXES,
    Advice,
    Approach,
    CellView,
    Check,
    Dip,
    Nearer,
    Plan,
    Remedy,
    resumed_name,
)
from planner.plan.trajectory import TRAVEL, Event, Trajectory

__all__ = ["RAPID_EXTERNAL_AXES", "TRAVEL", "Advice", "Approach", "CellView", "Check", "Dip", "Event", "Nearer", "Plan", "Remedy",
           "Trajectory", "resumed_name"]  # fmt: skip
