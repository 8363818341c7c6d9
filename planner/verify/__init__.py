"""Verification of a sampled trajectory: its joint motion, by Pinocchio, against limits and input geometry.

None of the code under test is used here: redundancy resolution, the planner's kinematics, timing, travel. What the
trajectory records of itself (tip, axis, speed, flow) is compared with what its joints do.

Shared with the planner are the problem, the cell with its solids, the toolpath with its surfaces, part and print as
obstacles with the tree of their points and its distance kernels, and the routines for the smallest singular value and
for distances from polylines. An error in any of these can deceive both, so each has its own tests against closed forms
or other libraries.
"""
