"""Toolpaths that a slicer made for a level bed."""
