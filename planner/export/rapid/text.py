"""Words and numbers as RAPID takes them."""

from __future__ import annotations

import re

# ABB, RAPID kernel reference, reserved words; and the names of our own procedures
RESERVED = """ALIAS AND BACKWARD CASE CONNECT CONST DEFAULT DIV DO ELSE ELSEIF ENDFOR ENDFUNC ENDIF ENDMODULE ENDPROC ENDRECORD
    ENDTEST ENDTRAP ENDWHILE ERROR EXIT FALSE FOR FROM FUNC GOTO IF INOUT LOCAL MOD MODULE NOSTEPIN NOT NOVIEW OR PERS
    PROC RAISE READONLY RECORD RETRY RETURN STEP SYSMODULE TASK TEST THEN TO TRAP TRUE TRYNEXT UNDO VAR VIEWONLY WHILE
    WITH XOR BASE USER MAIN START FINISH"""
# ABB, RAPID reference: types, instructions and functions that a problem could be named after, and a module must not be
PREDEFINED = """ABS ACOS ADD ASIN ATAN BOOL BREAK BYTE CLEAR CLOCK CLOSE COS DECR DIM DISTANCE DNUM EXP INCR LOAD NUM OFFS OPEN
    ORIENT POS POSE POW PRESENT RESET REWIND ROUND SAVE SET SIN SQRT STOP STRING SWITCH TAN TRUNC UNLOAD WRITE"""
# ABB, RAPID reference, zonedata: radius of the zone of the tool's path [m]
ZONES = {"fine": 0.0, "z0": 0.3e-3, "z1": 1e-3}
LONGEST_STRING = 80
LONGEST_NAME = 32
LONGEST_COMMENT = 100
NOTE = "Note: "  # begins a comment in the header that users should read
_NOTE = re.compile(rf" {{4}}! {NOTE}(.*)\n {{4}}!   (first .*)\n")


def module_name(name: str, longest: int = LONGEST_NAME) -> str:
    """CamelCase module name, at most `longest` letters and digits, of a problem's name."""
    words = re.findall(r"[A-Za-z0-9]+", name)
    joined = "".join(word[0].upper() + word[1:] for word in words)
    # capitals and small letters are one to RAPID: a problem named "test" would open a TEST statement
    taken = joined.upper() in f"{RESERVED} {PREDEFINED}".split() or re.fullmatch(r"(?i)(bead|vel|trg|bw)\w*", joined)
    whole = "Print" + joined if taken or not joined[:1].isalpha() else joined
    resumed = re.search(r"From\d+$", whole)  # which tells programs of one problem apart
    tail = resumed[0] if resumed else ""
    return whole[: longest - len(tail)] + tail if len(whole) > longest else whole


def number(value: float, decimals: int) -> str:
    """Fixed-point number as RAPID reads it; never minus nought."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def comment(text: str, indent: int = 4) -> str:
    """One comment line, ASCII, of bounded length."""
    text = re.sub(r"[^\x20-\x7e]", "?", text)
    return f"{'':{indent}}! {text[:LONGEST_COMMENT].rstrip()}"


def written_notes(text: str) -> tuple[str, ...]:
    """The notes in the header of a main module, in words."""
    return tuple(f"{words}; {where}" for words, where in _NOTE.findall(text))
