"""Names in RAPID: how long they may be, and those that a problem must not use because they are already taken."""

from __future__ import annotations

import re

LONGEST_NAME = 32  # characters of an identifier
ARMS = ("ROB_1", "ROB_2")  # mechanical units of a MultiMove system
# ABB, RAPID kernel reference, reserved words
_RESERVED = """
alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc
endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod module nostepin not
noview or pers proc raise readonly record retry return step sysmodule test then to trap true trynext undo var
viewonly while with xor
"""
RAPID_WORDS = frozenset(_RESERVED.split())
# names that our programs define (procedures, speeds, triggers, zones, the socket server's), and ABB's own data
OWN_NAMES = re.compile(
    r"(main|(start|finish|(home|change|bead)\d+)(part\d+)?|vel\d\w*|(trg|bw)\w*|zon0_(1|02)|(tool|wobj|load)0|fine|[vz]\d+)",
    re.IGNORECASE,
)
