"""Plays a program that was read back: poses and joints over time, and what it switches, says and waits for."""
