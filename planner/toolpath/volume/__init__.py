"""Closed meshes filled with curved layers."""
