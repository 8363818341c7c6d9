"""Names, numbers and comments as KRL takes them."""

from __future__ import annotations

import re

import numpy as np

from planner.export.krl.axes import angles
from planner.export.rapid.text import module_name, number
from planner.readonly import Array

LONGEST_NAME = 24
LONGEST_COMMENT = 100
MM, DEGREES = 3, 4  # decimals of targets; frames have
FRAME_DEGREES = 6
# KUKA, reserved words of KRL that a name in CamelCase could be
RESERVED = """BRAKE CASE CAST_FROM CAST_TO CHANNEL CIRC CONFIRM CONST CONTINUE DECL DEF DEFAULT DEFDAT DEFFCT DELAY DISABLE
    ELSE ENABLE END ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSWITCH ENDWHILE ENUM EXIT EXT EXTFCT FALSE FOR FRAME GLOBAL
    GOTO HALT IF IMPORT INTERRUPT IS LIN LOOP MAXIMUM MINIMUM NOT OFF ON OR POS PRIO PTP PUBLIC PULSE REAL REPEAT RESUME
    RETURN SEC SIGNAL SPLINE STRUC SWITCH THEN TO TOOL BASE TRIGGER TRUE UNTIL WAIT WHEN WHILE FINISH FPART FTOOL"""


def krl_name(name: str) -> str:
    """CamelCase name, at most 24 letters and digits, of a problem's name; small letters and capitals are one to KRL."""
    joined = module_name(name, LONGEST_NAME)
    return "Print" + joined if joined.upper() in RESERVED.split() else joined


def comment(text: str, indent: int = 2) -> str:
    """One comment line, ASCII, of bounded length."""
    text = re.sub(r"[^\x20-\x7e]", "?", text)
    return f"{'':{indent}}; {text[:LONGEST_COMMENT].rstrip()}"


def frame(T: Array) -> str:
    """Components of a FRAME (mm, degrees) of a pose (4, 4)."""
    values = [*(T[:3, 3] * 1e3), *np.degrees(angles(T[None, :3, :3])[0])]
    decimals = [MM] * 3 + [FRAME_DEGREES] * 3
    return ",".join(f"{name} {number(v, d)}" for name, v, d in zip("XYZABC", values, decimals, strict=True))


def axes(degrees: Array, external: Array) -> str:
    """Components of an E6AXIS of one posture: A1 to A6 (6) and the external axes (k), all in degrees."""
    named = [(f"A{i}", v) for i, v in enumerate(degrees, 1)] + [(f"E{i}", v) for i, v in enumerate(external, 1)]
    return ",".join(f"{name} {number(v, DEGREES)}" for name, v in named)
