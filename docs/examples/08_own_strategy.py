"""Your own strategy: the constant roll that keeps the joints slowest, alongside the planner's."""

import numpy as np

from planner import joint_paths, load, register_strategy, solve
from planner.base.errors import Refusal


def calm_roll(cell, tasks, settings, obstacles):
    """Of twelve constant rolls the one whose fastest joint uses least of its speed."""
    best, least, reason = None, np.inf, None
    for roll in np.radians(range(0, 360, 30)):
        try:
            paths = joint_paths(cell, tasks, [roll] * len(tasks))
        except Refusal as refusal:
            reason = refusal
            continue
        pace = [np.gradient(path.q, path.task.s / path.task.speed, axis=0) / cell.limits.velocity for path in paths]
        most = max(float(np.abs(each).max()) for each in pace)
        if most < least:
            best, least = paths, most
    if best is None:
        raise reason
    return best


register_strategy("calm_roll", calm_roll)
for strategy in ("calm_roll", "ladder", "sqp"):
    plan = solve(load("peer_cap"), strategy=strategy, baseline=False)
    found = plan.metrics
    used = found["velocity_ratio_max"]
    print(
        f"{strategy:10} verified {plan.verified!s:5}  at speed {found['at_speed_fraction']:.1%}  joints' speed {used:.0%}"
    )
