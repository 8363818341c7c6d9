"""Drawings in DXF files."""
