"""Plots of plans, for notebooks and papers: each takes matplotlib's axes, draws, and returns them."""

from planner.plots.along import joint_ranges, path_derivatives, speed, speed_ceilings
from planner.plots.compare import compare
from planner.plots.redundancy import redundancy_map
from planner.plots.space import toolpath

__all__ = ["compare", "joint_ranges", "path_derivatives", "redundancy_map", "speed", "speed_ceilings", "toolpath"]
