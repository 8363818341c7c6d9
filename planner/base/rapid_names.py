"""Names in RAPID that a problem may give, and those that it may not, since programs give them themselves."""

from __future__ import annotations

import re

LONGEST_NAME = 32  # characters of an identifier
# procedures, speeds, triggers, the zone, what serves the socket; and ABB's own data
OWN_NAMES = re.compile(
    r"(main|(start|finish|(home|change|bead)\d+)(part\d+)?|vel\d\w*|(trg|bw)\w*|zon0_1|(tool|wobj|load)0|fine|[vz]\d+)",
    re.IGNORECASE,
)
