"""The questions of `python -m planner.new`, at a terminal or through a pipe; every answer is checked at once."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError
from rich.console import Console
from rich.markup import escape
from rich.prompt import InvalidResponse, PromptBase

from planner.base.arrays import Array
from planner.base.errors import InputError, nearest_name
from planner.base.files import read_text
from planner.base.shipped import ROBOTS
from planner.cell.robot import Robot, read_robot, shipped_robots
from planner.new.posture import reached, usual_place
from planner.problem import Problem
from planner.problem.cell import CellSpec, NozzleSpec, PositionerSpec
from planner.problem.drawings import LayersSpec, PatternSpec, SvgSpec
from planner.problem.fields import Model, described, identifier, in_words, read_value
from planner.problem.layers import AerofoilSpec
from planner.problem.mesh_files import read_corners
from planner.problem.part import CylinderSpec, SphereSpec
from planner.problem.process import BeadSpec, ProcessSpec
from planner.robots.listing import reach
from planner.toolpath.dxf.reader import read_drawing
from planner.toolpath.gcode.reader import text_of
from planner.toolpath.svg.document import read_document
from planner.toolpath.svg.drawing import Drawing

# ----------------------------------------------------------------------------------------------------
# Asking, at a terminal or through a pipe: every answer is checked at once.

Check = Callable[[str], Any]  # text → answer; raises ValueError with a readable reason


class _Prompt(PromptBase[Any]):
    """A question whose answer is what its check returns for the text."""

    response_type = str
    prompt_suffix = " "
    check: Check = str

    def process_response(self, value: str) -> Any:
        """Return the checked answer; ask again if the check refuses it."""
        try:
            return self.check(value.strip())
        except ValueError as error:
            raise InvalidResponse(f"[prompt.invalid]{escape(str(error))}") from None


@dataclass(frozen=True)
class Asker:
    """Asks on a console; with `take_defaults`, every question takes its default unasked.

    At a terminal, a wrong answer is reported and the question asked again. In a pipe it ends the command, because the
    lines after it answer other questions.
    """

    console: Console
    take_defaults: bool = False

    def __call__(self, question: str, default: str, check: Check) -> Any:
        """The answer to a question; an empty answer takes the default, and is refused if the default is empty.

        Raises InputError for a wrong answer from a pipe, KeyboardInterrupt if the input ends.
        """
        if self.take_defaults:
            return check(default)
        try:
            return self._ask(question, default, check)
        except EOFError:
            raise KeyboardInterrupt from None

    def _ask(self, question: str, default: str, check: Check) -> Any:
        shown = f"{escape(question)} [prompt.default]({escape(default)})[/]:" if default else f"{escape(question)}:"
        prompt = _Prompt(shown, console=self.console)

        def answered(text: str) -> Any:
            if not text and not default:
                raise ValueError("an answer is needed here")
            return check(text or default)

        prompt.check = answered
        if sys.stdin.isatty():
            return prompt()
        text = prompt.get_input(self.console, prompt.make_prompt(...), False).strip()
        self.console.print()  # nobody has typed a newline
        try:
            return answered(text)
        except ValueError as error:
            raise InputError(f"{text!r}: {error}", field=question) from None


def name_of(kind: str, names: Collection[str] | Mapping[str, str]) -> Check:
    """A check for one of some names."""

    def check(text: str) -> str:
        if text in names:
            return text
        near = nearest_name(text, names)
        meant = f"did you mean {near}? " if near else ""
        raise ValueError(f"no {kind} {text!r}; {meant}choices: {', '.join(names)}")

    return check


def field_of(model: Model, name: str) -> Check:
    """A check for the value of a problem's field, in the file's unit; lists with or without brackets."""
    return lambda text: read_value(described(model)[name], text)


def file_in(folder: Path, read: Callable[[Path], object]) -> Check:
    """A check for a readable file, its path relative to the problem file's folder."""

    def check(text: str) -> str:
        try:
            read(folder / text)
        except InputError as error:
            raise ValueError(str(error)) from None
        return text

    return check


# ----------------------------------------------------------------------------------------------------
# The questions, one after another: which ones are asked depends on the answers so far.

Values = dict[str, Any]

WHAT = {
    "pattern": "a pattern (honeycomb, zigzag, squares, concentric) on a plane or a dome",
    "drawing": "the lines of an SVG drawing, on a plane, a dome or a cylinder",
    "waypoints": "a file of points with normals",
    "gcode": "a slicer's G-code",
    "mesh": "a closed STL file, filled with layers",
    "wing": "a wing in layers parallel to its surfaces",
}
PATTERN_ON, DRAWING_ON = ("plane", "dome"), ("plane", "dome", "cylinder")
DOWN, FORWARDS = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0])
ABOVE = 0.1  # m from the part to the nozzle at home
STAND_MM = 60.0  # height of the stand under a part on a positioner
UNKNOWN_MM = 100.0  # assumed size of a print whose extent only its file knows
WING_ABOVE_MM = 2.7  # height of a wing's lower surface above the bed: two curved layers of support and some level ones
_LARGEST_WAYPOINTS = 500_000_000  # bytes; the file is read only to see whether it is text


@dataclass(frozen=True)
class Answers:
    """All answers, in the file's units; the keys of `values` are this module's own, see `problem_text`."""

    name: str
    arm: Robot
    holder: str
    what: str
    values: Values = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:
        return self.values[key]


def answers_to(ask: Asker, file: Path, name: str) -> Answers:
    """Ask for everything a problem needs."""
    given: Values = {}

    def value(key: str, question: str, default: str, check: Check) -> Any:
        given[key] = ask(question, default, check)
        return given[key]

    def choose(question: str, kinds: Mapping[str, str], default: str) -> str:
        for word, text in () if ask.take_defaults else kinds.items():
            ask.console.print(f"  {word:<12} {text}", style="dim", highlight=False, markup=False, soft_wrap=True)
        return str(ask(question, default, name_of("choice", kinds)))

    name = ask("name of the problem: a letter, then letters, digits or _", name, _identifier)
    robot = read_robot(ROBOTS / f"{choose('arm', shipped_robots(arms=True), 'irb140')}.yaml")
    value("tip_mm", "nozzle tip in the flange frame, x y z [mm]", "0 0 150", field_of(NozzleSpec, "tip"))
    value("diameter_mm", "bore of the nozzle [mm]", "0.6", field_of(NozzleSpec, "diameter"))
    # robots with sliding joints are not offered for this
    others = shipped_robots(arms=False).items()
    turning = {key: name for key, name in others if not any(read_robot(ROBOTS / f"{key}.yaml").slides)}
    holders = {"bed": "a fixed bed"} | turning
    holder = choose("what holds the part", holders, "bed")
    what = choose("what is printed", WHAT, "pattern")
    SOURCES[what](value, file.parent)
    if what not in ("waypoints", "gcode"):
        value("height_mm", "height of a layer [mm]", "0.4", field_of(LayersSpec, "height"))
    value("width_mm", "width of a bead [mm]", "0.6", field_of(BeadSpec, "width"))
    if what == "waypoints":
        value("height_mm", "height of a bead [mm]", "0.4", field_of(BeadSpec, "height"))
    if what in ("pattern", "drawing"):
        value("count", "number of layers", "2", field_of(LayersSpec, "count"))
    value("speed_mm_s", "speed of the nozzle while printing [mm/s]", "20", field_of(ProcessSpec, "speed"))
    _place(value, robot, holder, given)
    return Answers(name, robot, holder, what, given)


def _identifier(text: str) -> str:
    try:
        return identifier(field_of(Problem, "name")(text))
    except PydanticCustomError as error:
        raise ValueError(in_words(error)) from None


def _pattern(value: Callable[..., Any], folder: Path) -> None:
    kinds = ("honeycomb", "zigzag", "squares", "concentric")
    value("pattern", f"pattern: {', '.join(kinds)}", "honeycomb", name_of("pattern", kinds))
    value("cell_mm", "width of a cell, or distance between lines [mm]", "10", field_of(PatternSpec, "cell"))
    value("size_mm", "size of the pattern, x y [mm]", "40 40", field_of(PatternSpec, "size"))
    _body(value, PATTERN_ON)


def _read_drawing(path: Path) -> object:
    if path.suffix.lower() == ".dxf":
        return read_drawing(path, _plainly)
    return Drawing(read_document(path, _plainly)).outlines()


def _drawing(value: Callable[..., Any], folder: Path) -> None:
    value("file", "the drawing, an SVG or DXF file", "", file_in(folder, _read_drawing))
    value("svg_width_mm", "width of the drawing on the part [mm]", "60", field_of(SvgSpec, "width"))
    _body(value, DRAWING_ON)


def _body(value: Callable[..., Any], kinds: tuple[str, ...]) -> None:
    """Ask for the body to print on."""
    body = value("body", f"printed on: {', '.join(kinds)}", "plane", name_of("body", kinds))
    if body == "dome":
        value("radius_mm", "radius of the dome, a half ball [mm]", "60", field_of(SphereSpec, "radius"))
    if body == "cylinder":
        value("radius_mm", "radius of the upright cylinder [mm]", "35", field_of(CylinderSpec, "radius"))
        value("body_height_mm", "its height [mm]", "100", field_of(CylinderSpec, "height"))


def _waypoints(value: Callable[..., Any], folder: Path) -> None:
    value("file", "the file: lines x y z nx ny nz, or columns of these names", "", file_in(folder, _is_there))


def _gcode(value: Callable[..., Any], folder: Path) -> None:
    value("file", "the G-code", "", file_in(folder, lambda path: text_of(path, _plainly)))


def _mesh(value: Callable[..., Any], folder: Path) -> None:
    value("file", "the closed STL file, in mm", "", file_in(folder, lambda path: read_corners(path, _plainly)))


def _wing(value: Callable[..., Any], folder: Path) -> None:
    value("naca", "four-digit NACA section", "0015", _naca)
    value("chord_mm", "length of its chord [mm]", "60", field_of(AerofoilSpec, "chord"))
    value("span_mm", "its span [mm]", "15", field_of(AerofoilSpec, "span"))


SOURCES: dict[str, Callable[[Callable[..., Any], Path], None]] = {
    "pattern": _pattern,
    "drawing": _drawing,
    "waypoints": _waypoints,
    "gcode": _gcode,
    "mesh": _mesh,
    "wing": _wing,
}


def _place(value: Callable[..., Any], robot: Robot, holder: str, given: Values) -> None:
    """Ask where the part stands and find the arm's postures above it; a place out of reach is asked for again."""
    tip = np.asarray(given["tip_mm"]) * 1e-3
    points, axis = corners(given)
    stand = np.array([0.0, 0.0, 0.0 if holder == "bed" else STAND_MM * 1e-3])
    usual = usual_place(robot, tip, points + stand, axis, reach(robot) or 0.0)
    if usual is None:
        raise InputError(
            f"there is no place from which {robot.key} reaches all of the part", hint="make the part smaller"
        )
    spec, name = (CellSpec, "bed") if holder == "bed" else (PositionerSpec, "origin")

    def check(text: str) -> Any:
        place = field_of(spec, name)(text)
        found = reached(robot, tip, np.asarray(place) * 1e-3 + stand + points, axis)
        if not found.worth > 0.0:
            raise ValueError(f"{robot.key} does not reach all of the part there; {_words(usual)} would do")
        given["homes_deg"] = (np.round(np.degrees(found.postures), 1) + 0.0).tolist()
        return place

    where = "origin of the part frame on the bed" if holder == "bed" else "centre of the positioner's plate"
    value("place_mm", f"{where}, x y z from the arm's base [mm]", _words(usual), check)


def corners(given: Mapping[str, Any]) -> tuple[Array, Array]:
    """Points (k, 3) [m] that the nozzle has to reach, in the part frame, home first; and the nozzle axis there."""
    if given.get("body") == "cylinder":
        # the line of its wall nearest to the arm: a table turns the rest there; on a bed it stands for the near side
        radius, high = given["radius_mm"] * 1e-3, given["body_height_mm"] * 1e-3
        return np.array(
            [[-radius - ABOVE, 0.0, high / 2], [-radius, 0.0, 0.2 * high], [-radius, 0.0, 0.8 * high]]
        ), FORWARDS
    width, length, high = extent_mm(given)
    near = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    points = near * np.array([width, length, high]) * 1e-3
    return np.vstack([[0.0, 0.0, high * 1e-3 + ABOVE], points]), DOWN


def extent_mm(given: Mapping[str, Any]) -> tuple[float, float, float]:
    """Size of the print [mm]: along x and y, centred on the part frame's z axis, and its height above the origin."""
    if "size_mm" in given or "svg_width_mm" in given:
        width, length = given.get("size_mm") or (given["svg_width_mm"], given["svg_width_mm"])
        return width, length, given.get("radius_mm", 0.0)
    if "chord_mm" in given:
        return 3.0 * given["chord_mm"], given["span_mm"], 0.3 * given["chord_mm"]
    return UNKNOWN_MM, UNKNOWN_MM, 0.3 * UNKNOWN_MM


def _words(place: Array) -> str:
    return " ".join(f"{value * 1e3:g}" for value in place)


def _naca(text: str) -> str:
    digits = text.strip("'\"")
    if len(digits) != 4 or not digits.isdecimal() or digits.endswith("00"):
        raise ValueError(f"{text!r} is not a four-digit section, for example 0015")
    return digits


def _is_there(path: Path) -> None:
    with_text = path.suffix.lower() != ".npz"
    if with_text:
        read_text(path, _LARGEST_WAYPOINTS, _plainly)
    elif not path.is_file():
        raise _plainly(f"there is no file {path}")


def _plainly(reason: str, hint: str | None = None) -> InputError:
    return InputError(reason, hint=hint)
