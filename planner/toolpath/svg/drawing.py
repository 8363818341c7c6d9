"""Walks the tree of SVG elements, follows <use>, and collects the outlines that are visible."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.errors import nearest_name
from planner.toolpath.svg.document import (
    MAX_COORDINATE,
    MAX_DEPTH,
    MAX_ELEMENTS,
    MAX_POINTS,
    NOT_DRAWN,
    SHAPES,
    XLINK_HREF,
    Node,
)
from planner.toolpath.svg.pieces import Piece, Subpath
from planner.toolpath.svg.shapes import subpaths_of
from planner.toolpath.svg.style import SHAPING, Rule, style_properties, style_rules
from planner.toolpath.svg.transform import Size, transform_matrix, viewport_matrix

Array = NDArray[np.float64]
# Attributes that would move or cut an outline and are not supported; svg_style has the properties.
CUTTING = ("clip-path", "mask", "transform-origin", "refX", "refY", "systemLanguage", "requiredExtensions")


@dataclass(frozen=True)
class Outline:
    """One visible subpath, in the root's user units; `part` says which of its element's."""

    node: Node
    name: str
    part: str
    pieces: tuple[Piece, ...]
    closed: bool


@dataclass(frozen=True)
class Place:
    """Where an element is drawn: transform (3, 3) into the root, visibility, viewport, and the <use>s that led here."""

    matrix: Array
    visible: bool = True
    viewport: Size = (None, None)
    uses: tuple[Node, ...] = ()
    depth: int = 0


class Drawing:
    """Walks the tree of elements and collects what is visible."""

    def __init__(self, root: Node) -> None:
        self._root = root
        self._drawn: list[Outline] = []
        self._elements = self._points = 0
        self._subpaths: dict[int, list[Subpath]] = {}
        self._ids: dict[str, list[Node]] = {}
        self._rules: list[Rule] = []
        waiting = [root]
        while waiting:
            node = waiting.pop()
            waiting.extend(reversed(node.children))
            if node.id is not None:
                self._ids.setdefault(node.id, []).append(node)
            if node.tag == "style":
                self._rules += style_rules(node, len(self._rules))

    def outlines(self) -> list[Outline]:
        """Return every visible subpath in drawing order."""
        self._draw(self._root, Place(np.eye(3)), None)
        return self._drawn

    def _draw(self, node: Node, place: Place, user: Node | None) -> None:
        """Draw an element; `user` is the <use> that names it, where that is why it is drawn."""
        self._elements += 1
        if self._elements > MAX_ELEMENTS or place.depth > MAX_DEPTH:
            raise node.error(f"<use> makes more than {MAX_ELEMENTS} elements of it, or more than {MAX_DEPTH} levels")
        if node.tag in NOT_DRAWN and not (node.tag == "symbol" and user is not None):
            return
        style = self._style(node)
        if style.get("display") == "none":
            return
        for name in CUTTING:
            if node.attributes.get(name, "none").strip() not in ("none", ""):
                raise node.error(f"{name} is not supported", "apply or remove it in the drawing program")
        visible = {"visible": True, "hidden": False, "collapse": False}.get(style.get("visibility", ""), place.visible)
        matrix = place.matrix @ transform_matrix(node) if "transform" in node.attributes else place.matrix
        viewport = place.viewport
        if node.tag in ("svg", "symbol"):
            inner, viewport = viewport_matrix(node, viewport, user, node is self._root)
            matrix = matrix @ inner
        if not np.abs(matrix).max() <= 1e15:
            raise node.error("its transforms together are too large")
        inside = Place(matrix, visible, viewport, place.uses, place.depth + 1)
        if node.tag == "use":
            self._follow(node, inside)
        elif node.tag not in SHAPES:
            for child in node.children:
                self._draw(child, inside, None)
        elif visible:
            self._add(node, inside)

    def _follow(self, node: Node, place: Place) -> None:
        """Draw what a <use> names."""
        name = node.attributes.get("href", node.attributes.get(XLINK_HREF, "")).strip().removeprefix("#")
        found = self._ids.get(name, [])
        if not found:
            near = nearest_name(name, self._ids)
            raise node.error(f"there is no element '{name}'", near and f"did you mean '{near}'?")
        if len(found) > 1:
            raise node.error(f"the id '{name}' is given {len(found)} times, last in line {found[-1].line}")
        if found[0].tag in NOT_DRAWN - {"symbol"}:
            raise node.error(f"<{found[0].tag}> '{name}' cannot be drawn")
        if any(node is user for user in place.uses):
            raise node.error(f"it uses itself, by way of '{name}'")
        shift = np.array([[1, 0, node.length("x") or 0.0], [0, 1, node.length("y") or 0.0], [0, 0, 1]])
        self._draw(found[0], replace(place, matrix=place.matrix @ shift, uses=(*place.uses, node)), node)

    def _add(self, node: Node, place: Place) -> None:
        """Add the subpaths of a shape."""
        if id(node) not in self._subpaths:
            self._subpaths[id(node)] = subpaths_of(node)
        subpaths = self._subpaths[id(node)]
        self._points += sum(len(piece.points) for pieces, _ in subpaths for piece in pieces)
        if self._points > 4 * MAX_POINTS:  # controls included; the points themselves are counted once the size is known
            raise node.error(f"from here on there are more than {MAX_POINTS} points")
        name = "/".join([*(use.id for use in place.uses if use.id), node.id or f"{node.tag} {node.number}"])
        for k, (pieces, closed) in enumerate(subpaths, 1):
            linear, shift = place.matrix[:2, :2].T, place.matrix[:2, 2]
            mapped = tuple(replace(piece, points=piece.points @ linear + shift) for piece in pieces)
            ends = (piece.ends if piece.kind == "arc" else piece.points for piece in mapped)
            if not all((np.abs(points) <= MAX_COORDINATE).all() for points in ends):
                raise node.error(f"it lies beyond {MAX_COORDINATE:g} user units")
            own_name, part = (name, "it") if len(subpaths) == 1 else (f"{name}.{k}", f"its subpath {k}")
            self._drawn.append(Outline(node, own_name, part, mapped, closed))

    def _style(self, node: Node) -> dict[str, str]:
        """Return the properties that matter for an outline: attributes, below style sheets, below the own style."""
        style: dict[str, str] = {}
        for rule in sorted((rule for rule in self._rules if rule.matches(node)), key=lambda rule: rule.rank):
            style |= rule.properties
        style |= style_properties(node, node.attributes.get("style", ""))
        for name in sorted(SHAPING & style.keys()):
            of_page = node is self._root and name in ("width", "height")  # which says nothing about the print
            if not of_page and style[name] not in ("none", "auto"):
                raise node.error(f"{name} in a style is not supported", "write it as an attribute")
        own = {name: node.attributes[name].strip() for name in ("display", "visibility") if name in node.attributes}
        return own | style
