"""JSON schemas of the problem file and of robots' files, for editors: keys, units, ranges, defaults, names.

Draft 7, which the YAML extensions of editors understand. What a schema cannot say, such as that a drawing fits on its
part, `planner.check` finds out.
"""

from __future__ import annotations

import json
from typing import Any

from planner.cell.robot import robot_names, shipped_robots
from planner.cell.robot_file import KEYS
from planner.problem import Problem
from planner.problem.layers import KINDS

Schema = dict[str, Any]
DRAFT = "http://json-schema.org/draft-07/schema#"
_NOISE = {"title", "default"}  # titles repeat keys; defaults are put back where they say something
# Of two kinds of layers with the same source, the key of `layers` that tells this one.
TOLD_BY = {"[svg]": "wrap", "[core]": "up_to"}


def problem_schema() -> str:
    """The schema of a problem file, as JSON text."""
    raw = Problem.model_json_schema()
    kinds = {kind.model.__name__: kind for kind in KINDS}
    layers = {name: name for name in raw["$defs"] if name in kinds}
    defs = {name: _plain(each) for name, each in raw["$defs"].items()}
    root = _plain({key: value for key, value in raw.items() if key != "$defs"})
    root["properties"]["layers"] = {
        "description": root["properties"]["layers"]["description"],
        "type": "object",
        **_told_apart([_ref(name) for name in layers]),
    }
    for name, key, own in (
        ("CellSpec", "arm", list(shipped_robots(arms=True))),
        ("CarrierSpec", "robot", list(shipped_robots(arms=False))),
        ("PositionerSpec", "robot", robot_names()),
    ):
        field = defs[name]["properties"][key]
        defs[name]["properties"][key] = {
            "description": field["description"],
            "anyOf": [{"enum": own}, {"type": "string", "pattern": "\\.ya?ml$"}],
        }
    head = {"$schema": DRAFT, "title": "Beadwise problem file"}
    return json.dumps({**head, **root, "$defs": defs}, indent=1, ensure_ascii=False) + "\n"


def robot_schema() -> str:
    """The schema of a robot's file, as JSON text."""
    properties = {}
    for name, key in KEYS.items():
        default = "" if key.required else f"; default: {key.default}"
        properties[name] = {"description": key.text + default, **key.schema}
    schema = {
        "$schema": DRAFT,
        "title": "Beadwise robot file",
        "type": "object",
        "properties": properties,
        "required": [name for name, key in KEYS.items() if key.required],
        "not": {"required": ["spherical_wrist", "inverse_kinematics"]},
        "additionalProperties": False,
    }
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _ref(name: str) -> Schema:
    return {"$ref": f"#/$defs/{name}"}


def _told_apart(refs: list[Schema]) -> Schema:
    """The kinds of layers by what tells them: the key of their source, and one beside it where two have the same.

    Where none of these stands there yet, an editor may complete any of them.
    """
    known = {ref["$ref"]: ref for ref in refs}
    out: Schema = {"anyOf": refs}
    for kind in sorted(KINDS, key=lambda kind: kind.tag in TOLD_BY):  # the last one is asked first
        named: Schema = {"anyOf": [{"required": [name]} for name in kind.names]}
        test: Schema = {"properties": {"source": {"type": "object", **named}}, "required": ["source"]}
        if kind.tag in TOLD_BY:
            test["required"] = ["source", TOLD_BY[kind.tag]]
        out = {"if": test, "then": known[_ref(kind.model.__name__)["$ref"]], "else": out}
    return out


def _plain(value: Any) -> Any:
    """A schema without what only repeats itself, and without null: a key that is not wanted is left out.

    A reference with words beside it is wrapped, since readers of draft 7 pass over what stands beside one.
    """
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if not isinstance(value, dict):
        return value
    if set(value.get("properties", {})) and "type" in value:
        inner = {key: _plain(each) for key, each in value["properties"].items()}
        return {
            **{key: _plain(each) for key, each in value.items() if key not in (*_NOISE, "properties")},
            "properties": inner,
        }
    out = {key: _plain(each) for key, each in value.items() if key not in _NOISE}
    if value.get("default") not in (None, {}, []):
        out["default"] = value["default"]
    if "patternProperties" in out:  # names of the user's own, of which no other form is taken
        out["additionalProperties"] = False
    choices = out.get("anyOf", [])
    if {"type": "null"} in choices:
        rest = [each for each in choices if each != {"type": "null"}]
        out.pop("anyOf")
        out = {**out, **(rest[0] if len(rest) == 1 else {"anyOf": rest})}
    if "anyOf" in out and {"type": "string"} in out["anyOf"] and {"type": "string", "format": "path"} in out["anyOf"]:
        out.pop("anyOf")
        out["type"] = "string"
    if out.get("format") == "path":
        out.pop("format")
    if "$ref" in out and len(out) > 1:
        out["allOf"] = [{"$ref": out.pop("$ref")}]
    return out
