"""Obstacles: bodies of robots, tools and fixtures, part and print, and how close a posture brings them."""
