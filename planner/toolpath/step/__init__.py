"""Faces of STEP files."""
