"""What a URDF says about an arm: its flange, kind and limits; and what has to be assumed where it says nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers.expat import ExpatError

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.cell.kinematics.axes import OtherGeometry
from planner.cell.kinematics.chain import Chain
from planner.cell.kinematics.offset_wrist import read_offset_wrist
from planner.cell.kinematics.placed_wrist import read_spherical_wrist
from planner.cell.kinematics.seven_axes import FAR, NEAR, read_seven_axes
from planner.cell.kinematics.skew_wrist import read_skew_wrist
from planner.cell.robot import base_to_tip
from planner.cell.urdf import Urdf, joints_to, model_of, moved_by, moving_joints

AXES = (6, 7)  # numbers of joints of arms that can be planned with
FLANGES = (  # names of flange links, best first
    *("tool0", "flange", "ee_link", "tcp", "tool", "link_t", "link_ee", "end_effector_link", "end_effector"),
)
ASSUMED_SPEED = 1.5  # rad/s for a joint without a speed in the URDF: slower than most
ASSUMED_TURN = 360.0  # deg to either side, for a joint without end stops
ALONG = 0.99  # cosine between a frame's z and the last axis, above which z points out of the flange
_MOST_APART = 20.0 * 2.0 * np.pi  # rad between the ends of a joint: ten turns to either side, as in problem files
RISE = 0.25  # s: assumed time in which a joint reaches its speed
JERK = 50.0  # 1/s: assumed ratio of jerk to acceleration, as in the arms that ship
_CARRIED = "what carries an arm needs a URDF and a file of its own, cell.base.robot of problems: give the arm alone"
_TOLD = 6  # arguments of a xacro file that a hint lists, at most
_ARGUMENT = re.compile(r"<xacro:arg\s[^>]*?\bname\s*=\s*[\"']([^\"']+)[^>]*")
_INCLUDE = re.compile(r"<xacro:include\s[^>]*?\bfilename\s*=\s*[\"']([^\"']+)")
_USERS = 3  # files that a hint names, at most
_LOOKED_AT = 500  # xacro files searched for those that include one, at most


@dataclass(frozen=True)
class Survey:
    """What was found about an arm in its URDF, and what was assumed.

    tip      link of the flange; outwards (3): direction in which axis 6 or 7 leaves it, in the tip's frame
    kind     of inverse kinematics, with the redundant joint of seven; roughly: axes that should meet pass each other by
             more than a few millimetres, so that postures are missed
    joints   names, base first; ranges [deg] of those that the URDF leaves open; speeds [rad/s], None: the URDF's own
    notes    what was found and assumed, in words
    """

    urdf: Urdf
    name: str
    tip: str
    outwards: Array
    kind: str
    redundant: str | None
    roughly: bool
    joints: tuple[str, ...]
    ranges: dict[str, tuple[float, float]]
    speeds: tuple[float, ...] | None
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    assumed: tuple[str, ...]
    notes: tuple[str, ...]


def survey(urdf: Urdf, tip: str | None, named: bool = True) -> Survey:
    """Read an arm off a URDF; named: whether the tip, if given, is the caller's choice. Raises InputError if it finds
    no arm, or none that can be planned with."""
    named = named and tip is not None
    ways = _arms(urdf)
    if tip is None:
        tip = _flange(urdf, ways)
    elif tip not in urdf.links():
        near = nearest_name(tip, urdf.links())
        raise InputError(f"no link {tip!r}", file=urdf.path, hint=f"did you mean {near}?" if near else None)
    joints = moving_joints(urdf, tip)
    for joint in joints:
        if joint.get("type") == "prismatic":
            raise urdf.error(joint, f"joint {joint.get('name')}", "slides, but those of an arm turn", _CARRIED)
    ranges, slow = _left_open(joints)
    model = model_of(urdf, tip, dict.fromkeys(ranges, (-np.pi, np.pi)), bool(slow))
    chain = base_to_tip(model, tip)
    kind, redundant, roughly = _kind(urdf, chain, named)
    own = [float(speed) for speed in model.velocityLimit]
    speeds = [ASSUMED_SPEED if name in slow else speed for name, speed in zip(chain.names, own, strict=True)]
    acceleration = tuple(_round(speed / RISE) for speed in speeds)
    outwards = _outwards(chain)
    notes = [
        f"flange: link {tip}{'' if named else ', found by its name and place'}; "
        + (
            "its z points out of it"
            if outwards[2] > ALONG
            else f"the last axis leaves it along {np.round(outwards, 3) + 0.0}: nozzle.axis of a problem is that, not [0, 0, 1]"
        ),
        f"base: link {next(iter(_bases(urdf)))}, the frame that problems refer to",
    ]
    if ranges:
        notes.append(f"assumed: {', '.join(ranges)} without limits turn {ASSUMED_TURN:g} degrees either way")
    if slow:
        notes.append(f"assumed: {', '.join(slow)}, for which the URDF gives no speed, {ASSUMED_SPEED} rad/s")
    notes.append(
        f"assumed: joints reach their speed in {RISE} s, with a jerk of {JERK:g} times that acceleration a second"
    )
    return Survey(
        urdf=urdf,
        name=urdf.root.get("name") or urdf.path.stem,
        tip=tip,
        outwards=outwards,
        kind=kind,
        redundant=redundant,
        roughly=roughly,
        joints=chain.names,
        ranges=dict.fromkeys(ranges, (-ASSUMED_TURN, ASSUMED_TURN)),
        speeds=tuple(speeds) if slow else None,
        acceleration=acceleration,
        jerk=tuple(_round(JERK * value) for value in acceleration),
        assumed=(
            "acceleration_rad_s2",
            "jerk_rad_s3",
            *(["speed_rad_s"] if slow else []),
            *(["range_deg"] if ranges else []),
        ),
        notes=tuple(notes),
    )


def _bases(urdf: Urdf) -> list[str]:
    hanging = {joint.find("child").get("link") for joint in urdf.root.findall("joint")}  # type: ignore[union-attr]
    return [name for name in urdf.links() if name not in hanging]


def _arms(urdf: Urdf) -> dict[str, int]:
    """Number of joints that lead to each link, for links whose joints all turn, each by its own motor."""
    found = {}
    for link in urdf.links():
        moving = moving_joints(urdf, link)
        if all(joint.get("type") in ("revolute", "continuous") and joint.find("mimic") is None for joint in moving):
            found[link] = len(moving)
    return found


def _flange(urdf: Urdf, ways: dict[str, int]) -> str:
    """The link that is the flange: behind six or seven joints, preferably one with a flange's name."""
    arms = [link for link, count in ways.items() if count in AXES]
    most = max(ways.values(), default=0)
    if not arms:
        many = ", ".join(f"{count} to {link}" for link, count in list(ways.items())[-3:])
        raise InputError(
            f"no arm of six or seven axes: {many}",
            file=urdf.path,
            hint=_CARRIED if _is_carried(urdf) else "only arms with a closed-form inverse can be planned with",
        )
    named = [link for link in arms if is_flange(link)]
    if named:
        most_axes = max(ways[link] for link in named)
        named = [link for link in named if ways[link] == most_axes]
        if len({moved_by(urdf, link) for link in named}) > 1:
            raise InputError(f"several arms: {', '.join(named)}", file=urdf.path, hint="choose one with --tip")
        # of several frames of one flange, prefer one whose z points out of it: others may be turned
        return min(named, key=lambda link: (_outwards(_chain(urdf, link))[2] < ALONG, _rank(link), len(link)))
    if most > max(AXES):
        raise InputError(
            f"{most} joints in a row, and no link is named as a flange",
            file=urdf.path,
            hint=f"choose one with --tip: {', '.join(arms)}",
        )
    count = max(ways[link] for link in arms)
    last = [link for link in arms if ways[link] == count]
    carried = [link for link in last if joints_to(urdf, link)[-1].get("type") != "fixed"]
    if len(carried) > 1:
        raise InputError(f"several arms end in {', '.join(carried)}", file=urdf.path, hint="choose one with --tip")
    return carried[0]


def _is_carried(urdf: Urdf) -> bool:
    """Whether a link hangs on as many turning joints as an arm has, and on a sliding one as well."""
    ways = ([joint.get("type") for joint in moving_joints(urdf, link)] for link in urdf.links())
    return any("prismatic" in way and sum(kind != "prismatic" for kind in way) in AXES for way in ways)


def is_flange(link: str) -> bool:
    """Whether a link is named as a flange."""
    return _rank(link) < len(FLANGES)


def _rank(link: str) -> int:
    """Rank of a link's name among those of flanges: its index in FLANGES, or their number if it is none of them."""
    return next((k for k, name in enumerate(FLANGES) if re.fullmatch(rf"(.*[_/-])?{name}", link)), len(FLANGES))


def _chain(urdf: Urdf, link: str) -> Chain:
    """The chain to a link, whatever its joints' limits leave open."""
    open_, _ = _left_open(moving_joints(urdf, link))
    return base_to_tip(model_of(urdf, link, dict.fromkeys(open_, (-np.pi, np.pi)), True), link)


def _left_open(joints: Sequence[ET.Element]) -> tuple[list[str], list[str]]:
    """Names of the joints without end stops, and of those without a speed."""
    open_, slow = [], []
    for joint in joints:
        limit, name = joint.find("limit"), joint.get("name", "")
        if joint.get("type") == "continuous" or limit is None or not _has_ends(limit):
            open_.append(name)
        if limit is None or not _positive(limit.get("velocity")):
            slow.append(name)
    return open_, slow


def _has_ends(limit: ET.Element) -> bool:
    """Whether a limit gives a usable range: not empty, as in CAD exports, nor wider than any cable allows."""
    try:
        apart = abs(float(limit.get("upper", "nan")) - float(limit.get("lower", "nan")))
    except ValueError:
        return True  # a bad number is reported where it is read
    return 0.0 < apart <= _MOST_APART


def _positive(text: str | None) -> bool:
    try:
        return text is not None and float(text) > 0.0
    except ValueError:
        return False


def _kind(urdf: Urdf, chain: Chain, named: bool) -> tuple[str, str | None, bool]:
    """An arm's kind of inverse kinematics, its redundant joint, and whether it is only roughly of that kind; for any
    other arm, InputError with what it lacks for each kind. named: whether the flange is the caller's choice."""
    lacking = []
    if len(chain) == 7:
        for near, joint in product((NEAR, FAR), (2, 6)):
            try:
                read_seven_axes(chain, joint, near)
                return "seven_axes", chain.names[joint], near == FAR
            except OtherGeometry as error:
                if near == FAR:
                    lacking.append(f"seven_axes with {chain.names[joint]}: {error}")
    else:
        kinds: tuple[tuple[str, Callable[[Chain], object]], ...] = (
            ("spherical_wrist", read_spherical_wrist),
            ("offset_wrist", read_offset_wrist),
            ("skew_wrist", read_skew_wrist),
        )
        for name, read in kinds:
            try:
                read(chain)
                return name, None, False
            except OtherGeometry as error:
                lacking.append(f"{name}: {error}")
    if len(chain) == max(AXES) and not named:
        lacking.insert(0, f"give the flange with --tip, if {chain.names[-1]} belongs to a gripper, not to the arm")
    raise InputError("no inverse kinematics known here fits this arm", file=urdf.path, hint="; ".join(lacking))


def _outwards(chain: Chain) -> Array:
    """The direction (3) of the last axis in the tip's frame, away from the arm."""
    axis = chain.T_last_tip[:3, :3].T @ chain.axes[-1, :3]
    side = axis[int(np.argmax(np.abs(axis)))]
    if abs(axis[2]) > 0.9:
        side = axis[2]
    elif abs(along := float(chain.T_last_tip[:3, 3] @ chain.axes[-1, :3])) > 1e-3:
        side = along
    return np.asarray(np.sign(side) * axis)


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def key_of(name: str) -> str:
    """A file name made from a robot's name."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", name).strip("_").lower() or "my_robot"


def expanded(path: Path, arguments: Mapping[str, str]) -> str:
    """The URDF text that xacro makes from a file and its arguments; packages are searched for around the file. Raises
    ImportError without xacrodoc, InputError for what xacro rejects and for arguments that the file does not have."""
    import xacro  # with xacrodoc, an extra
    from xacrodoc import XacroDoc, packages

    folder = path.resolve().parent
    while not (folder / "package.xml").is_file() and folder != folder.parent:
        folder = folder.parent
    around = folder.parent if (folder / "package.xml").is_file() else path.resolve().parent
    before = len(xacro.all_includes)
    try:
        packages.look_in([str(around)])
        given = {**_of_root(path), **arguments}
        made = XacroDoc.from_file(str(path), subargs=given, resolve_packages=False)
        text = str(made.to_urdf_string())
    except (xacro.XacroException, ExpatError, OSError, ValueError, RuntimeError) as error:
        words = " ".join(str(error).split())[:300]
        known = _arguments_in([path]) if path.is_file() else []
        if known and (not arguments or "Undefined substitution argument" in words):
            some = ", ".join([*known[:_TOLD], *("…" for _ in known[_TOLD : _TOLD + 1])])
            words += f"; the file has {some}: give them after it, as in {known[0]}:=…"
        raise InputError("xacro rejects it", file=path, hint=words) from None
    known = _arguments_in([path, *map(Path, xacro.all_includes[before:])])  # xacro ignores others
    for name in arguments:
        if name not in known:
            near = nearest_name(name, known)
            hint = f"did you mean {near}?" if near else f"it has {', '.join(known) or 'none'}"
            raise InputError(f"has no argument {name!r}", file=path, hint=hint)
    if "<link" not in text:
        users = _users_of(path.resolve(), around)
        hint = f"the robot is made by {' or '.join(users[:_USERS])}" if users else "add the file that makes the robot"
        raise InputError("makes no links: it is there for other files to include", file=path, hint=hint)
    return text


def _of_root(path: Path) -> dict[str, str]:
    """Defaults of arguments that the root element uses before they are declared: xacro has not read them by then."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    root = re.search(r"<robot\b[^>]*>", text)
    asked = re.findall(r"\$\(arg\s+(\w+)\)", root[0]) if root else []
    said = {
        match[1]: re.search(r"\bdefault\s*=\s*[\"']([^\"'$]*)[\"']", match[0]) for match in _ARGUMENT.finditer(text)
    }
    return {name: value[1] for name in asked if (value := said.get(name)) is not None}


def _users_of(path: Path, around: Path) -> list[str]:
    """Names of the files around a xacro file that include it, directly or through others, and that no file includes."""
    texts = {
        file: file.read_text(encoding="utf-8", errors="replace")
        for file in sorted(around.rglob("*.xacro"))[:_LOOKED_AT]
    }
    includes = {file: {name.rsplit("/", 1)[-1] for name in re.findall(_INCLUDE, text)} for file, text in texts.items()}
    found, tops, seen = [path], list[Path](), {path}
    while found:
        name = found.pop(0)
        users = [file for file, own in includes.items() if name.name in own and file != name]
        if not users and name != path:
            tops.append(name)
        found += [file for file in users if file not in seen]
        seen.update(users)
    return [file.name for file in tops]


def _arguments_in(files: Iterable[Path]) -> list[str]:
    """Names of the arguments that xacro files declare, in order."""
    found = (re.findall(_ARGUMENT, file.read_text(encoding="utf-8", errors="replace")) for file in files)
    return list(dict.fromkeys(name for names in found for name in names))
