"""All prices behind the choice of joint paths, and where each begins.

Prices are in seconds, so that what a choice costs can be weighed against the time that it saves: "s/s" is seconds per
second of printing at the commanded speed. Each line has the value, its unit, and the reason.

These numbers are compiled into kernels: after a change here, those are compiled again (see `base/compiled.py`).
"""

from __future__ import annotations

import numpy as np

# Closeness, priced alike for nodes and refined samples: motion between them needs some room.
SIGMA_COMFORT = 0.20  # least singular value (linear rows in m/rad) below which closeness to a singularity is priced
SIGMA_PRICE = 0.6  # s/s at half of SIGMA_COMFORT, squared: near a singularity joints turn fast and errors grow
LIMIT_COMFORT = 0.35  # rad from the end of a joint's range, below which closeness is priced
LIMIT_PRICE = 0.4  # s/s at the end itself, squared: from there a joint can turn only one way

# Lost time. A slack is the share of its time that a sample loses; the lost time itself is priced as it is.
DIP_PRICE = 0.25  # s/s below the commanded speed: one deep dip beats two shallow ones
AT_SPEED = 0.96  # of a node: squared share of the commanded speed above which there is no dip
DIP = 0.05  # of a refined sample: slack at which half of DIP_PRICE is counted, so that the price has a slope

# The ladder's nodes and edges.
LEAN_PRICE = 10.0  # s/s per unit of cosine beyond the cones to gravity: more than any detour, but not forbidden
TRAVEL_PRICE = 0.06  # s per second of travel between beads: a dip spoils the bead, travel only takes time
HOME_PRICE = 0.1  # s per second of the ways from and to home: only the beads that begin and end there pay them
TURN_PRICE = 1.0  # s/s for a change of roll or holder that needs a joint's whole speed, squared: print calmly
FAR = 1.0  # rad that a joint may turn from rung to rung without an extra price: more is close to a singular posture
FAR_PRICE = 10.0  # s/rad beyond FAR: such a way only where nothing else leads on

# The refinement (see `price_kernels`, which adds these up).
EFFORT = np.array([0.6, 0.02, 0.02])  # s/s for all joints at their speed, acceleration, jerk limits: prefer calm paths
PEAK = 0.78  # rad/s: joints that stay below at the commanded speed are calm enough
PEAK_PRICE = 0.02  # s/s for all joints at the speed that counts as a peak: little, only where no time is lost
HARD_PRICE = 1e3  # s/s per unit (rad, or share of a bound) beyond a bound: more than all else
CLEARANCE_UNIT = 10.0  # units per metre: 0.1 mm of missing clearance counts as much as a milliradian beyond a cone
# Tilt has to buy something, clearance or speed, since a nozzle that leans by t lifts one side of a bead by half its
# width times t; at 10 degrees it costs 0.6 per mille of the time.
TILT_PRICE = 0.02  # s/s per rad^2
ANCHOR = 0.1  # s/rad^2 that an end of a bead moves: what the search chose there keeps travel short

# The table that is found before the arm (see `table_path`).
TABLE_LEAN_PRICE = 5.0  # s/s for lean beyond the calm share of the cone, in shares of it, squared: stay off its edge
TABLE_BEYOND_PRICE = 1e4  # s/s per rad beyond the cone: more than any way that stays within it
TABLE_MOVE_PRICE = 0.3  # s/s for an axis at its full speed, squared: of two tables the calmer one wins
NO_POSTURE_PRICE = 1e3  # s/s where the arm has no posture: such a path is refused, but the place can be named
BRANCH_PRICE = 0.06  # s for another branch between beads: as much as a second of travel
PAUSE_PRICE = 1e6  # s for leaving a bead and coming back: more than any other loss, so pauses are as few as possible

# Whole turns of joints, chosen last.
WOUND = 1e-3  # s per second from home to where a joint is: for equal travel, cables are not wound up needlessly
