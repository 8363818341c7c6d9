"""The seal of a plan: digests of everything its checks were based on, and of the verdict itself.

A plan is frozen, but `dataclasses.replace` can still make another one from it, and arrays can be made writable. The
seal shows whether anything was changed since the plan was verified, and which part.
"""

from __future__ import annotations

import enum
import hashlib
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from planner.plan.plan import Plan

INPUTS = ("problem", "cell", "toolpath")  # what is verified against
VERDICT = ("checks", "metrics", "headroom", "nearer")
_DIGEST = 16  # bytes: enough for changes to be noticed; there is no point in forging what anyone can seal again


def sealed(plan: Plan) -> Plan:
    """The same plan with a seal of its present state."""
    return replace(plan, seal=seal_of(plan))


def seal_of(plan: Plan) -> dict[str, str]:
    """Digest in hexadecimal of each part of a plan: its inputs, its trajectory, and its verdict.

    Empty for a part that contains something without a digest: the plan must not be lost for it, and it counts as
    changed.
    """
    parts = {name: getattr(plan, name) for name in (*INPUTS, "trajectory", "asked")}
    parts["verdict"] = tuple(getattr(plan, name) for name in VERDICT)
    digests = dict.fromkeys(parts, "")
    for name, value in parts.items():
        with suppress(TypeError):
            digests[name] = digest_of(value)
    return digests


def changed_since(plan: Plan) -> tuple[str, ...]:
    """Names of the parts of a plan that differ, or may differ, from its seal; without a seal, all but the inputs."""
    if not plan.seal:
        return ("trajectory", "verdict")
    return tuple(name for name, digest in seal_of(plan).items() if not digest or plan.seal.get(name) != digest)


def digest_of(value: object) -> str:
    """Digest in hexadecimal of dataclasses, models, containers, arrays and numbers, to the last bit.

    Kinematic models count by their names, placements and limits, search trees by their points, dataclasses by the
    fields that they compare by, so without caches. Raises TypeError for anything else: nothing unknown is skipped
    silently.
    """
    digest = hashlib.blake2b(digest_size=_DIGEST)
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Add a value and its type to a digest, so that different values never look alike."""
    if isinstance(value, np.ndarray | np.generic):
        digest.update(f"array {value.dtype.str} {value.shape} ".encode())
        digest.update(np.ascontiguousarray(value).data)
    elif value is None or isinstance(value, bool | int | str | bytes | enum.Enum | PurePath):
        text = repr(value)
        digest.update(f"{type(value).__name__} {len(text)} {text}".encode())
    elif isinstance(value, float):
        digest.update(b"float" + struct.pack("<d", value))
    elif isinstance(value, Mapping):
        digest.update(f"mapping {len(value)} ".encode())
        for key, each in value.items():
            _feed(digest, key)
            _feed(digest, each)
    elif isinstance(value, tuple | list):
        digest.update(f"sequence {len(value)} ".encode())
        for each in value:
            _feed(digest, each)
    elif isinstance(value, set | frozenset):
        _feed(digest, sorted(digest_of(each) for each in value))
    else:
        digest.update(f"{type(value).__qualname__} ".encode())
        _feed(digest, _contents(value))


def _contents(value: Any) -> object:
    """The contents of an object; library classes are recognised by their attributes, so that no library is imported."""
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value) if field.compare}
    if hasattr(value, "model_fields_set"):  # of pydantic
        return {name: getattr(value, name) for name in type(value).model_fields}
    if hasattr(value, "jointPlacements"):  # a model of Pinocchio
        joints = [np.array(each.homogeneous) for each in value.jointPlacements]
        frames = [(frame.name, int(frame.parentJoint), np.array(frame.placement.homogeneous)) for frame in value.frames]
        limits = [np.array(each) for each in (value.lowerPositionLimit, value.upperPositionLimit, value.velocityLimit)]
        return [list(value.names), list(value.parents), joints, frames, limits]
    if type(value).__name__ == "cKDTree":
        return value.data
    if type(value).__name__ == "BSpline":
        return [value.t, value.c, value.k]
    if hasattr(value, "wkb"):  # a shape of shapely
        return value.wkb
    raise TypeError(f"{type(value).__module__}.{type(value).__qualname__} has no digest")
