"""A robot from its URDF: the file is generated once, then it is yours to change."""

from planner import add_robot, load, solve
from planner.base.shipped import ROBOTS

# Yours would be "my_arm.urdf", or a model: add_robot(pinocchio.buildModelFromUrdf(...), "my_arm.yaml").
robot = add_robot(ROBOTS / "irb140.urdf", "my_arm.yaml", language="rapid")
print(robot.read_text())

# What the URDF does not say was assumed: set your own limits in the file, or for one problem.
slower = {"cell.limits": {"joint_6": {"jerk_rad_s3": 500}}}
plan = solve(load("cylinder_logo", {"cell.arm": robot, "layers.count": 1}, slower), strategy="ladder", baseline=False)
print(plan.cell.arm_robot.name, plan)
