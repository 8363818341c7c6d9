"""Read a URDF file, with its elements' lines, into a Pinocchio model of the joints from its base to the tip."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

import pinocchio as pin

from planner.base.budgets import LINKS, URDF_BYTES
from planner.base.errors import InputError, nearest_name

XACRO = "run xacro on it first, or name it .xacro and give it to beadwise robots add"
LARGEST = URDF_BYTES.most
FARTHEST = 20.0  # m: lengths beyond this are mistakes, such as millimetres
TYPES = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
_MOVES = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Urdf:
    """The elements of a URDF file, and the line on which each begins."""

    path: Path
    root: ET.Element
    lines: Mapping[ET.Element, int]

    def error(self, element: ET.Element, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error for an element, with file and line; `field` names it, such as `link hand`, `joint wrist`."""
        return InputError(reason, file=self.path, line=self.lines[element], field=field, hint=hint)

    def numbers(self, element: ET.Element, key: str, field: str, count: int, default: str | None = None) -> list[float]:
        """The finite numbers (count) of an attribute. Raises InputError if it holds anything else, or is missing."""
        text = element.get(key, default)
        if text is None:
            raise self.error(element, field, f"<{element.tag}> has no {key}")
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            many = "a number" if count == 1 else f"{count} numbers"
            raise self.error(element, field, f"{key} of <{element.tag}> must be {many}, not {text[:40]!r}")
        return values

    def links(self) -> dict[str, ET.Element]:
        """Links by name, in the order of the file."""
        return {link.get("name", ""): link for link in self.root.findall("link")}


def read_urdf(path: Path) -> Urdf:
    """Read a URDF file, but none of those it names. Raises InputError for anything but a tree of links and joints."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    if len(data) > LARGEST:
        raise InputError(f"is larger than {LARGEST // 10**6} MB", file=path)
    return parse_urdf(data, path)


def parse_urdf(data: bytes, path: Path) -> Urdf:
    """Read a URDF from its text, as if from a file, which need not exist yet."""
    parser, builder = expat.ParserCreate(), ET.TreeBuilder()
    lines: dict[ET.Element, int] = {}

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    def declared(*_: object) -> None:
        raise InputError("a DOCTYPE is not allowed", file=path, line=parser.CurrentLineNumber, hint="leave it out")

    parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, declared
    parser.EndElementHandler = builder.end
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise InputError(reason, file=path, line=error.lineno) from None
    except (LookupError, ValueError) as error:
        raise InputError(f"the text's encoding cannot be read: {error}", file=path, line=1) from None
    root = builder.close()
    if root.tag != "robot":
        raise InputError(f"the root element is <{root.tag}>, not <robot>", file=path, line=lines[root])
    urdf = Urdf(path, root, lines)
    for element in root.iter():
        if element.tag.startswith("xacro:"):
            raise urdf.error(element, element.tag, "is a macro: this file is not a URDF yet", XACRO)
    for tag in ("link", "joint"):
        seen: set[str] = set()
        for element in root.findall(tag):
            name = element.get("name", "")
            if not name:
                raise urdf.error(element, tag, "has no name")
            if name in seen:
                raise urdf.error(element, f"{tag} {name}", "appears twice in the file")
            seen.add(name)
    links = urdf.links()
    if not links:
        raise urdf.error(root, "robot", "has no links")
    LINKS.check(len(links), "the robot has", partial(urdf.error, root, "robot"), "leave out what does not move the arm")
    _check_tree(urdf)
    return urdf


def joints_to(urdf: Urdf, tip: str) -> list[ET.Element]:
    """The joints from the base to a link, base first."""
    above = {_end(joint, "child"): joint for joint in urdf.root.findall("joint")}
    way: list[ET.Element] = []
    link = tip
    while link in above:
        way.append(above[link])
        link = _end(above[link], "parent")
    return way[::-1]


def _check_tree(urdf: Urdf) -> None:
    """Refuse links and joints that do not form one tree."""
    links, above = urdf.links(), dict[str, ET.Element]()
    for joint in urdf.root.findall("joint"):
        name = f"joint {joint.get('name')}"
        for end in ("parent", "child"):
            link = _end(joint, end)
            if not link:
                raise urdf.error(joint, name, f"has no {end} link")
            if link not in links:
                near = nearest_name(link, links)
                hint = f"did you mean {near}?" if near else f"links: {', '.join(links)}"
                raise urdf.error(joint, name, f"no link {link!r}", hint)
        child = _end(joint, "child")
        if child in above:
            raise urdf.error(joint, name, f"link {child} is the child of another joint as well", "links form a tree")
        above[child] = joint
    bases = [link for link in links if link not in above]
    if len(bases) > 1:
        raise urdf.error(links[bases[1]], f"link {bases[1]}", f"has no parent, like {bases[0]}", "links form a tree")
    reached = hanging_on(urdf, bases)
    for link, element in links.items():
        if link not in reached:
            raise urdf.error(element, f"link {link}", "is its own ancestor", "links form a tree")


def moving_joints(urdf: Urdf, tip: str) -> list[ET.Element]:
    """The joints from the base to the tip that are not fixed, base first."""
    return [joint for joint in joints_to(urdf, tip) if joint.get("type") != "fixed"]


def names_of(joints: Iterable[ET.Element]) -> list[str]:
    """Names of joints; empty for a joint without one."""
    return [joint.get("name", "") for joint in joints]


def moved_by(urdf: Urdf, link: str) -> str:
    """Name of the last moving joint on the way to a link; empty if there is none."""
    return next(reversed(names_of(moving_joints(urdf, link))), "")


def first_links(urdf: Urdf, tip: str) -> tuple[str, str]:
    """Names of the parent and the child link of the first moving joint on the way to the tip."""
    joint = moving_joints(urdf, tip)[0]
    return _end(joint, "parent"), _end(joint, "child")


def sliding_joints(urdf: Urdf, tip: str) -> list[str]:
    """Names of the sliding joints from the base to the tip, base first."""
    return names_of(joint for joint in moving_joints(urdf, tip) if joint.get("type") == "prismatic")


def model_of(urdf: Urdf, tip: str, ranges: Ranges, speeds_given: bool) -> pin.Model:
    """Pinocchio's model of the joints from base to tip; others, such as a gripper's, are held at zero.

    ranges [rad, or m for sliding joints], by joint, replace the URDF's, and give ends to a joint that has none;
    speeds_given: the joints' speeds come from elsewhere. Raises InputError for joints of an unknown type.
    """
    own = ET.Element("robot", name=urdf.root.get("name", "robot"))
    for name in urdf.links():
        ET.SubElement(own, "link", name=name)
    moved = joints_to(urdf, tip)
    for joint in urdf.root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        field = f"joint {name}"
        if kind not in TYPES:
            near = nearest_name(kind, TYPES)
            hint = f"did you mean {near}?" if near else f"known: {', '.join(TYPES)}"
            raise urdf.error(joint, field, f"unknown type {kind!r}", hint)
        moves = joint in moved and kind != "fixed"
        copy = ET.SubElement(own, "joint", name=name, type=_MOVES.get(kind, "fixed") if moves else "fixed")
        for end in ("parent", "child"):
            ET.SubElement(copy, end, link=_end(joint, end))
        xyz, rpy = origin_of(urdf, joint, field)
        ET.SubElement(copy, "origin", xyz=_text(xyz), rpy=_text(rpy))
        if moves:
            ET.SubElement(copy, "axis", xyz=_text(_axis(urdf, joint, field)))
            low, high, speed = _limit(urdf, joint, field, ranges.get(name), speeds_given)
            ET.SubElement(copy, "limit", lower=repr(low), upper=repr(high), velocity=repr(speed), effort="0")
    try:
        return pin.buildModelFromXML(ET.tostring(own, encoding="unicode"))
    except ValueError as error:
        raise InputError("is not a readable URDF", file=urdf.path, hint=str(error)) from None


def link_frame(model: pin.Model, link: str) -> int:
    """Index of a link's frame in a model, whose joints may have the same name."""
    return int(model.getFrameId(link, pin.FrameType.BODY))


def origin_of(urdf: Urdf, element: ET.Element, field: str) -> tuple[list[float], list[float]]:
    """Pose of a joint or a shape: xyz [m] and the angles rpy [rad] about fixed axes, each zero if not given."""
    origin = element.find("origin")
    if origin is None:
        return [0.0] * 3, [0.0] * 3
    xyz, rpy = (urdf.numbers(origin, key, field, 3, "0 0 0") for key in ("xyz", "rpy"))
    if (away := max(map(abs, xyz))) > FARTHEST:
        raise urdf.error(origin, field, f"its origin is {away:g} m away", "origins are in metres")
    return xyz, rpy


def hanging_on(urdf: Urdf, links: Collection[str]) -> set[str]:
    """Links, and all links that hang on them."""
    found = set(links)
    grown = True
    while grown:
        more = {_end(j, "child") for j in urdf.root.findall("joint") if _end(j, "parent") in found} - found
        grown = bool(more)
        found |= more
    return found


def _end(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _axis(urdf: Urdf, joint: ET.Element, field: str) -> list[float]:
    element = joint.find("axis")
    axis = [1.0, 0.0, 0.0] if element is None else urdf.numbers(element, "xyz", field, 3)
    length = math.hypot(*axis)
    if length < 1e-6:
        raise urdf.error(joint, field, "its axis has no length")
    return [value / length for value in axis]


def _limit(
    urdf: Urdf, joint: ET.Element, field: str, given: tuple[float, float] | None, speeds_given: bool
) -> tuple[float, float, float]:
    """Least and greatest angle [rad] and greatest speed [rad/s] of a moving joint; in metres for one that slides."""
    kind = joint.get("type", "")
    name = joint.get("name")
    if kind not in _MOVES:
        hint = "only revolute, continuous and prismatic joints can stand between base and tip"
        raise urdf.error(joint, field, f"is {kind}", hint)
    if joint.find("mimic") is not None:
        raise urdf.error(joint, field, "follows another joint", "each joint between base and tip needs its own motor")
    limit = joint.find("limit")
    own_range = f"give range_deg: {{{name}: [-360, 360]}}, or what its cables allow, in the robot's file"
    if kind == "prismatic":
        own_range = f"give range_mm: {{{name}: [0, 3000]}}, or how far it goes, in the robot's file"
    if given is None:
        if kind == "continuous":
            raise urdf.error(joint, field, "turns without end", own_range)
        if limit is None or limit.get("lower") is None or limit.get("upper") is None:
            raise urdf.error(joint, field, "has no limits", f"lower and upper; or {own_range}")
        given = urdf.numbers(limit, "lower", field, 1)[0], urdf.numbers(limit, "upper", field, 1)[0]
        if not given[0] < given[1]:
            raise urdf.error(joint, field, "its upper limit is not above the lower one", own_range)
    if limit is not None and limit.get("velocity") is not None:
        speed = urdf.numbers(limit, "velocity", field, 1)[0]
    else:
        speed = 0.0
    if speed <= 0.0 and not speeds_given:
        raise urdf.error(
            joint, field, "has no speed", "velocity of its limit [rad/s, m/s]; or speed_rad_s of all joints"
        )
    return given[0], given[1], speed


def _text(values: list[float]) -> str:
    return " ".join(map(repr, values))
