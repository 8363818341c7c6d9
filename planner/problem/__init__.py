"""The problem: cell, part, layers, process and strategy, from one YAML file into frozen SI values."""

from planner.problem.problem import Problem, load_problem
from planner.problem.yaml_file import find_problem, shipped_problems

__all__ = ["Problem", "find_problem", "load_problem", "shipped_problems"]
