"""An independent count of the beads in a slicer's file: for `benchmarks.slicers`, with its own code.

It shares nothing with the planner's reader: no module, no table, no method. Arcs are measured by their angle, not along
chords.
"""

from __future__ import annotations

import math
import re
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_WORD = re.compile(r"([A-Z]) ?([-+]?[0-9]*\.?[0-9]+)")
_BEGINS = ("LAYER_CHANGE", "CHANGE_LAYER", "BEFORE_LAYER_CHANGE", "AFTER_LAYER_CHANGE", "BEGIN_LAYER_", "; --- layer ")
_OVER = ("layer end", "End of Gcode", "EXECUTABLE_BLOCK_END", "MACHINE_END_GCODE_START", "*** G-code Postfix")
_BESIDE = {"iron": "ironing", "prime": "purge", "wipe": "purge", "purge": "purge", "ooze": "purge"}
_SAID = (  # mm of filament, of all tools, as slicers say them
    (r"; total filament length \[mm\] : ([\d., ]+)$", 1.0),
    (r"; filament used \[mm\] = ([\d., ]+)$", 1.0),
    (r"; filament used = ([\d.]+)mm", 1.0),
    (r";Filament used: ([\d.]+m(?:, ?[\d.]+m)*)", 1e3),
    (r";   Filament length: ([\d.]+) mm", 1.0),
    (r";Material#\d+ Used: ([\d.]+)$", 1.0),
)
_PLAIN = {
    *("perimeter", "infill", "skirt", "brim", "support material", "support material interface", "bridge", "gap fill"),
    *("inner perimeter", "outer perimeter", "solid layer", "support", "dense support", "raft", "prime pillar"),
    "ooze shield",
}


@dataclass(frozen=True)
class Count:
    """Lengths [mm] by what they belong to (part, skirt, brim, support, purge), and how many heights there are."""

    lengths: dict[str, float]
    layers: int


def _is_layer(remark: str) -> bool:
    word = remark.upper()
    if word.startswith("LAYER:"):
        return word[6:].strip().lstrip("-").replace(".", "", 1).isdigit()
    return remark.startswith(_BEGINS) or bool(re.match(r"layer [0-9]+, Z|move to next layer \([0-9]+\)$", remark))


def _belongs(kind: str) -> str | None:
    """The part or something beside it; None for what is the printer's own."""
    if kind == "custom":
        return None
    for word, name in (*_BESIDE.items(), ("skirt", "skirt"), ("brim", "brim"), ("support", "support")):
        if word in kind:
            return name
    return "part"


def _events(lines: list[str]) -> Iterator[tuple[str, str]]:
    """Remarks and code, in the order in which they count."""
    for line in lines:
        code, _, remark = line.partition(";")
        if remark:
            yield "remark", remark.strip()
        if code.strip():
            yield "code", code.strip().upper()


def _kind(remark: str) -> str | None:
    for head in ("TYPE:", "FEATURE:", "feature "):
        if remark.startswith(head):
            return remark.removeprefix(head).strip().lower()
    if remark.startswith("'") and remark.count("'") > 1:
        name = remark.split("'")[1].lower().removesuffix(" path")
        return None if name.startswith(("destring", "travel")) else name
    return remark if remark in _PLAIN else None


def _sweep(
    x: float, y: float, to_x: float, to_y: float, words: dict[str, float], clockwise: bool, unit: float
) -> float:
    """Length of an arc."""
    if "R" in words:
        chord, radius = math.hypot(to_x - x, to_y - y), abs(words["R"]) * unit
        half = math.asin(min(chord / (2.0 * radius), 1.0))
        return radius * 2.0 * (half if words["R"] > 0 else math.pi - half)
    i, j = words.get("I", 0.0) * unit, words.get("J", 0.0) * unit
    radius = math.hypot(i, j)
    turn = math.atan2(to_y - y - j, to_x - x - i) - math.atan2(-j, -i)
    turn = -turn if clockwise else turn
    turn %= 2.0 * math.pi
    return radius * (turn if turn > 1e-9 and (to_x, to_y) != (x, y) else 2.0 * math.pi)


def _text(path: Path) -> str:
    """The text of a file, or of the plate in a packed one."""
    data = path.read_bytes()
    if data[:2] == b"PK":
        with zipfile.ZipFile(path) as packed:
            data = packed.read(next(name for name in packed.namelist() if name.endswith(".gcode")))
    return data.decode("latin-1")


def said(path: Path) -> float | None:
    """The length [mm] of filament that a file says to need, start and end code with it mostly; None where it says none."""
    text = _text(path)
    for pattern, unit in _SAID:
        found = re.findall(f"^{pattern}", text, re.MULTILINE)
        if found:
            found = found if "#" in pattern else found[:1]  # others say it once for all tools, and some say it twice
            return unit * sum(float(number) for each in found for number in re.findall(r"\d+\.?\d*", each))
    return None


def count(path: Path) -> Count:
    """Count what a file lays from the first layer to the last."""
    events = list(_events(_text(path).splitlines()))
    has_layers = any(what == "remark" and _is_layer(text) for what, text in events)
    begin = 0
    if not has_layers:
        own = [k for k, (what, text) in enumerate(events) if what == "remark" and text == "set units to millimeters"]
        begin = own[-1] if own else 0
    relative_e = _counts_anew(events, begin)
    place = {"X": math.nan, "Y": math.nan, "Z": math.nan}
    unit, relative, total_e, kind, on = 1.0, False, 0.0, "", not has_layers
    stretch = 0
    lengths: dict[str, float] = defaultdict(float)
    heights: set[int] = set()
    for k, (what, text) in enumerate(events):
        if what == "remark":
            if _is_layer(text):
                on = True
            elif text.startswith(_OVER):
                on = False
            elif text.startswith(("CP TOOLCHANGE", "CP EMPTY", "CP PRIMING", "FLUSH_", "WIPE_TOWER_")):
                stretch += text.endswith("START") - text.endswith("END")
            else:
                kind = _kind(text) or kind
            continue
        name = re.match(r"(?:N\d+ *)?([GM])0*(\d+)(?![.\d])", text)
        if name is None:
            continue
        command, words = (
            name[1] + name[2],
            {letter: float(value) for letter, value in _WORD.findall(text[name.end() :])},
        )
        if command in ("G90", "G91"):
            relative = command == "G91"
        elif command in ("M82", "M83"):
            relative_e = command == "M83"
        elif command in ("G20", "G21"):
            unit = 25.4 if command == "G20" else 1.0
        elif command == "G92":
            for axis in "XYZ":
                place[axis] = unit * words.get(axis, place[axis] / unit)
            total_e = unit * words.get("E", total_e / unit)
        elif command in ("G0", "G1", "G2", "G3"):
            before = dict(place)
            for axis in "XYZ":
                if axis in words:
                    place[axis] = unit * words[axis] + (place[axis] if relative else 0.0)
            if "E" not in words:
                continue
            push = unit * words["E"] if relative_e else unit * words["E"] - total_e
            total_e += push
            owner = "purge" if stretch > 0 else _belongs(kind)
            if push <= 0.0 or not on or k < begin or owner is None:
                continue
            if command in ("G2", "G3"):
                way = _sweep(before["X"], before["Y"], place["X"], place["Y"], words, command == "G2", unit)
            else:
                way = math.hypot(place["X"] - before["X"], place["Y"] - before["Y"])
            if way > 0.0:
                lengths[owner] += math.hypot(way, place["Z"] - before["Z"])
                heights.add(round(place["Z"] * 200.0))
    return Count(dict(lengths), len(heights))


def _counts_anew(events: list[tuple[str, str]], begin: int) -> bool:
    """Whether E counts from the move before, where no command says it: then its numbers do not grow."""
    if any(what == "code" and re.match(r"M8[23]\b", text) for what, text in events):
        return False
    up = down = 0
    last = math.inf
    for what, text in events[begin:]:
        if what != "code":
            continue
        if text.startswith("G92"):
            last = math.inf
        elif text.startswith("G1") and "X" in text and (found := re.search(r"E([-+]?[0-9]*\.?[0-9]+)", text)):
            value = float(found[1])
            up += last < value
            down += value < last < math.inf
            last = value
    return 2 * down > up
