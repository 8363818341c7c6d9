"""A print that ships: planned, verified, written, and examined as arrays."""

import numpy as np

from planner import load, solve, write

plan = solve(load("peer_cap"))
print(plan.summary())
written = write(plan, "out/peer_cap")  # report.html, the robot's program, tables
print("verified" if written.verified else "not verified: no program was written")

laying = plan.deposit  # one value for each sample, as all arrays of a plan
print(f"{len(plan.t)} samples of {1e3 * plan.trajectory.dt:g} ms, {laying.mean():.0%} of them laying")
print(f"tip between {1e3 * plan.tip[laying].min(axis=0)} and {1e3 * plan.tip[laying].max(axis=0)} mm")
for name, joint in zip(plan.joint_names, plan.q.T, strict=True):
    print(f"{name}: {np.degrees(joint.min()):7.1f} to {np.degrees(joint.max()):7.1f} deg")
