"""Beads that cover faces."""
