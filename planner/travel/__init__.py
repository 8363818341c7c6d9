"""Travel between beads, from state to state: jerk-limited, clear of the part, as quick as can be."""

from planner.travel.plan import plan_travels

__all__ = ["plan_travels"]
