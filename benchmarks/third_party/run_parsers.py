"""Reads files with one installed parser, in the environment of `make third-party`; prints a JSON object.

python run_parsers.py TOOL FILE ...

accepted  whether it takes all files; said: what it remarks; version: its own
filament  what it counts of filament [mm], time [s]; where it counts them
"""

from __future__ import annotations

import json
import sys
import warnings
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

INDENTATION = 4  # of the RAPID programs
Told = dict[str, Any]


def rapidchecker(files: list[Path]) -> Told:
    """Grammar of RAPID, and its layout."""
    from rapidchecker import check, config, whitespace_checks

    config.CONFIG.indentation_size = INDENTATION
    said = []
    for file in files:
        text = file.read_text(encoding="utf-8")
        said += [str(each) for each in (*check.check_format(text), *whitespace_checks.check_whitespace(text))]
    return {"accepted": not said, "said": _few(said)}


def krllint(files: list[Path]) -> Told:
    """Keywords, blocks and layout of KRL; its remarks on how far lines are indented are a matter of style."""
    from krllint import config
    from krllint.linter import Linter
    from krllint.reporter import TextReporter

    said: list[str] = []

    class Reporter(TextReporter):
        """Keeps what is found, and prints nothing."""

        def handle_new_file(self) -> None:
            """No heading."""

        def handle_message(self, message: Any) -> None:
            said.append(f"{message.line_number}: {message.message}")

        def finalize(self) -> None:
            """No sum."""

    keys = {key: value for key, value in vars(config).items() if key.isupper()}
    settings = SimpleNamespace(**keys | {"REPORTER": Reporter, "DISABLE": ["bad-indentation"]})
    asked = SimpleNamespace(target=[str(file) for file in files], fix=False, generate_config=False)
    Linter(asked, settings).lint()
    return {"accepted": not said, "said": _few(said)}


def rosbags(files: list[Path]) -> Told:
    """ROS 2's own definition of the message: into its wire format, and back."""
    import numpy as np
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds, name = store.types, "trajectory_msgs/msg/JointTrajectory"
    point, duration = kinds["trajectory_msgs/msg/JointTrajectoryPoint"], kinds["builtin_interfaces/msg/Duration"]
    data = json.loads(files[0].read_text(encoding="utf-8"))
    stamp = kinds["builtin_interfaces/msg/Time"](**data["header"]["stamp"])
    head = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=data["header"]["frame_id"])
    fields = ("positions", "velocities", "accelerations", "effort")
    points = [
        point(**{key: np.array(p[key], float) for key in fields}, time_from_start=duration(**p["time_from_start"]))
        for p in data["points"]
    ]
    sent = store.serialize_cdr(kinds[name](header=head, joint_names=data["joint_names"], points=points), name)
    back = store.deserialize_cdr(sent, name)
    same = [list(p.positions) for p in back.points] == [p["positions"] for p in data["points"]]
    last = back.points[-1].time_from_start
    said = f"{len(back.points)} points in {len(sent)} bytes" if same else "comes back otherwise than it was sent"
    return {"accepted": same, "said": said, "time": last.sec + 1e-9 * last.nanosec}


def tree_sitter_gcode(files: list[Path]) -> Told:
    """A grammar of G-code in general."""
    import tree_sitter_gcode as grammar
    from tree_sitter import Language, Parser

    said = []
    for file in files:
        tree = Parser(Language(grammar.language())).parse(file.read_bytes())
        waiting = [tree.root_node] if tree.root_node.has_error else []
        while waiting:
            node = waiting.pop()
            if node.is_error or node.is_missing:
                said.append(f"{node.start_point[0] + 1}: {(node.text or b'').decode()[:40]}")
            waiting += [child for child in node.children if child.has_error or child.is_missing]
    return {"accepted": not said, "said": _few(said)}


def pygcode(files: list[Path]) -> Told:
    """G-code word by word, as NIST's interpreter knows it; filament is counted where E is relative."""
    import pygcode as theirs

    said, filament = [], 0.0
    for file in files:
        for number, text in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
            try:
                words = theirs.Line(text).block.words
            except Exception as error:  # whatever it raises is its answer
                said.append(f"{number}: {error}")
                continue
            filament += sum(float(word.value) for word in words if word.letter == "E")
    return {"accepted": not said, "said": _few(said), "filament": filament}


def lxml(files: list[Path]) -> Told:
    """Whether XML is well formed: libxml2."""
    from lxml import etree

    said = []
    for file in files:
        try:
            etree.parse(str(file))
        except etree.XMLSyntaxError as error:
            said.append(f"{file.name}: {error}")
    return {"accepted": not said, "said": _few(said)}


TOOLS = {each.__name__: each for each in (rapidchecker, krllint, rosbags, tree_sitter_gcode, pygcode, lxml)}


def _few(said: list[str]) -> str:
    return "; ".join(said[:2]) + (f"; and {len(said) - 2} more" if len(said) > 2 else "")


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of parsers that use what newer releases of their own libraries call old
    tool, *names = sys.argv[1:]
    told = TOOLS[tool]([Path(name) for name in names])
    print(json.dumps({"version": version(tool.replace("_", "-")), **told}))
