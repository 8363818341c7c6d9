"""Read robots/*.yaml, or the user's own: what a URDF cannot say, each value with its place in the file."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.problem.settings import LANGUAGE_NAMES, USUAL_LANGUAGE
from planner.problem.yaml_file import Keys, ValueSources, read_yaml_file

LENGTHS = tuple(f"{name}_mm" for name in ("a1", "a2", "b", "c1", "c2", "c3", "c4"))  # of an arm with a spherical wrist
MOST_PIECES = 12  # into which a link's mesh is cut
COLOUR = "#[0-9a-fA-F]{6}"
KINDS = ("spherical_wrist", "offset_wrist", "skew_wrist", "seven_axes")

# Measured behaviour of a controller: the field of its model, least and greatest value in the file, and the unit in SI.
CONTROLLER = {
    "lag_ms": ("lag", 0.0, 300.0, 1e-3),
    "zone_share": ("depth", 0.0, 2.0, 1.0),
    "ramp_ms": ("ramp", 1.0, 2000.0, 1e-3),
    "ahead_moves": ("ahead_moves", 1.0, 1000.0, 1.0),
}


@dataclass(frozen=True)
class RobotKey:
    """A key of a robot's file: what it is, its default in words (empty if it is required), and an example."""

    text: str
    example: str
    default: str = ""
    schema: Mapping[str, Any] = field(default_factory=dict)

    @property
    def required(self) -> bool:
        """Whether every robot has it."""
        return not self.default


_POSITIVE = {"type": "array", "items": {"type": "number", "exclusiveMinimum": 0}, "minItems": 1}
_NAMES = {"type": "array", "items": {"type": "string"}}
_TEXT = {"type": "string", "minLength": 1}
_RANGES = {
    "type": "object",
    "additionalProperties": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2},
}
KEYS = {
    "name": RobotKey("maker and type, as reports call it", "ABB IRB 140-6/0.8", schema=_TEXT),
    "urdf": RobotKey(
        "the URDF: a file beside this one, or a package and a path in its shared files",
        "irb140.urdf",
        schema={
            "anyOf": [
                _TEXT,
                {
                    "type": "object",
                    "properties": {"package": _TEXT, "path": _TEXT},
                    "required": ["package", "path"],
                    "additionalProperties": False,
                },
            ]
        },
    ),
    "tip": RobotKey("link of the URDF that is the flange: its z points out of it", "tool0", schema=_TEXT),
    "acceleration_rad_s2": RobotKey(
        "greatest acceleration of each joint, base first [rad/s²; m/s² where it slides]",
        "[15, 15, 15, 25, 25, 30]",
        schema=_POSITIVE,
    ),
    "jerk_rad_s3": RobotKey(
        "greatest jerk of each joint, base first [rad/s³; m/s³ where it slides]",
        "[750, 750, 750, 1250, 1250, 1500]",
        schema=_POSITIVE,
    ),
    "language": RobotKey(
        "what its controller is programmed in", "rapid", USUAL_LANGUAGE, {"enum": list(LANGUAGE_NAMES)}
    ),
    "speed_rad_s": RobotKey(
        "greatest speed of each joint, base first [rad/s; m/s where it slides]",
        "[3.5, 3.5, 4.5, 6, 6, 7]",
        "the URDF's",
        _POSITIVE,
    ),
    "range_deg": RobotKey(
        "least and greatest angle of joints by name, in place of the URDF's [deg]",
        "{joint_6: [-400, 400]}",
        "the URDF's",
        _RANGES,
    ),
    "range_mm": RobotKey(
        "least and greatest place of joints that slide, by name, in place of the URDF's [mm]",
        "{rail: [0, 3000]}",
        "the URDF's",
        _RANGES,
    ),
    "without": RobotKey(
        "links of the URDF that are left out, with all that hangs on them except the arm", "[hand]", "none", _NAMES
    ),
    "pieces": RobotKey(
        f"by link, how many convex pieces its meshes are cut into, {MOST_PIECES} at most; "
        "otherwise a bent link's hull fills its bend",
        "{link_3: 4}",
        "one hull for each mesh",
        {"type": "object", "additionalProperties": {"type": "integer", "minimum": 1, "maximum": MOST_PIECES}},
    ),
    "may_touch": RobotKey(
        "pairs of links that may touch, besides neighbours: the real links never touch, or always do",
        "[[link_4, link_6]]",
        "none",
        {"type": "array", "items": {**_NAMES, "minItems": 2, "maxItems": 2}},
    ),
    "colours": RobotKey(
        "colours of links, or of their shapes, by name, in pictures; `others` for all that are not named, `caps` for "
        "covers on joints",
        '{others: "#f47a20", link_6: "#6b7178"}',
        "those of the URDF’s materials and meshes, or grey",
        {"type": "object", "additionalProperties": {"type": "string", "pattern": f"^{COLOUR}$"}},
    ),
    "assumed": RobotKey(
        "keys of this file whose values nobody has published; listings and the checks say so",
        "[jerk_rad_s3]",
        "nothing",
        _NAMES,
    ),
    "measured": RobotKey(
        "which of this file's limits were measured, and from what; listings say so",
        "acceleration_rad_s2 of joint_1 from run.csv",
        "nothing",
        _TEXT,
    ),
    "controller": RobotKey(
        "what its controller was measured to do, for forecasts: lag_ms by which the arm follows, zone_share of their parabolas "
        "by which zones are cut, ramp_ms from rest to 1 m/s, ahead_moves that it knows",
        "{lag_ms: 19.7, zone_share: 0.87, ramp_ms: 180}",
        "the model of its language's controller",
        {
            "type": "object",
            "properties": {
                name: {"type": "number", "minimum": low, "maximum": high}
                for name, (_, low, high, _) in CONTROLLER.items()
            },
            "additionalProperties": False,
        },
    ),
    "spherical_wrist": RobotKey(
        "for an arm whose last three axes meet, its joints counted from upper arm upright and forearm level: its seven "
        "lengths [mm], named as by Brandstötter et al. (OPW), checked against the URDF; in place of inverse_kinematics",
        "{a1_mm: 70, a2_mm: 0, b_mm: 0, c1_mm: 352, c2_mm: 360, c3_mm: 380, c4_mm: 65}",
        "none",
        {
            "type": "object",
            "properties": {name: {"type": "number"} for name in LENGTHS},
            "required": list(LENGTHS),
            "additionalProperties": False,
        },
    ),
    "inverse_kinematics": RobotKey(
        f"the kind of arm, whose lengths, zero and senses of axes are read off the URDF: {', '.join(KINDS)}; a robot "
        "with neither this nor spherical_wrist only holds parts or carries an arm",
        "offset_wrist",
        "none",
        {"enum": list(KINDS)},
    ),
    "redundant_joint": RobotKey(
        "for seven_axes: the joint whose angle is chosen, so that the other six follow", "joint_3", "none", _TEXT
    ),
}
REQUIRED = tuple(name for name, key in KEYS.items() if key.required)
OPTIONAL = tuple(name for name, key in KEYS.items() if not key.required)


@dataclass(frozen=True)
class RobotFile:
    """A robot's YAML file as read: its values, and their places in it."""

    path: Path
    data: Mapping[str, Any]
    source: ValueSources

    def error(self, field: str, reason: str, hint: str | None = None) -> InputError:
        """Return the error for a field, with file and line."""
        keys: Keys = (field,)
        line = self.source.line(keys) if field in self.data else None
        return InputError(reason, file=self.path, line=line, field=field, hint=hint)

    def text(self, field: str) -> str:
        """The text of a field."""
        value = self.data[field]
        if not isinstance(value, str) or not value.strip():
            raise self.error(field, "must be text", "quote it if it looks like a number")
        return value

    def texts(self, field: str) -> tuple[str, ...]:
        """The list of texts of a field; empty if it is left out."""
        value = self.data.get(field, ())
        if not isinstance(value, tuple) or not all(isinstance(item, str) for item in value):
            raise self.error(field, "must be a list of names", "for example [hand]")
        return value

    def known(self, field: str, kind: str, name: object, names: Collection[str]) -> None:
        """Raise InputError unless `name` is one of the `names` of a `kind`."""
        if name not in names:
            near = nearest_name(str(name), names)
            hint = f"did you mean {near}?" if near else f"{kind}s: {', '.join(names)}"
            raise self.error(field, f"no {kind} {name!r}", hint)

    def of_these(self, field: str, kind: str, names: Collection[str]) -> tuple[str, ...]:
        """The list of a field, all of it among the `names` of a `kind`; empty if it is left out."""
        given = self.texts(field)
        for name in given:
            self.known(field, kind, name, names)
        return given

    def pieces(self, links: Collection[str]) -> dict[str, int]:
        """Numbers of convex pieces by link; empty if the key is left out."""
        given = self.data.get("pieces", {})
        if not isinstance(given, dict):
            raise self.error("pieces", "must be numbers by link", "for example {link_3: 4}")
        for name, count in given.items():
            self.known("pieces", "link", name, links)
            if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_PIECES:
                raise self.error("pieces", f"{name} must have a whole number of pieces", f"1 to {MOST_PIECES}")
        return given

    def colours(self, names: Collection[str]) -> dict[str, str]:
        """Colours by name of link or shape, `others` or `caps`; empty if the key is left out."""
        given = self.data.get("colours", {})
        if not isinstance(given, dict):
            raise self.error("colours", "must be colours by link or shape", 'for example {others: "#f47a20"}')
        for name, colour in given.items():
            self.known("colours", "link or shape", name, names)
            if not isinstance(colour, str) or not re.fullmatch(COLOUR, colour):
                raise self.error("colours", f'{name} must have a colour such as "#f47a20"', "in quotes, six hex digits")
        return given

    def controller(self) -> tuple[tuple[str, float], ...]:
        """The controller's measured behaviour: fields of its model and values [SI]; empty if the key is left out."""
        given = self.data.get("controller", {})
        if not isinstance(given, dict):
            raise self.error("controller", "must be values by name", "for example {lag_ms: 19.7}")
        out = []
        for name, value in given.items():
            self.known("controller", "value", name, CONTROLLER)
            field, low, high, unit = CONTROLLER[name]
            if not is_number(value) or not low <= value <= high:
                raise self.error("controller", f"{name} must be a number", f"{low:g} to {high:g}")
            if field == "ahead_moves" and value != int(value):
                raise self.error("controller", f"{name} must be a whole number", f"{low:g} to {high:g}")
            out.append((field, float(value) * unit))
        return tuple(out)

    def link_pairs(self, links: Collection[str]) -> tuple[tuple[str, str], ...]:
        """Pairs of links that may touch; empty if the key is left out."""
        given = self.data.get("may_touch", ())
        if not isinstance(given, tuple) or not all(isinstance(pair, tuple) and len(pair) == 2 for pair in given):
            raise self.error("may_touch", "must be pairs of links", "for example [[link_4, link_6]]")
        for name in (name for pair in given for name in pair):
            self.known("may_touch", "link", name, links)
        return given

    def numbers(self, field: str, count: int) -> Array:
        """The positive numbers (count) of a field."""
        value = self.data[field]
        right = isinstance(value, tuple) and all(is_number(v) and 0.0 < v < math.inf for v in value)
        if not right or len(value) != count:
            raise self.error(field, f"must be a list of {count} positive numbers", "one for each joint, base first")
        return np.array([float(v) for v in value])

    def ranges(self, joints: Collection[str], sliding: Collection[str]) -> dict[str, tuple[float, float]]:
        """Ranges by joint that replace the URDF's [rad, or m for the sliding joints]."""
        turning = [name for name in joints if name not in sliding]
        angles = self._pairs("range_deg", "angle", "{joint_6: [-400, 400]}", turning)
        places = self._pairs("range_mm", "place", "{rail: [0, 3000]}", sliding)
        return {name: (math.radians(low), math.radians(high)) for name, (low, high) in angles.items()} | {
            name: (low * 1e-3, high * 1e-3) for name, (low, high) in places.items()
        }

    def _pairs(self, field: str, what: str, example: str, joints: Collection[str]) -> dict[str, tuple[float, float]]:
        given = self.data.get(field, {})
        if not isinstance(given, dict):
            raise self.error(field, "must be ranges by joint", f"for example {example}")
        for name, pair in given.items():
            self.known(field, "joint", name, joints)
            right = isinstance(pair, tuple) and len(pair) == 2 and all(is_number(v) and math.isfinite(v) for v in pair)
            if not right or not pair[0] < pair[1]:
                reason = f"{name} must have a least and a greatest {what}"
                raise self.error(field, reason, f"for example {example[example.index('[') : -1]}")
        return given

    def urdf(self) -> Path:
        """Path of the robot's URDF: relative to its YAML file, or `path` in an installed `package`'s shared files."""
        urdf = self.data["urdf"]
        if isinstance(urdf, str):
            path, hint = self.path.parent / urdf, "relative to the robot's file"
        elif isinstance(urdf, Mapping) and set(urdf) == {"package", "path"}:
            package = str(urdf["package"])
            try:
                found = metadata.distribution(package)
            except metadata.PackageNotFoundError:
                hint = f"pip install {package}"
                raise self.error("urdf", f"package {package} is not installed", hint) from None
            # wheels made by cmeel keep what belongs under /usr in a folder of their own, and have no module to import
            path = Path(str(found.locate_file("cmeel.prefix"))) / "share" / package / str(urdf["path"])
            hint = f"relative to share/{package} of {package} {found.version}"
        else:
            raise self.error("urdf", "must be a file name, or a package and a path", "for example arm.urdf")
        if not path.is_file():
            raise self.error("urdf", f"no file {path.name}", hint)
        return path


def read_robot_file(path: Path) -> RobotFile:
    """Read a robot's YAML file. Raises InputError for unknown and missing keys, and for invalid YAML."""
    data, source = read_yaml_file(path, "a robot has name, urdf and tip; see robots/irb140.yaml")
    file = RobotFile(path, data, source)
    for key in data:
        if key not in REQUIRED + OPTIONAL:
            near = nearest_name(key, REQUIRED + OPTIONAL)
            hint = f"did you mean {near}?" if near else f"known keys: {', '.join(REQUIRED + OPTIONAL)}"
            raise file.error(key, "unknown key", hint)
    for key in REQUIRED:
        if key not in data:
            raise file.error(key, "is missing")
    return file


def is_number(value: object) -> bool:
    """Whether a value is a number, and not a boolean."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
