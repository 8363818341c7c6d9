"""The part of CSS that matters for an outline: what is shown, by simple selectors; what would reshape is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass

from planner.toolpath.svg.document import URL, Node, check_reference

# What would move an outline and is not supported as a property in a style.
SHAPING = {"transform", "transform-origin", "translate", "rotate", "scale", "zoom", "offset-path"}
SHAPING |= {"d", "x", "y", "cx", "cy", "r", "rx", "ry", "width", "height"}
CUTS = ("clip-path", "mask")
SHOWN = ("display", "visibility")
# What inherits, and matters only where something is cut: of a filled shape another outline is left than of a line.
PAINT = ("fill", "fill-rule", "clip-rule", "stroke")
OPACITY = ("opacity", "fill-opacity")
BLACK = {"black", "#000", "#000000", "rgb(0,0,0)"}
OPAQUE = re.compile(r"#[0-9a-f]{3}(?:[0-9a-f]{3})?|[a-z]+|rgb\([^,/)]+,[^,/)]+,[^,/)]+\)")
READ = (*CUTS, *SHOWN, *PAINT, *OPACITY, "mask-type")
SELECTOR = re.compile(r"(\*|[\w-]+)?((?:[.#][\w-]+)*)")


@dataclass(frozen=True)
class Rule:
    """A style rule with one simple selector; `rank` is its specificity (ids, classes, tags), then its order.

    One that cannot be read (`marks` None) selects nothing; it holds nothing but paint.
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
    """Return the rules of a <style> element that matter for an outline; `order` counts those before."""
    text = _without_comments("".join(node.text))
    if "@" in text:
        raise node.error("@-rules (@import, @media, …) are neither supported nor followed")
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
