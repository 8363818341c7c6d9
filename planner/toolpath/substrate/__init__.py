"""Plane curves projected onto a body."""
