"""Toolpaths that a file says point by point."""
