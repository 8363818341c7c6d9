"""Kinematics of arms, compiled: forward and inverse, in closed form if there is one."""
