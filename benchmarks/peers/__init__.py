"""Installable planners on the same toolpaths, arms and limits, each in a process of its own, all judged alike."""
