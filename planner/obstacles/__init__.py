"""What is in the way: bodies of robots, tools and fixtures, part and print, and how near a posture brings them."""

from planner.obstacles.scene import NOTHING, Obstacles, obstacles_of

__all__ = ["NOTHING", "Obstacles", "obstacles_of"]
