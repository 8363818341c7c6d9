"""Robots as a command lists them, and one of one's own: its file from a published URDF, and a print to try it with."""
