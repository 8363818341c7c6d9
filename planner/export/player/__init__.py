"""Plays a program that was read back: poses and joints over time, and what it switches, says and waits for."""

from planner.export.player.play import play
from planner.export.player.played import Happening, Moment, Played

__all__ = ["Happening", "Moment", "Played", "play"]
