"""Kinematics of arms: forward and inverse, in closed form where there is one, compiled."""
