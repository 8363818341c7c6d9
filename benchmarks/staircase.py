"""How far a wing's printed outline is off its surface, in level and in curved layers: numbers and a figure.

python -m benchmarks.staircase
python -m benchmarks.staircase --figure docs/pictures/staircase.png

The outline is that of the beads at mid-span, each as wide and as high as it is laid; the true surface is the section's
spline. Distances are taken where layers of both kinds lie on the surface: not at the leading edge, which is steeper than
the greatest tilt of a curved layer, and not at the trailing edge.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.command import told
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED
from planner.problem import Problem, load_problem
from planner.problem.layers import AerofoilLayersSpec
from planner.toolpath.build import build_toolpath
from planner.toolpath.wing.section import AerofoilSection, SectionSide, root_section

PROBLEM = "naca0015_wing"
METHODS = {
    "curved": ("layers.source.method=curved", "layers.support=null"),
    "planar": ("layers.source.method=planar", "layers.support=null"),
}
SPAN = "layers.source.span_mm=2"  # the section is the same all along
STEP = 2e-5  # m between places of outlines
COARSE = 2e-4  # m between corners of a layer's cross-section: between them a curved one bends by a micrometre
TRIM = 2.0e-3  # m from either end of a layer's outline that is left out: half a bead and its rounding
NEAR = 0.9  # of a layer's height from the surface: what borders on the outside is nearer, voids inside are farther
PROBE = 1e-6  # m above an outline, to see whether something else is there


@dataclass(frozen=True)
class Layer:
    """The printed cross-section of one layer: top and bottom (n, 2) from end to end [m]."""

    top: Array
    bottom: Array

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 2) lie inside, by counting crossings of its border."""
        ring = np.vstack([self.top, self.bottom[::-1]])
        a, b = ring, np.roll(ring, -1, axis=0)
        inside = np.zeros(len(points), dtype=bool)
        for k in range(0, len(points), 500):
            p = points[k : k + 500, None]
            crosses = (a[:, 1] > p[..., 1]) != (b[:, 1] > p[..., 1])
            rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
            x = a[:, 0] + (p[..., 1] - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
            inside[k : k + 500] = (crosses & (x > p[..., 0])).sum(axis=1) % 2 == 1
        return inside


def layers_of(problem: Problem) -> list[Layer]:
    """The printed cross-sections of all layers of a wing, bead by bead."""
    layers = []
    for bead in build_toolpath(problem).beads:
        order = np.argsort(bead.points[:, 0])
        x = bead.points[order, 0]
        _, keep = np.unique(np.floor((x - x[0]) / COARSE), return_index=True)
        keep = np.append(keep, len(x) - 1)
        points, normals = bead.points[order][keep][:, ::2], bead.normals[order][keep][:, ::2]
        half = 0.5 * float(bead.width[0])
        ends = [np.array([n[1], -n[0]]) * s * half for n, s in ((normals[0], -1.0), (normals[-1], 1.0))]
        top = np.vstack([points[:1] + ends[0], points, points[-1:] + ends[1]])
        normals = np.vstack([normals[:1], normals, normals[-1:]])
        layers.append(Layer(top, top - float(bead.height[0]) * normals))
    return layers


@dataclass(frozen=True)
class Outline:
    """Places (n, 2) on the border of all layers together, and their outward unit normals (n, 2)."""

    points: Array
    normals: Array

    def distance(self, points: Array) -> Array:
        """Distances (n) of points (n, 2) from it, which is straight from place to place."""
        _, k = cKDTree(self.points).query(points)
        away, normals = points - self.points[k], self.normals[k]
        out = (away * normals).sum(axis=1)
        aside = np.linalg.norm(away - out[:, None] * normals, axis=1)
        return np.asarray(np.hypot(out, np.maximum(aside - 0.5 * STEP, 0.0)))


def outline_of(layers: Sequence[Layer]) -> Outline:
    """The border of all layers together: places that lie in no other layer."""
    found, directions = [], []
    for layer in layers:
        ring = np.vstack([layer.top, layer.bottom[::-1], layer.top[:1]])
        places = _dense(ring)
        ahead = np.gradient(places, axis=0)
        out = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1)[:, None]
        near = places + PROBE * out
        low, high = near.min(axis=0), near.max(axis=0)
        bare = np.ones(len(places), dtype=bool)
        for other in layers:
            if other is layer or (other.bottom.min(axis=0) > high).any() or (other.top.max(axis=0) < low).any():
                continue
            k = np.flatnonzero(bare)
            bare[k] = ~other.holds(near[k])
        found.append(places[bare])
        directions.append(out[bare])
    return Outline(np.vstack(found), np.vstack(directions))


def _dense(line: Array) -> Array:
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, length[-1], STEP)
    return np.column_stack([np.interp(at, length, line[:, k]) for k in range(2)])


def errors(outline: Outline, side: SectionSide, x: tuple[float, float]) -> tuple[Array, Array]:
    """How far the surface is off the outline at places between two x (n) [m], and these places' distances (n)."""
    t = np.linspace(side.first, side.last, 6000)
    points = side.points(t)
    points = points[(points[:, 0] > x[0]) & (points[:, 0] < x[1])]
    return points[:, 0], outline.distance(points)


def off_surface(outline: Outline, section: AerofoilSection, x: tuple[float, float], near: float) -> Array:
    """Distances (n) of places of the outline from the surface, between two x [m].

    Those farther than `near` border on voids inside, where layers of both halves meet, and do not count.
    """
    inner = outline.points[(outline.points[:, 0] > x[0]) & (outline.points[:, 0] < x[1])]
    away = np.minimum(section.upper.distance(inner), section.lower.distance(inner))
    return np.asarray(away[away < near])


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.staircase", description=__doc__)
    parser.add_argument("--figure", type=Path, default=Path("docs/pictures/staircase.png"))
    options = parser.parse_args(arguments)
    problems = {name: load_problem(PROBLEM, (SPAN, *changes)) for name, changes in METHODS.items()}
    layers = {name: layers_of(problem) for name, problem in problems.items()}
    spec = problems["curved"].layers
    if not isinstance(spec, AerofoilLayersSpec):
        raise TypeError(f"{PROBLEM} is no wing")
    section = root_section(problems["curved"], spec.source)
    outer = [layers["curved"][k].top[:, 0] for k in (0, -1)]
    x = max(float(each.min()) for each in outer) + TRIM, min(float(each.max()) for each in outer) - TRIM
    outlines = {name: outline_of(each) for name, each in layers.items()}
    print(f"{PROBLEM}, layers of {spec.height * 1e3:g} mm, x from {x[0] * 1e3:.1f} to {x[1] * 1e3:.1f} mm")
    for name, outline in outlines.items():
        away = off_surface(outline, section, x, NEAR * spec.height)
        void = np.concatenate([errors(outline, side, x)[1] for side in (section.upper, section.lower)])
        print(
            f"{name}: outline off the surface at most {away.max() * 1e3:.4f}, mean {away.mean() * 1e3:.4f} mm; "
            f"surface off the outline at most {void.max() * 1e3:.4f}, mean {void.mean() * 1e3:.4f} mm"
        )
    print(f"cusp height of level layers by formula: at most {cusps(section, spec.height, x) * 1e3:.4f} mm")
    options.figure.parent.mkdir(parents=True, exist_ok=True)
    draw(outlines, section, x).savefig(options.figure, dpi=110)
    print(f"figure: {options.figure}")
    return EXIT_VERIFIED


def cusps(section: AerofoilSection, height: float, x: tuple[float, float]) -> float:
    """Greatest height of a step's corner above the line through the corners' feet: layer height times cos of the slope."""
    most = 0.0
    for side in (section.upper, section.lower):
        t = np.linspace(side.first, side.last, 6000)
        inside = (side.points(t)[:, 0] > x[0]) & (side.points(t)[:, 0] < x[1])
        most = max(most, float(height * np.abs(side.inward(t[inside])[:, 1]).max()))
    return most


def draw(outlines: dict[str, Outline], section: AerofoilSection, x: tuple[float, float]) -> Figure:
    """Both outlines over the true section, the errors along the upper surface, and a part of it closer."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    whole, close, error = figure.subplots(3, 1)
    for panel in (whole, close):
        for name, outline in outlines.items():
            panel.plot(*(outline.points * 1e3).T, ".", markersize=1.0, label=f"{name} layers")
        for side in (section.upper, section.lower):
            panel.plot(
                *(side.points(side.grid) * 1e3).T,
                "k-",
                linewidth=0.7,
                label="true surface" if side is section.upper else None,
            )
        panel.set_aspect("equal")
        panel.set_ylabel("z [mm]")
    close.set_xlim(22.0, 38.0)
    close.set_ylim(12.0, 15.2)
    whole.legend(markerscale=8, loc="upper right")
    for name, outline in outlines.items():
        at, away = errors(outline, section.upper, x)
        error.plot(at * 1e3, away * 1e3, linewidth=0.8, label=f"{name} layers")
    error.set_ylabel("upper surface off the outline [mm]")
    error.set_xlabel("x [mm]")
    error.legend()
    return figure


if __name__ == "__main__":
    sys.exit(main())
