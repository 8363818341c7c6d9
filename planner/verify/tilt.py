"""What a nozzle that leans within its cone does to the bead, from what its joints really do.

The end face of a nozzle is a plane square to its axis, through the tip, and what it irons is the bead's top. Leaning
by an angle a from the surface normal, a point of the face at a distance r from the tip, up or down the slope, stands
r sin(a) off the height of the tip. The face shapes a bead of width w as far as r = w/2 to each side: leaning across
the bead it leaves one edge (w/2) sin(a) too high and the other as much too low; leaning along it, the rim that comes
last leaves the bead that much too high or too low. The tip itself is the middle of the bore and stays on its line, so
that no height is added to this by the lean, whichever way it is.
"""

from __future__ import annotations

import numpy as np

from planner.plan import Trajectory
from planner.readonly import Array
from planner.toolpath.bead import Toolpath
from planner.verify.checks import samples_of


def bead_errors(toolpath: Toolpath, t: Trajectory, lean: Array) -> Array:
    """By how much (n) a bead's edges are off its height [m] where the nozzle leans from the normal by lean (n) [rad]."""
    width = np.zeros(len(t))
    for at, bead in zip(samples_of(t, len(toolpath.beads)), toolpath.beads, strict=True):
        width[at] = np.interp(t.s[at], bead.s, bead.width)
    return np.asarray(0.5 * width * np.sin(lean))
