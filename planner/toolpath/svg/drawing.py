"""Walks the tree of SVG elements, follows <use>, and collects the visible outlines and what clips or masks them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from planner.base.arrays import Array
from planner.base.budgets import SVG_MATCHES, SVG_SEGMENTS
from planner.base.errors import InputError, nearest_name
from planner.toolpath.svg.document import (
    BLACK,
    CUTS,
    MAX_COORDINATE,
    MAX_DEPTH,
    MAX_ELEMENTS,
    MAX_POINTS,
    NOT_DRAWN,
    OPACITY,
    OPAQUE,
    PAINT,
    READ,
    REFUSED,
    SHAPES,
    SHAPING,
    UNPAINTED,
    XLINK_HREF,
    Node,
    Rule,
    Size,
    mask_box,
    page_of,
    style_properties,
    style_rules,
    transform_matrix,
    unprintable,
    viewport_matrix,
)
from planner.toolpath.svg.shapes import OutlinePiece, Subpath, subpaths_of

# Attributes that would move or hide an outline and are not supported; for properties in styles see document.py.
REFERENCE = re.compile(r"url\(\s*[\"']?\s*#([^\s\"')]*)\s*[\"']?\s*\)", re.IGNORECASE)
MOVING = ("transform-origin", "refX", "refY", "systemLanguage", "requiredExtensions")


@dataclass(frozen=True)
class Outline:
    """One visible subpath, in the root's user units.

    shape, element   number and name that all subpaths of one drawn element share
    paint            its properties among PAINT and OPACITY
    cuts             regions through which it is seen: it is visible inside all of them
    """

    node: Node
    name: str
    pieces: tuple[OutlinePiece, ...]
    closed: bool
    shape: int
    element: str
    paint: dict[str, str]
    cuts: tuple[Region, ...]

    @property
    def invisible(self) -> bool:
        """Whether it has neither fill nor stroke, and no unread rule could give it one."""
        fill, stroke = self.paint.get("fill", "black"), self.paint.get("stroke", "none")
        return "unread" not in self.paint and all(each.strip().lower() in UNPAINTED for each in (fill, stroke))


@dataclass(frozen=True)
class Region:
    """The region that a <clipPath> or <mask> shows: its shapes in painting order, within a box (4, 2), if any.

    node    the element
    alpha   whether it is a mask for which black is as good as white
    """

    node: Node
    outlines: tuple[Outline, ...]
    alpha: bool
    box: Array | None


@dataclass(frozen=True)
class ElementContext:
    """Where and how an element is drawn.

    Its transform (3, 3) into the root, visibility, viewport, the <use>s that led here, and the paint and cuts it
    inherits.
    """

    matrix: Array
    visible: bool = True
    viewport: Size = (None, None)
    uses: tuple[Node, ...] = ()
    depth: int = 0
    paint: dict[str, str] = field(default_factory=dict)
    cuts: tuple[Region, ...] = ()


class Drawing:
    """Walks the tree of elements and collects what is visible.

    dots   number of subpaths that are single points
    page   least and greatest x and y (2, 2) of the page, if it has a size
    """

    def __init__(self, root: Node) -> None:
        self._root = root
        self._drawn: list[Outline] = []
        self.dots = 0
        self.page: Array | None = None
        self._elements = self._points = self._shapes = self._segments = 0
        self._subpaths: dict[int, list[Subpath]] = {}
        self._counts: dict[int, int] = {}
        self._ids: dict[str, list[Node]] = {}
        self._rules: list[Rule] = []
        self._parents: dict[int, Node] = {}
        nodes = [root]
        for node in nodes:
            nodes += node.children
        waiting = [root]
        while waiting:
            node = waiting.pop()
            waiting.extend(reversed(node.children))
            self._parents |= {id(child): node for child in node.children}
            if node.id is not None:
                self._ids.setdefault(node.id, []).append(node)
            if node.tag == "style":
                self._rules += style_rules(node, len(self._rules))
                hint = "write styles as attributes, or leave out rules"
                SVG_MATCHES.check(len(nodes) * len(self._rules), "its rules need", node.error, hint)

    def outlines(self) -> list[Outline]:
        """Return every visible subpath in drawing order."""
        self._count(self._root, False, 0)
        self._draw(self._root, ElementContext(np.eye(3)), None)
        return self._drawn

    def _count(self, node: Node, used: bool, depth: int) -> int:
        """Return how many elements `_draw` will visit for this one, cuts aside; refuse in advance if too many."""
        if depth > MAX_DEPTH or (node.tag in NOT_DRAWN and not (node.tag == "symbol" and used)):
            return 1
        if id(node) not in self._counts:
            self._counts[id(node)] = count = 1  # an element that contains itself stops here; `_follow` refuses it
            if node.tag in SHAPES or self._style(node).get("display") == "none":
                return count
            if node.tag == "use":
                found = self._ids.get(_name_used(node), [])
                count += self._count(found[0], True, depth + 1) if found else 0
            else:
                count += sum(self._count(child, False, depth + 1) for child in node.children)
            if count > MAX_ELEMENTS:
                raise _too_many(node)
            self._counts[id(node)] = count
        return self._counts[id(node)]

    def _draw(self, node: Node, place: ElementContext, user: Node | None) -> None:
        """Draw an element; `user` is the <use> that refers to it, if it is drawn because of that."""
        self._elements += 1
        if self._elements > MAX_ELEMENTS or place.depth > MAX_DEPTH:
            raise _too_many(node)
        if node.tag in NOT_DRAWN and not (node.tag == "symbol" and user is not None):
            return
        style = self._style(node)
        if style.get("display") == "none":
            return
        if node.tag in REFUSED:
            raise unprintable(node)
        for name in MOVING:
            if node.attributes.get(name, "none").strip() not in ("none", ""):
                raise node.error(f"{name} is not supported", "apply or remove it in the drawing program")
        visible = {"visible": True, "hidden": False, "collapse": False}.get(style.get("visibility", ""), place.visible)
        matrix = place.matrix @ transform_matrix(node) if "transform" in node.attributes else place.matrix
        paint = place.paint | {name: style[name] for name in PAINT if name in style}
        cuts = place.cuts + self._cuts(node, style, replace(place, matrix=matrix))
        viewport = place.viewport
        if node.tag in ("svg", "symbol"):
            inner, viewport = viewport_matrix(node, viewport, user, node is self._root)
            matrix = matrix @ inner
            if node is self._root:
                self.page = page_of(node, matrix, viewport)
        if not np.abs(matrix).max() <= 1e15:
            raise node.error("its transforms together are too large")
        inside = ElementContext(matrix, visible, viewport, place.uses, place.depth + 1, paint, cuts)
        if node.tag == "use":
            self._follow(node, inside)
        elif node.tag not in SHAPES:
            for child in node.children:
                self._draw(child, inside, None)
        elif visible:
            opacity = {name: style[name] for name in (*OPACITY, "unread") if name in style}
            self._add(node, replace(inside, paint=paint | opacity))

    def _follow(self, node: Node, place: ElementContext) -> None:
        """Draw the element that a <use> refers to."""
        name = _name_used(node)
        found = self._named(node, name)
        if found.tag in NOT_DRAWN - {"symbol"}:
            raise node.error(f"<{found.tag}> '{name}' cannot be drawn")
        if any(node is user for user in place.uses):
            raise node.error(f"it uses itself, by way of '{name}'")
        shift = np.array([[1, 0, node.length("x") or 0.0], [0, 1, node.length("y") or 0.0], [0, 0, 1]])
        self._draw(found, replace(place, matrix=place.matrix @ shift, uses=(*place.uses, node)), node)

    def _named(self, node: Node, name: str) -> Node:
        """Return the element with an id that `node` refers to."""
        found = self._ids.get(name, [])
        if not found:
            near = nearest_name(name, self._ids)
            raise node.error(f"there is no element '{name}'", near and f"did you mean '{near}'?")
        if len(found) > 1:
            raise node.error(f"the id '{name}' is given {len(found)} times, last in line {found[-1].line}")
        return found[0]

    def _cuts(self, node: Node, style: dict[str, str], place: ElementContext) -> tuple[Region, ...]:
        """Return the regions that the element's own clip path and mask show."""
        regions = []
        for name in CUTS:
            value = style.get(name, "none")
            if value in ("none", ""):
                continue
            match = REFERENCE.fullmatch(value)
            if match is None:
                raise node.error(f"{name} is not supported: {value[:40]!r}", "url(#id) of a <clipPath> or <mask>")
            found = self._named(node, match[1])
            wanted = "clipPath" if name == "clip-path" else "mask"
            if found.tag != wanted:
                raise node.error(f"{name} names <{found.tag}> '{found.id}', not a <{wanted}>")
            if any(found is user for user in place.uses):
                raise node.error(f"it is cut by itself, by way of '{found.id}'")
            regions.append(self._region(found, replace(place, visible=True, cuts=(), uses=(*place.uses, found))))
        return tuple(regions)

    def _region(self, node: Node, place: ElementContext) -> Region:
        """Return the region that a <clipPath> or <mask> shows; `place` is in the user units of the element it cuts."""
        style = self._style(node)
        units = "clipPathUnits" if node.tag == "clipPath" else "maskContentUnits"
        if node.attributes.get(units, "userSpaceOnUse") != "userSpaceOnUse":
            raise node.error(f"{units} other than userSpaceOnUse are not supported", "apply it in the drawing program")
        paint: dict[str, str] = {}
        chain = [node]
        while id(chain[-1]) in self._parents:
            chain.append(self._parents[id(chain[-1])])
        for above in reversed(chain):
            paint |= {name: value for name, value in self._style(above).items() if name in PAINT}
        if "transform" in node.attributes:
            place = replace(place, matrix=place.matrix @ transform_matrix(node))
        box = None if node.tag == "clipPath" else mask_box(node)
        inside = replace(place, paint=paint, cuts=self._cuts(node, style, place), depth=place.depth + 1)
        drawn, self._drawn, dots = self._drawn, [], self.dots
        for child in node.children:
            if node.tag == "clipPath" and child.tag not in SHAPES | NOT_DRAWN | {"use"}:
                raise child.error(f"<{child.tag}> is not allowed in a <clipPath>")
            self._draw(child, inside, None)
        outlines = tuple(replace(outline, paint=self._plain(outline)) for outline in self._drawn)
        self._drawn, self.dots = drawn, dots
        if box is not None:
            box = box @ place.matrix[:2, :2].T + place.matrix[:2, 2]
        return Region(node, outlines, style.get("mask-type") == "alpha", box)

    def _plain(self, outline: Outline) -> dict[str, str]:
        """Return the paint of an outline; a gradient that is opaque and nowhere black is as good as white."""
        match = REFERENCE.fullmatch(outline.paint.get("fill", ""))
        if match is None:
            return outline.paint
        stops = [stop for stop in self._named(outline.node, match[1]).children if stop.tag == "stop"]
        colours = [stop.attributes.get("stop-color", "black").strip().lower() for stop in stops]
        given = {name for stop in stops for name in stop.attributes}
        plain = all(OPAQUE.fullmatch(colour) for colour in colours) and not BLACK.union(["transparent"]) & set(colours)
        plain = plain and bool(stops) and not {"stop-opacity", "style", "class"} & given
        return outline.paint | {"fill": "white"} if plain else outline.paint

    def _add(self, node: Node, place: ElementContext) -> None:
        """Add the subpaths of a shape."""
        if id(node) not in self._subpaths:
            self._subpaths[id(node)] = found = subpaths_of(node)
            self._segments += sum(len(p.points) if p.kind == "lines" else 1 for pieces, _ in found for p in pieces)
            hint = "draw it in several files"
            SVG_SEGMENTS.check(self._segments, "up to here there are", node.error, hint)
        subpaths = self._subpaths[id(node)]
        self._points += sum(len(piece.points) for pieces, _ in subpaths for piece in pieces)
        if self._points > 4 * MAX_POINTS:  # includes controls; final points are counted once the size is known
            raise node.error(f"from here on there are more than {MAX_POINTS} points")
        lines = [each for each in subpaths if any(np.ptp(piece.points, axis=0).any() for piece in each[0])]
        if not lines or place.paint.get("stroke", "none") != "none":  # unstroked, a point next to lines draws nothing
            self.dots += len(subpaths) - len(lines)
        name = "/".join([*(use.id for use in place.uses if use.id), node.id or f"{node.tag} {node.number}"])
        for k, (pieces, closed) in enumerate(lines, 1):
            linear, shift = place.matrix[:2, :2].T, place.matrix[:2, 2]
            mapped = tuple(replace(piece, points=piece.points @ linear + shift) for piece in pieces)
            ends = (piece.ends if piece.kind == "arc" else piece.points for piece in mapped)
            if not all((np.abs(points) <= MAX_COORDINATE).all() for points in ends):
                raise node.error(f"it lies beyond {MAX_COORDINATE:g} user units")
            own_name = name if len(lines) == 1 else f"{name}.{k}"
            self._drawn.append(Outline(node, own_name, mapped, closed, self._shapes, name, place.paint, place.cuts))
        self._shapes += 1

    def _style(self, node: Node) -> dict[str, str]:
        """Return the properties that matter for an outline: attributes, below style sheets, below its own style."""
        style: dict[str, str] = {}
        for rule in sorted((rule for rule in self._rules if rule.matches(node)), key=lambda rule: rule.rank):
            style |= rule.properties
        style |= style_properties(node, node.attributes.get("style", ""))
        for name in sorted(SHAPING & style.keys()):
            of_page = node is self._root and name in ("width", "height")  # this does not affect the print
            if not of_page and style[name] not in ("none", "auto"):
                raise node.error(f"{name} in a style is not supported", "write it as an attribute")
        own = {name: node.attributes[name].strip() for name in READ if name in node.attributes}
        style = own | style
        if any(rule.marks is None for rule in self._rules):
            style["unread"] = "yes"
        return {name: value for name, value in style.items() if name not in PAINT or value != "inherit"}


def _name_used(node: Node) -> str:
    """Return the id that a <use> refers to."""
    return node.attributes.get("href", node.attributes.get(XLINK_HREF, "")).strip().removeprefix("#")


def _too_many(node: Node) -> InputError:
    return node.error(f"with the copies by <use> there are more than {MAX_ELEMENTS} elements, or {MAX_DEPTH} levels")
