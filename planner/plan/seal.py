"""What a verdict is about: digests of all that the checks were made of, and of the verdict itself.

A plan is frozen, and still `dataclasses.replace` makes another one of it, and arrays can be made writable. Its seal
tells whether anything was changed since it was verified, and which part.
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
_DIGEST = 16  # bytes: nobody forges what they can seal anew; only a change must not go unseen


def sealed(plan: Plan) -> Plan:
    """The same plan with the seal of what it is now."""
    return replace(plan, seal=seal_of(plan))


def seal_of(plan: Plan) -> dict[str, str]:
    """Digest in hexadecimal of each part of a plan: its inputs, its trajectory, and its verdict.

    Empty for a part with something that has none, which a plan must not be lost for; it counts as changed.
    """
    parts = {name: getattr(plan, name) for name in (*INPUTS, "trajectory", "asked")}
    parts["verdict"] = tuple(getattr(plan, name) for name in VERDICT)
    digests = dict.fromkeys(parts, "")
    for name, value in parts.items():
        with suppress(TypeError):
            digests[name] = digest_of(value)
    return digests


def changed_since(plan: Plan) -> tuple[str, ...]:
    """Names of the parts of a plan that are not, or not surely, what its seal says; all but the inputs of a plan that has
    none."""
    if not plan.seal:
        return ("trajectory", "verdict")
    return tuple(name for name, digest in seal_of(plan).items() if not digest or plan.seal.get(name) != digest)


def digest_of(value: object) -> str:
    """Digest in hexadecimal of dataclasses, models, containers, arrays and numbers, to the last bit.

    Of kinematic models their placements count, of search trees their points; of dataclasses not what they keep while they
    are used, which they do not compare by. TypeError for anything else: what is not understood is not passed over.
    """
    digest = hashlib.blake2b(digest_size=_DIGEST)
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Add a value to a digest, with its type, so that different ones never look alike."""
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
    """What an object consists of; the classes of libraries are known by what they have, so that none is imported."""
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
