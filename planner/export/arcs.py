"""Lines and circular arcs between targets: lengths, points and tangents, and where they are nearest to a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.base.arrays import Array, Flags, Indices

TINY = 1e-12  # [m, rad]: avoids divisions by zero where there is no length


@dataclass(frozen=True)
class LinesAndArcs:
    """n straight lines and circular arcs in space.

    begin, end      (n, 3) [m]
    circular        (n)
    centre, e1, e2  (n, 3) of arcs: from the centre, e1 points to the beginning, e2 in the arc's initial direction
    radius, swept   (n) of arcs [m, rad]; 0 for lines
    """

    begin: Array
    end: Array
    circular: Flags
    centre: Array
    e1: Array
    e2: Array
    radius: Array
    swept: Array

    @property
    def length(self) -> Array:
        """Lengths (n) [m]."""
        out: Array = np.where(self.circular, self.radius * self.swept, np.linalg.norm(self.end - self.begin, axis=1))
        return out

    def take(self, rows: Indices) -> LinesAndArcs:
        """The segments in rows (k)."""
        return LinesAndArcs(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def at(self, u: Array) -> Array:
        """Points (n, 3) at fractions u (n) of the length."""
        line = self.begin + u[:, None] * (self.end - self.begin)
        if not self.circular.any():
            return line
        phi = u * self.swept
        arm = np.cos(phi)[:, None] * self.e1 + np.sin(phi)[:, None] * self.e2
        out: Array = np.where(self.circular[:, None], self.centre + self.radius[:, None] * arm, line)
        return out

    def fraction(self, points: Array, otherwise: Array) -> Array:
        """Fractions (n) of the length at which points (n, 3) are nearest; `otherwise` (n) where there is no length."""
        chord = self.end - self.begin
        square = np.einsum("ij,ij->i", chord, chord)
        short = square < 1e-14
        along = np.einsum("ij,ij->i", points - self.begin, chord) / np.where(short, 1.0, square)
        out = np.where(short, otherwise, np.clip(along, 0.0, 1.0))
        if not self.circular.any():
            return out
        arm = points - self.centre
        phi = np.arctan2(np.einsum("ij,ij->i", arm, self.e2), np.einsum("ij,ij->i", arm, self.e1))
        # points past the end belong to the end as long as the beginning is farther along the circle
        phi = np.where(phi < 0.5 * self.swept - np.pi, phi + 2.0 * np.pi, phi)
        share = np.clip(phi / np.maximum(self.swept, TINY), 0.0, 1.0)
        result: Array = np.where(self.circular, share, out)
        return result

    def tangents(self, at_end: bool) -> Array:
        """Unit tangents (n, 3) at the beginning or end of segments; 0 where they have no length."""
        chord = self.end - self.begin
        out: Array = chord / np.maximum(np.linalg.norm(chord, axis=1), TINY)[:, None]
        if self.circular.any():
            phi = self.swept if at_end else np.zeros(len(self.swept))
            turned = np.cos(phi)[:, None] * self.e2 - np.sin(phi)[:, None] * self.e1
            out = np.where(self.circular[:, None], turned, out)
        return out


def segments(begin: Array, via: Array, end: Array, circular: Flags) -> LinesAndArcs:
    """Lines from `begin` to `end` (n, 3), and arcs through `via` (n, 3) where `circular` (n).

    An arc whose three points are collinear, or coincide, becomes a line.
    """
    chord = end - begin
    length = np.linalg.norm(chord, axis=1)
    x = chord / np.maximum(length, TINY)[:, None]
    arm = via - begin
    along = np.einsum("ij,ij->i", arm, x)
    aside = arm - along[:, None] * x
    height = np.linalg.norm(aside, axis=1)
    round_ = circular & (length > 1e-9) & (height > 1e-9)
    y = aside / np.where(round_, height, 1.0)[:, None]
    # the circle through (0, 0), (length, 0) and (along, height): its centre lies `below` the chord
    below = np.where(round_, (along * (length - along) - height**2) / (2.0 * np.where(round_, height, 1.0)), 0.0)
    centre = begin + 0.5 * chord - below[:, None] * y
    radius = np.where(round_, np.hypot(0.5 * length, below), 0.0)
    swept = np.where(round_, 2.0 * np.arctan2(0.5 * length, below), 0.0)  # more than pi where the centre is above
    e1 = (begin - centre) / np.where(round_, radius, 1.0)[:, None]
    first = np.cross(np.cross(e1, y), e1)  # in the plane, perpendicular to e1, on the side of the via point
    e2 = first / np.maximum(np.linalg.norm(first, axis=1), TINY)[:, None]
    flat = ~round_[:, None]
    zero = np.zeros(3)
    return LinesAndArcs(
        begin=begin,
        end=end,
        circular=round_,
        centre=np.where(flat, zero, centre),
        e1=np.where(flat, zero, e1),
        e2=np.where(flat, zero, e2),
        radius=radius,
        swept=swept,
    )
