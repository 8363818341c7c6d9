"""Independent verification of a sampled trajectory: Pinocchio on q(t), the input geometry, and nothing else.

No code of the optimiser, of the planner's own kinematics or of the timing is used here; what the trajectory
says of itself (tip, axis, speed, flow) is compared with what its joints do.
"""
