"""What a plan tells, word by word: its metrics and columns, and the verifier's checks."""

from planner.measures.checks import CHECKS
from planner.measures.metrics import COLUMNS, METRICS, Measure

__all__ = ["CHECKS", "COLUMNS", "METRICS", "Measure"]
