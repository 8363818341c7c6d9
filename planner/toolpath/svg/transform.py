"""Transforms and viewports of SVG elements as 3 x 3 matrices."""

from __future__ import annotations

import math
import re

import numpy as np

from planner.errors import nearest_name
from planner.readonly import Array
from planner.toolpath.svg.document import COMMA, MAX_COORDINATE, NUMBER, SPACE, Node

TRANSFORM = re.compile(rf"([a-zA-Z]+){SPACE}\({SPACE}({NUMBER}(?:{COMMA}{NUMBER})*+){SPACE}\){COMMA}")
TRANSFORMS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}
VIEW_BOX = re.compile(SPACE + COMMA.join([f"({NUMBER})"] * 4) + SPACE)
ASPECT = re.compile(r"\s*(?:defer\s+)?(none|x(Min|Mid|Max)Y(Min|Mid|Max))(?:\s+(meet|slice))?\s*")
ALIGN = {"Min": 0.0, "Mid": 0.5, "Max": 1.0, None: 0.0}
FRACTION = re.compile(rf"{SPACE}({NUMBER})(%?){SPACE}")
WHOLE = {"x": "-10%", "y": "-10%", "width": "120%", "height": "120%"}  # of what is masked (SVG 1.1, 14.4)
Size = tuple[float | None, float | None]


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


def mask_box(node: Node) -> Array | None:
    """Return the corners (4, 2) of the box of a <mask> in user units; None if it leaves all of the element."""
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
