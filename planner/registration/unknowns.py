"""Which unknowns of a placement are looked for, which of them a set of touched places fixes, and words for the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.readonly import Array, ReadOnlyArrays
from planner.registration.placement import SHIFTS, SIZE, TURNS, UNKNOWNS

FREEDOMS = ("x", "y", "z", "rx", "ry", "rz")
# A freedom that moves the touched places by less than this share of its own size along their normals is not seen there:
# noise would be blown up a hundredfold. Facets of a round mesh let a turn about its own axis show by less than that.
SEEN = 0.01
_ALIKE = 1e-3  # relative: a turn that shifts its axis by less is a turn alone, a slide that turns by less a slide


@dataclass(frozen=True)
class Unknowns(ReadOnlyArrays):
    """What is looked for.

    basis (10, p)  orthonormal columns of unknowns, all in metres: turns are metres at a distance of `lever` [m] from
                   `centre` (3), in the part frame
    """

    basis: Array
    centre: Array
    lever: float

    @property
    def scale(self) -> Array:
        """What turns unknowns in metres into metres and radians (10)."""
        out = np.ones(UNKNOWNS)
        out[TURNS] = 1.0 / self.lever
        return out

    @property
    def table(self) -> bool:
        """Whether the table is looked for."""
        return bool(np.abs(self.basis[SHIFTS]).max() > 0.0)

    def columns(self, rows: Array) -> Array:
        """Rows (n, 10) in metres and radians as rows (n, p) of what is looked for."""
        return np.asarray((rows * self.scale) @ self.basis)

    def step(self, z: Array) -> Array:
        """Values (p) of what is looked for as unknowns (10) in metres and radians."""
        return np.asarray(self.scale * (self.basis @ z))


def looked_for(free: tuple[str, ...], table: Array, size: bool, places: Array) -> Unknowns:
    """Unknowns for named freedoms of the part frame, shifts of the table along orthonormal directions (3, k), the size.

    places (n, 3) of the part, which say what is far and what is near.
    """
    columns = [np.eye(UNKNOWNS)[:, FREEDOMS.index(name)] for name in free]
    for direction in table.T:
        column = np.zeros(UNKNOWNS)
        column[SHIFTS] = direction
        columns.append(column)
    if size:
        columns.append(np.eye(UNKNOWNS)[:, SIZE])
    centre = places.mean(axis=0)
    lever = float(np.sqrt(((places - centre) ** 2).sum(axis=1).mean()))
    return Unknowns(np.column_stack(columns), centre, max(lever, 1e-3))


def table_ways(T_world_plate: Array) -> Array:
    """Directions (3, k) of the world in which a table's place can be told from that of the part on it.

    Those along which its turns (n, 4, 4) move the part; a part that turns about the vertical only cannot tell how high
    its table is.
    """
    R = T_world_plate[:, :3, :3]
    turned = R @ R[0].T - np.eye(3)
    values, vectors = np.linalg.eigh(np.einsum("nij,nik->jk", turned, turned) / len(R))
    ways = vectors[:, values > SEEN**2]
    if ways.shape[1] == 2 and abs(np.linalg.det(ways[:2])) > 1.0 - 1e-9:
        return np.eye(3)[:, :2]
    return np.eye(3) if ways.shape[1] == 3 else np.asarray(ways)


def split(J: Array) -> tuple[Array, Array]:
    """Orthonormal directions (p, r) that rows (n, p) see, and (p, k) that they do not."""
    square, ways = np.linalg.eigh(J.T @ J / max(len(J), 1))
    seen = square > SEEN**2
    return ways[:, seen], ways[:, ~seen]


def words(unknowns: Unknowns, hidden: Array) -> list[str]:
    """Each of the orthonormal directions (p, k) in plain words, in the part frame; mixtures are untangled first."""
    full = unknowns.basis @ hidden
    if full.shape[1] == 0:
        return []
    out = []
    table = np.abs(full[SHIFTS]).max() > _ALIKE or np.abs(full[SIZE]).max() > _ALIKE
    if table:
        return [_mixture(column) for column in full.T]
    # slides first: combinations that do not turn
    _, s, Vt = np.linalg.svd(full[TURNS])
    s = np.append(s, np.zeros(Vt.shape[0] - len(s)))
    slides = full[:3] @ Vt[s <= _ALIKE].T
    out += [f"a slide along {_direction(way)}" for way in _straightened(slides).T]
    turns = full @ Vt[s > _ALIKE].T
    turns[:3] -= slides @ (slides.T @ turns[:3])
    if turns.shape[1] == 3:
        return [*out, f"any turn about {_point(unknowns.centre + _pivot(turns, unknowns.lever))}"]
    for turn in turns.T:
        axis = turn[TURNS] / np.linalg.norm(turn[TURNS])
        at = unknowns.centre + _pivot(turn[:, None], unknowns.lever)
        out.append(f"a turn about {_direction(axis)} through {_point(at)}")
    return out


def _pivot(turns: Array, lever: float) -> Array:
    """The point (3), from the centre, that turns (10, k) leave where it is, as nearly as can be."""
    rows = [_cross(turn[TURNS] / lever) for turn in turns.T]  # the point moves by v + w x p
    return np.linalg.lstsq(np.vstack(rows), -np.concatenate([turn[:3] for turn in turns.T]), rcond=1e-9)[0]


def _cross(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def _straightened(slides: Array) -> Array:
    """The same span (3, k) by the axes of the part frame, where it is spanned by some of them."""
    if slides.shape[1] == 0:
        return slides
    along = np.linalg.norm(slides, axis=1) / max(float(np.linalg.norm(slides, axis=0).max()), 1e-12)
    axes = np.flatnonzero(along > 1.0 - _ALIKE)
    return np.eye(3)[:, axes] if len(axes) == slides.shape[1] else slides


def _direction(way: Array) -> str:
    way = way / np.linalg.norm(way)
    k = int(np.argmax(np.abs(way)))
    if abs(way[k]) > 1.0 - _ALIKE:
        return "xyz"[k]
    way = way * np.sign(way[k])
    return "(" + ", ".join(f"{v + 0.0:.2f}" for v in np.round(way, 2)) + ")"


def _point(p: Array) -> str:
    return "(" + ", ".join(f"{v:.1f}" for v in np.round(p * 1e3, 1) + 0.0) + ") mm"


def _mixture(column: Array) -> str:
    names = [*(f"the part's {name}" for name in FREEDOMS), *(f"the table's {name}" for name in "xyz"), "the size"]
    return " with ".join(names[k] for k in np.argsort(-np.abs(column)) if abs(column[k]) > 0.1)
