"""Slow solvers that check the fast ones; loaded only when asked for."""
