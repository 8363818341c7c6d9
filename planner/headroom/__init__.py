"""Head-room: whether a plan holds where the part stands a little elsewhere than planned."""

from planner.headroom.trial import headroom

__all__ = ["headroom"]
