"""Your own cost term: joint 5 keeps away from 0, where the wrist is singular, if that costs little time."""

from dataclasses import dataclass

import numpy as np

from planner import PathSamples, SamplePrice, check_term, load, random_samples, solve


@dataclass(frozen=True)
class KeepAway:
    joint: str
    room: float  # rad
    cost: float  # s/s at 0
    name = "keep_away"

    def price(self, path: PathSamples) -> SamplePrice:
        j = path.joints.index(self.joint)
        near = np.maximum(0.0, 1.0 - np.abs(path.q[:, j]) / self.room)
        by_q, curve = np.zeros(path.q.shape), np.zeros(path.q.shape)
        by_q[:, j] = -2.0 * self.cost * near * np.sign(path.q[:, j]) / self.room
        curve[:, j] = 2.0 * self.cost / self.room**2 * (near > 0.0)
        return SamplePrice(self.cost * near**2, by_q=by_q, curve_q=curve)


term = KeepAway("joint_5", room=2.0, cost=2.0)
check_term(term, random_samples(["joint_4", "joint_5"]))  # its derivatives, against differences

problem = load("peer_cap", {"process.cones": {"nozzle_normal_deg": 10}, "resolve.weights": {"effort": 0.5}})
for terms in ([], [term]):
    plan = solve(problem, terms=terms, baseline=False)
    bend = np.degrees(np.abs(plan.q[plan.deposit, plan.joint_names.index("joint_5")]).mean())
    print(f"{len(terms)} terms: joint 5 at {bend:.0f} deg on average, {plan.metrics['at_speed_fraction']:.1%} at speed")
