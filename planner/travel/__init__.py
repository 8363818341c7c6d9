"""Travel between beads, from state to state: jerk-limited, clear of the part, as quick as can be."""

from planner.travel.plan import Travel, ViaHome, plan_travels

__all__ = ["Travel", "ViaHome", "plan_travels"]
