"""Travel between beads, from state to state: jerk-limited, clear of the part, as quick as can be."""

from planner.travel.carried import carried_travels
from planner.travel.plan import Travel, ViaHome, plan_travels

__all__ = ["Travel", "ViaHome", "carried_travels", "plan_travels"]
