"""An SVG file as a tree of elements with their lines, their styles and their transforms.

Expat reads the file, and nothing else is ever opened. Only CSS that matters for an outline is understood: simple
selectors that say what is shown. Anything that would reshape an outline is refused. Transforms and viewports are 3 x 3
matrices.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from planner.base.arrays import Array
from planner.base.budgets import DRAWING_POINTS, SVG_BYTES, SVG_DEPTH, SVG_ELEMENTS
from planner.base.errors import Complaint, InputError, nearest_name
from planner.base.files import read_bytes

MAX_BYTES, MAX_ELEMENTS, MAX_DEPTH, MAX_POINTS = (
    limit.most for limit in (SVG_BYTES, SVG_ELEMENTS, SVG_DEPTH, DRAWING_POINTS)
)
MAX_COORDINATE = 1e7  # user units
SVG, XLINK_HREF = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink href"
SHAPES = {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon"}
GROUPS = {"svg", "g", "a", "use"}
NOT_DRAWN = {"defs", "symbol", "clipPath", "mask", "marker", "pattern", "filter", "linearGradient", "radialGradient"}
TEXTS = ("text", "tspan", "textPath", "flowRoot", "flowRegion", "flowPara", "flowSpan", "flowDiv")
REFUSED = {  # where they are drawn
    "image": "only outlines can be printed; trace the image",
    "foreignObject": "only outlines can be printed",
    "switch": "keep one of its alternatives",
    **dict.fromkeys(TEXTS, "turn text into paths in the drawing program"),
}
NEVER = {  # not even where they are hidden
    "script": "scripts are never run",
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

# Properties that would move an outline and are not supported in a style.
SHAPING = {"transform", "transform-origin", "translate", "rotate", "scale", "zoom", "offset-path"}
CUTS = ("clip-path", "mask")
SHOWN = ("display", "visibility")
# Inherited, and relevant only where something is cut: a cut filled shape leaves a different outline than a cut line.
PAINT = ("fill", "fill-rule", "clip-rule", "stroke")
OPACITY = ("opacity", "fill-opacity")
UNPAINTED = ("none", "transparent")
BLACK = {"black", "#000", "#000000", "rgb(0,0,0)"}
OPAQUE = re.compile(r"#[0-9a-f]{3}(?:[0-9a-f]{3})?|[a-z]+|rgb\([^,/)]+,[^,/)]+,[^,/)]+\)")
READ = (*CUTS, *SHOWN, *PAINT, *OPACITY, "mask-type")
SELECTOR = re.compile(r"(\*|[\w-]+)?((?:[.#][\w-]+)*)")
FONTS = re.compile(r"@font-face\s*\{[^{}]*\}|@charset[^;{}]*;", re.IGNORECASE)  # these draw nothing

TRANSFORM = re.compile(rf"([a-zA-Z]+){SPACE}\({SPACE}({NUMBER}(?:{COMMA}{NUMBER})*+){SPACE}\){COMMA}")
TRANSFORMS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
VIEW_BOX = re.compile(SPACE + COMMA.join([f"({NUMBER})"] * 4) + SPACE)
ASPECT = re.compile(r"\s*(?:defer\s+)?(none|x(Min|Mid|Max)Y(Min|Mid|Max))(?:\s+(meet|slice))?\s*")
ALIGN = {"Min": 0.0, "Mid": 0.5, "Max": 1.0, None: 0.0}
FRACTION = re.compile(rf"{SPACE}({NUMBER})(%?){SPACE}")
WHOLE = {"x": "-10%", "y": "-10%", "width": "120%", "height": "120%"}  # of the masked element (SVG 1.1, 14.4)
Size = tuple[float | None, float | None]


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


def read_document(path: Path, complain: Complaint) -> Node:
    """Read the file into a tree of SVG elements, and return its root; nothing else is ever opened.

    Raises InputError for a file that is unsafe, too large or malformed, and for elements that can never be printed.
    """
    data = read_bytes(path, MAX_BYTES, complain)
    if data.startswith(b"\x1f\x8b"):
        raise complain(f"{path.name} is compressed", hint="save it as plain SVG")
    # expat silently drops unknown entities if an external DTD is named, so a DOCTYPE without a subset is blanked first.
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
        _check_element(node, any(each is not None and each.tag in NOT_DRAWN for each in open_nodes))
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


def _check_element(node: Node, defined: bool) -> None:
    """Refuse an element that can never be printed, and a reference to anything outside of the file.

    Elements that can be hidden are refused once drawn; those only `defined`, at once: a pattern may show them.
    """
    if node.tag in NEVER:
        raise node.error(f"<{node.tag}> cannot be printed", NEVER[node.tag])
    if node.tag in REFUSED:
        if defined:
            raise unprintable(node)
        return
    known = SHAPES | GROUPS | NOT_DRAWN
    if node.tag not in known and not re.fullmatch(r"fe[A-Z]\w+", node.tag):
        near = nearest_name(node.tag, known)
        raise node.error(f"<{node.tag}> is not an element that can be printed", near and f"did you mean <{near}>?")
    for name, value in node.attributes.items():
        if name in ("href", XLINK_HREF, "src") and node.tag != "a":  # a link is not followed
            check_reference(node, value)
        for target in URL.findall(value):
            check_reference(node, target)


def unprintable(node: Node) -> InputError:
    """Return the error for an element in REFUSED."""
    return node.error(f"<{node.tag}> cannot be printed", REFUSED[node.tag])


def check_reference(node: Node, target: str) -> None:
    """Refuse a reference to anything outside of the file."""
    if not target.strip().startswith("#"):
        raise node.error(f"a reference to outside of the file is never followed: {target[:60]!r}", "only '#id'")


SHAPING |= {"d", "x", "y", "cx", "cy", "r", "rx", "ry", "width", "height"}


@dataclass(frozen=True)
class Rule:
    """A style rule with one simple selector; `rank` is its specificity (ids, classes, tags), then its order.

    One that cannot be read (`marks` None) selects nothing and holds only paint.
    """

    rank: tuple[int, int, int, int]
    tag: str | None
    marks: tuple[str, ...] | None
    properties: dict[str, str]

    def matches(self, node: Node) -> bool:
        """True if the selector selects the element."""
        if self.marks is None:
            return False
        own = {"." + name for name in node.attributes.get("class", "").split()} | {f"#{node.id}"}
        return self.tag in (None, "*", node.tag) and own.issuperset(self.marks)


def style_properties(node: Node, text: str) -> dict[str, str]:
    """Return the declarations in a style that matter for an outline."""
    found = {}
    for declaration in _without_comments(text).split(";"):
        name, _, value = (part.strip() for part in declaration.partition(":"))
        name = name.lower()
        if name in SHAPING or name in READ:
            if "!" in value and name not in (*PAINT, *OPACITY):
                raise node.error(f"{name}: {value} in a style is not supported", "leave out the !important")
            found[name] = value if "(" in value else value.lower()  # an id in url(#id) has capitals
    return found


def style_rules(node: Node, order: int) -> list[Rule]:
    """Return the rules of a <style> element that matter for an outline; `order` is the number of rules before."""
    text = FONTS.sub("", _without_comments("".join(node.text)))
    if "@" in text:
        raise node.error(
            "@-rules (@import, @media, …) are neither supported nor followed", "write styles as attributes"
        )
    for target in URL.findall(text):
        check_reference(node, target)
    *blocks, rest = text.split("}")
    rules: list[Rule] = []
    for block in blocks:
        selectors, brace, body = block.partition("{")
        if not brace or "{" in body:
            raise node.error("the style sheet is malformed")
        properties = style_properties(node, body)
        for selector in selectors.split(",") if properties else ():
            match = SELECTOR.fullmatch(selector.strip())
            if match is None or not match[0]:
                if properties.keys() <= {*PAINT, *OPACITY}:
                    rules.append(Rule((0, 0, 0, order + len(rules)), None, None, properties))
                    continue
                raise node.error(f"the selector {selector.strip()!r} is not supported", "a tag, .class or #id")
            marks = tuple(re.findall(r"[.#][\w-]+", match[2]))
            ids = sum(mark.startswith("#") for mark in marks)
            rank = (ids, len(marks) - ids, int(match[1] not in (None, "*")), order + len(rules))
            rules.append(Rule(rank, match[1], marks, properties))
    if rest.strip():
        raise node.error("the style sheet is malformed")
    return rules


def _without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)


def transform_matrix(node: Node) -> Array:
    """Return the element's own transform (3, 3)."""
    text, matrix, at = node.attributes.get("transform", "").strip(), np.eye(3), 0
    if text in ("", "none"):
        return matrix
    while at < len(text):
        match = TRANSFORM.match(text, at)
        if match is None:
            raise node.error(f"transform is malformed from character {at + 1}: {text[at : at + 30]!r}")
        name, values = match[1], [float(number) for number in re.findall(NUMBER, match[2])]
        if len(values) not in TRANSFORMS.get(name, ()):
            near = nearest_name(name, TRANSFORMS)
            hint = f"did you mean {near}?" if near and near != name else f"it takes {TRANSFORMS.get(name)}"
            raise node.error(f"there is no transform {name} with {len(values)} numbers", hint if near else None)
        if not all(abs(value) <= MAX_COORDINATE for value in values):
            raise node.error(f"transform {name} has a number beyond {MAX_COORDINATE:g}")
        matrix = matrix @ _elementary(name, values)
        at = match.end()
    linear = matrix[:2, :2]
    if not (abs(np.linalg.det(linear)) > 1e-12 * np.abs(linear).max() ** 2 and np.abs(matrix).max() <= 1e12):
        raise node.error(f"transform is singular or too large: {text[:40]!r}")
    return matrix


def _elementary(name: str, values: list[float]) -> Array:
    """Return the matrix (3, 3) of one transform function (SVG 1.1, 7.6)."""
    first, last = values[0], values[-1]
    angle = math.radians(first)
    if name == "matrix":
        a, b, c, d, e, f = values
    elif name == "translate":
        a, b, c, d, e, f = 1, 0, 0, 1, first, last if len(values) > 1 else 0
    elif name == "scale":
        a, b, c, d, e, f = first, 0, 0, last, 0, 0
    elif name == "rotate":
        x, y = values[1:] or (0.0, 0.0)
        a, b = math.cos(angle), math.sin(angle)
        c, d, e, f = -b, a, x - a * x + b * y, y - b * x - a * y
    else:
        slope = math.tan(angle)
        a, b, c, d, e, f = (1, 0, slope, 1, 0, 0) if name == "skewX" else (1, slope, 0, 1, 0, 0)
    return np.array([[a, c, e], [b, d, f], [0, 0, 1]], dtype=float)


def viewport_matrix(node: Node, outer: Size, user: Node | None, is_root: bool) -> tuple[Array, Size]:
    """Return the transform (3, 3) of an <svg> or <symbol> into its viewport, and the size inside (SVG 1.1, 7.7).

    outer is the size of the viewport around it; `user`, a <use>, may give the size.
    """
    box: list[float] | None = None
    if "viewBox" in node.attributes:
        match = VIEW_BOX.fullmatch(node.attributes["viewBox"])
        box = [float(number) for number in match.groups()] if match else None
        if box is None or max(map(abs, box)) > MAX_COORDINATE or min(box[2:]) < 1 / MAX_COORDINATE:
            raise node.error(f"viewBox is not four numbers that make a box: {node.attributes['viewBox'][:40]!r}")
    if is_root and box is not None:
        outer = box[2], box[3]
    sizes: list[float | None] = []
    for name, whole in zip(("width", "height"), outer, strict=True):
        giver = user if user is not None and name in user.attributes else node
        size = None if giver.attributes.get(name, "").strip() == "100%" else giver.length(name)
        sizes.append(whole if size is None else size)
    width, height = sizes
    if is_root and box is not None and ("width" in node.attributes) != ("height" in node.attributes):
        if "width" in node.attributes and width is not None:
            height = width * box[3] / box[2]
        elif height is not None:
            width = height * box[2] / box[3]
    if width == 0 or height == 0:
        raise node.error("with a width or height of 0 it draws nothing")
    x, y = (0.0, 0.0) if is_root else (node.length("x") or 0.0, node.length("y") or 0.0)
    if box is None:
        return np.array([[1, 0, x], [0, 1, y], [0, 0, 1]]), (width, height)
    if width is None or height is None:
        raise node.error("it has a viewBox, but no width and height to fit it into")
    aspect = ASPECT.fullmatch(node.attributes.get("preserveAspectRatio", "xMidYMid"))
    if aspect is None:
        raise node.error(f"preserveAspectRatio is malformed: {node.attributes['preserveAspectRatio'][:40]!r}")
    scale_x, scale_y = width / box[2], height / box[3]
    if aspect[1] != "none":
        scale_x = scale_y = (max if aspect[4] == "slice" else min)(scale_x, scale_y)
    shift_x = x - box[0] * scale_x + ALIGN[aspect[2]] * (width - box[2] * scale_x)
    shift_y = y - box[1] * scale_y + ALIGN[aspect[3]] * (height - box[3] * scale_y)
    return np.array([[scale_x, 0, shift_x], [0, scale_y, shift_y], [0, 0, 1]]), (box[2], box[3])


def page_of(root: Node, matrix: Array, size: Size) -> Array | None:
    """Return the page's least and greatest x and y (2, 2), None if it has no size; `matrix` (3, 3) leads out of it."""
    match = VIEW_BOX.fullmatch(root.attributes.get("viewBox", ""))
    x, y = (float(match[1]), float(match[2])) if match else (0.0, 0.0)
    if size[0] is None or size[1] is None:
        return None
    corners = np.array([[x, y], [x + size[0], y + size[1]]]) @ matrix[:2, :2].T + matrix[:2, 2]
    return np.sort(corners, axis=0)


def mask_box(node: Node) -> Array | None:
    """Return the corners (4, 2) of the box of a <mask> in user units; None if it does not cut the element."""
    given = [name for name in ("x", "y", "width", "height") if name in node.attributes]
    if not given:
        return None
    if node.attributes.get("maskUnits") != "userSpaceOnUse":
        sides = {name: FRACTION.fullmatch(node.attributes.get(name, default)) for name, default in WHOLE.items()}
        x, y, width, height = (float(m[1]) / (100 if m[2] else 1) if m else np.nan for m in sides.values())
        if x <= 0 and y <= 0 and x + width >= 1 and y + height >= 1:
            return None
        raise node.error("a mask smaller than what it masks is not supported", "maskUnits: userSpaceOnUse")
    lengths = [node.length(name) for name in WHOLE]
    if None in lengths:
        raise node.error("a mask in userSpaceOnUse needs x, y, width and height")
    x, y, width, height = (length for length in lengths if length is not None)
    return np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
