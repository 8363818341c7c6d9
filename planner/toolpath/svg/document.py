"""Reads an SVG file into a tree of elements with expat: each keeps its line, and nothing else is ever opened."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from planner.errors import InputError, nearest_name

MAX_BYTES = 20_000_000
MAX_ELEMENTS = 100_000  # in the file, and again once every <use> is followed
MAX_DEPTH = 100
MAX_POINTS = 1_000_000
MAX_COORDINATE = 1e7  # user units

SVG, XLINK_HREF = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink href"
SHAPES = {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon"}
GROUPS = {"svg", "g", "a", "use"}
NOT_DRAWN = {"defs", "symbol", "clipPath", "mask", "marker", "pattern", "filter", "linearGradient", "radialGradient"}
NOT_DRAWN |= {
    "stop",
    "style",
    "title",
    "desc",
    "metadata",
    "view",
    "cursor",
    "solidcolor",
    "font",
    "font-face",
    "glyph",
}
REFUSED = {
    "image": "only outlines can be printed; trace the image",
    "foreignObject": "only outlines can be printed",
    "script": "scripts are never run",
    "switch": "keep one of its alternatives",
    **dict.fromkeys(("text", "tspan", "textPath"), "turn text into paths in the drawing program"),
    **dict.fromkeys(("animate", "animateMotion", "animateTransform", "set"), "save the drawing without animation"),
}

# Possessive quantifiers: without them a long run of digits could be split in exponentially many ways.
SPACE = r"[ \t\r\n]*+"
COMMA = rf"{SPACE},?+{SPACE}"
NUMBER = r"[+-]?+(?>[0-9]++\.?+[0-9]*+|\.[0-9]++)(?>[eE][+-]?+[0-9]++)?+"
LENGTH = re.compile(rf"{SPACE}({NUMBER}){SPACE}([a-zA-Z]*|%){SPACE}")
UNITS = {"": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6, "pt": 96 / 72, "pc": 16.0}
URL = re.compile(r"url\(\s*[\"']?\s*([^\s\"')]*)", re.IGNORECASE)
DOCTYPE = re.compile(rb"<!DOCTYPE[^<>\[\]]*>")


@dataclass(frozen=True)
class Node:
    """An element of the drawing and its place in the file; `number` counts the elements of its kind from 1."""

    file: Path
    tag: str
    attributes: dict[str, str]
    line: int
    number: int
    children: list[Node] = field(default_factory=list)
    text: list[str] = field(default_factory=list)

    @property
    def id(self) -> str | None:
        """The element's id, if it has one."""
        return self.attributes.get("id")

    def error(self, reason: str, hint: str | None = None) -> InputError:
        """Return the error that names this element and its line."""
        label = f"{self.tag} '{self.id}'" if self.id else f"{self.tag} {self.number}"
        return InputError(reason, file=self.file, line=self.line, field=label, hint=hint)

    def length(self, name: str) -> float | None:
        """Return a length in user units (96 to the inch), None if it is not given."""
        text = self.attributes.get(name, "auto").strip()
        if text == "auto":
            return None
        match = LENGTH.fullmatch(text)
        if match is None:
            raise self.error(f"{name} is not a length: {text[:40]!r}")
        if match[2].lower() not in UNITS:
            raise self.error(
                f"{name} has a unit that is not supported: {text[:40]!r}", "px, in, cm, mm, Q, pt, pc or none"
            )
        value = float(match[1]) * UNITS[match[2].lower()]
        if abs(value) > MAX_COORDINATE:
            raise self.error(f"{name} is beyond {MAX_COORDINATE:g} user units: {text[:40]!r}")
        if value < 0 and name in ("width", "height", "r", "rx", "ry"):
            raise self.error(f"{name} must not be negative: {text[:40]!r}")
        return value


def read_document(path: Path, complain: Callable[..., InputError]) -> Node:
    """Read the file into a tree of SVG elements, which is returned by its root; nothing else is ever opened.

    Raises InputError for what is unsafe, too large or malformed, and for elements that can never be printed.
    """
    try:
        if not path.is_file():
            raise complain(f"there is no file {path}")
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise complain(f"cannot read {path}: {error.strerror}") from error
    if len(data) > MAX_BYTES:
        raise complain(f"{path.name} is larger than {MAX_BYTES // 10**6} MB")
    if data.startswith(b"\x1f\x8b"):
        raise complain(f"{path.name} is compressed", hint="save it as plain SVG")
    # expat drops unknown entities in silence where an external DTD is named, so a DOCTYPE of a name only goes first.
    data = DOCTYPE.sub(lambda match: re.sub(rb"[^\n]", b" ", match[0]), data, count=1)

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    open_nodes: list[Node | None] = []  # None: foreign to SVG, and so is everything in it
    roots: list[Node] = []
    spaces: list[str] = []  # the root's own namespace: a drawing without any is still understood
    numbers = Counter[str]()

    def refuse(reason: str, hint: str | None = None) -> InputError:
        return InputError(reason, file=path, line=parser.CurrentLineNumber, hint=hint)

    def start(name: str, attributes: dict[str, str]) -> None:
        space, _, tag = name.rpartition(" ")
        parent = open_nodes[-1] if open_nodes else None
        if not roots:
            if tag != "svg" or space not in ("", SVG):
                raise refuse(f"the root element is <{tag}>, not <svg>")
            spaces.append(space)
        elif space != spaces[0] or parent is None or parent.tag == "metadata":
            open_nodes.append(None)
            return
        numbers[tag] += 1
        node = Node(path, tag, attributes, parser.CurrentLineNumber, numbers[tag])
        _check_element(node)
        if numbers.total() > MAX_ELEMENTS or len(open_nodes) >= MAX_DEPTH:
            raise refuse(f"more than {MAX_ELEMENTS} elements, or more than {MAX_DEPTH} inside each other")
        (roots if parent is None else parent.children).append(node)
        open_nodes.append(node)

    def end(_: str) -> None:
        open_nodes.pop()

    def text(content: str) -> None:
        if open_nodes and (node := open_nodes[-1]) is not None and node.tag == "style":
            node.text.append(content)

    def doctype(_: str, system: str | None, __: str | None, subset: int) -> None:
        if system or subset:
            raise refuse("a DOCTYPE with declarations of its own is not read", "save the drawing as plain SVG")

    def instruction(target: str, _: str) -> None:
        if target == "xml-stylesheet":
            raise refuse("an external style sheet is never opened")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    parser.StartDoctypeDeclHandler, parser.ProcessingInstructionHandler = doctype, instruction
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"not well-formed XML at column {error.offset + 1}: {expat.ErrorString(error.code)}"
        raise InputError(reason, file=path, line=error.lineno) from error
    except (LookupError, ValueError) as error:
        raise InputError(f"the text encoding cannot be read: {error}", file=path, line=1) from error
    return roots[0]


def _check_element(node: Node) -> None:
    """Refuse an element that can never be printed, and a reference to anything outside of the file."""
    if node.tag in REFUSED:
        raise node.error(f"<{node.tag}> cannot be printed", REFUSED[node.tag])
    known = SHAPES | GROUPS | NOT_DRAWN
    if node.tag not in known and not re.fullmatch(r"fe[A-Z]\w+", node.tag):
        near = nearest_name(node.tag, known)
        raise node.error(f"<{node.tag}> is not an element that can be printed", near and f"did you mean <{near}>?")
    for name, value in node.attributes.items():
        if name in ("href", XLINK_HREF, "src"):
            check_reference(node, value)
        for target in URL.findall(value):
            check_reference(node, target)


def check_reference(node: Node, target: str) -> None:
    """Refuse a reference to anything outside of the file."""
    if not target.strip().startswith("#"):
        raise node.error(f"a reference to outside of the file is never followed: {target[:60]!r}", "only '#id'")
