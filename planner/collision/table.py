"""Everything that may touch, as numbers for the compiled kernels, and the scratch that one of their threads needs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.base.arrays import Array, Flags, Ints, read_only
from planner.base.compiled import inner_njit
from planner.collision.point_tree import SearchRoom, search_room


class Table(NamedTuple):
    """Everything that may touch, as numbers (nj joints, b bodies, p pairs, t trees, k looks of a body and a tree).

    placements (nj, 4, 4), axes (nj, 6)   as in Chain, of the arm and then the holder; arm (1): how many are the arm's
    tip (3)                               of the nozzle in the arm's last frame
    frame, kind (b), size (b, SIZES), planes, vertices, span (b, 2)   solids as in Packed; span: first vertex, count
    T_frame_solid (b, 4, 4), ball (b, 4)  middle and reach of a ball around each, in its frame
    pair (p, 2), needed (p)               bodies that may touch, the distance that they keep [m]
    points .. right                       the trees of `PointTree` end to end
    first (t, 4)                          of each tree: first point, points, first node, nodes
    tree_frame (t), T_frame_tree (t, 4, 4)
    look (k, 2)                           body and tree
    keep (k, 3)                           clearance, slope and slack, see `nearest_point`
    slack (n beads)                       replaces the third of `keep` for head and part, by the bead that is printed
    graze (n beads)                       as in `TipRule`, for head and part likewise; not used elsewhere
    head_on_part (k)                      head and part: their margin depends only on the nozzle's pose in the part
    round_on_part (k)                     of these, where the head's body is round about the nozzle's axis: roll has no
                                          effect
    """

    placements: Array
    axes: Array
    arm: Ints
    tip: Array
    frame: Ints
    kind: Ints
    size: Array
    planes: Array
    vertices: Array
    span: Ints
    T_frame_solid: Array
    ball: Array
    pair: Ints
    needed: Array
    points: Array
    radius: Array
    time: Array
    node_centre: Array
    node_reach: Array
    since: Array
    left: Ints
    right: Ints
    first: Ints
    tree_frame: Ints
    T_frame_tree: Array
    look: Ints
    keep: Array
    slack: Array
    graze: Array
    head_on_part: Flags
    round_on_part: Flags


def with_fields(table: Table, **fields: NDArray[Any]) -> Table:
    """The table with some arrays replaced, all read-only.

    So are verification's arrays, and kernels that both call are compiled only once.
    """
    return table._replace(**{name: read_only(values) for name, values in fields.items()})


class Workspace(NamedTuple):
    """Scratch for one thread: frames (nf, 4, 4), joints' origins and directions (nj, 6), bodies' middles (b, 3) and
    poses of solids (b, 4, 4) in the world, which of these are known, directions that separated pairs (p, 3), simplex
    (4, 9), few (4, 3) places of a body in a tree's frame, the pose T_solid_tree (4, 4), a search's scratch, and last
    (1), the pair that most recently lacked clearance."""

    frames: Array
    lines: Array
    middle: Array
    pose: Array
    known: Flags
    way: Array
    simplex: Array
    few: Array
    T_solid_tree: Array
    search: SearchRoom
    last: Ints


@inner_njit
def workspace_for(table):
    """Scratch for a thread."""
    nj, b = len(table.axes), len(table.frame)
    frames = np.zeros((1 + nj, 4, 4))
    frames[:, 3, 3] = 1.0
    for k in range(3):
        frames[0, k, k] = 1.0
    pose = np.zeros((b, 4, 4))
    pose[:, 3, 3] = 1.0
    into = np.zeros((4, 4))
    into[3, 3] = 1.0
    return Workspace(
        frames, np.zeros((nj, 6)), np.zeros((b, 3)), pose, np.zeros(b, dtype=np.bool_), np.ones((len(table.pair), 3)),
        np.zeros((4, 9)), np.zeros((4, 3)), into, search_room(), np.zeros(1, dtype=np.int64),
    )  # fmt: skip
