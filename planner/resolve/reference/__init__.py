"""Slow solvers that check the fast ones; imported only on demand."""
