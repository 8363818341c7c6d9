"""Toolpaths that a file gives point by point."""
