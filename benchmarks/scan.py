"""Prints that are off by known errors, scanned, corrected and verified: how close the nozzle is to where it should be.

python -m benchmarks.scan [PRINT …] [--seeds 20] [--picture map.png] [--cloud cloud.xyz]

A layer's top is moved along its normals by a smooth pattern of up to 0.8 mm and sampled as a scanner would: 0.05 mm of noise,
5 % of the points thrown off by millimetres, holes in 10 % of the area. The map is found from the cloud alone, the layers above
are planned on it, and the executed tips are compared with the true tops.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.command_line import one_of
from planner.base.errors import InputError
from planner.base.geometry import arc_lengths
from planner.base.shipped import PROBLEMS
from planner.feedback.height_map import HeightMap, height_map, planned_top
from planner.feedback.scan_command import SHARE, radius_of
from planner.feedback.scan_telling import bound_of, layer_heights, write_map, write_picture, write_problem
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import Problem, load_problem
from planner.toolpath.bead import Toolpath
from planner.toolpath.build import build_toolpath

OFF = 0.8e-3  # m: the print is off by up to this
NOISE, OUTLIERS, FAR_OUT = 0.05e-3, 0.05, 3e-3  # m; share of the points; m
HOLES, HOLE = 0.1, 3e-3  # share of the area; radius of one [m]
APART = 0.15e-3  # m between points
WAVES = (40e-3, 55e-3, 70e-3)  # m: of the pattern in x, y and z of the part


@dataclass(frozen=True)
class ScannedPrint:
    """What is printed: a shipped problem, its changes, the layer that is scanned, and what writes its source, if any."""

    name: str
    base: str
    changes: tuple[str, ...]
    layer: int
    write: Callable[[Path], str] | None = None

    def problem(self, folder: Path) -> Problem:
        """The problem, whose source is written into a folder."""
        changes = self.changes if self.write is None else (*self.changes, self.write(folder), f"name={self.name}")
        return load_problem(self.base, changes)


def box(folder: Path) -> str:
    """G-code of the shipped box, its first two layers again and again; written into a folder, as a `--set`."""
    text = (PROBLEMS / "planar_box.gcode").read_text(encoding="utf-8")
    head, *layers = text.split(";LAYER_CHANGE\n")
    parts = [head]
    for k in range(LAYERS):
        old, new = ((k % 2 + 1) * BOX_HEIGHT_MM, (k + 1) * BOX_HEIGHT_MM)
        parts.append(layers[k % 2].replace(f";Z:{old:g}\n", f";Z:{new:g}\n").replace(f"G1 Z{old:g} ", f"G1 Z{new:g} "))
    file = folder / "box.gcode"
    file.write_text(";LAYER_CHANGE\n".join([*parts]), encoding="utf-8")
    return f"layers.source.gcode={file}"


def cap(folder: Path) -> str:
    """Waypoints of a spiral on a cap, in layers along its normals; written into a folder, as a `--set`."""
    turns = CAP_ANGLE * CAP_RADIUS / CAP_PITCH
    dense = np.linspace(0.02, 1.0, 20_000)
    polar = dense * CAP_ANGLE
    azimuth = 2.0 * np.pi * turns * dense
    normal = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    arc = arc_lengths(CAP_RADIUS * normal)
    at = np.interp(np.arange(0.0, arc[-1], 1.0), arc, dense)
    polar, azimuth = at * CAP_ANGLE, 2.0 * np.pi * turns * at
    normal = np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    layers = []
    for k in range(LAYERS):
        number = np.full((len(normal), 2), k)
        layers.append(np.hstack([(CAP_RADIUS + k * HEIGHT_MM) * normal, normal, number]))
    file = folder / "cap.csv"
    np.savetxt(file, np.vstack(layers), delimiter=",", header="x,y,z,nx,ny,nz,bead,layer", comments="", fmt="%.9g")
    return f"layers.source.waypoints={file}"


LAYERS, HEIGHT_MM, BOX_HEIGHT_MM = 9, 0.5, 0.3
CAP_RADIUS, CAP_ANGLE, CAP_PITCH = 120.0, np.radians(13.0), 1.8  # mm
PRINTS = (
    ScannedPrint("hemisphere_honeycomb", "hemisphere_honeycomb", ("layers.count=9",), 3),
    ScannedPrint("cylinder_logo", "cylinder_logo", ("layers.count=10",), 4),
    ScannedPrint("cap", "peer_cap", (), 3, cap),
    ScannedPrint("saddle_ring", "saddle_ring", (), 3),
    ScannedPrint("box", "planar_gcode", (), 3, box),
)


@dataclass(frozen=True)
class Truth:
    """How far a print is off: waves about the middle (3) [m] of a layer's top."""

    middle: Array

    @classmethod
    def of(cls, toolpath: Toolpath, layer: int) -> Truth:
        """That of a layer, counted from 1."""
        return cls(_tops(toolpath, layer - 1).mean(axis=0))

    def at(self, points: Array) -> Array:
        """How far the print is off (n) [m] at places (n, 3) of the top."""
        x, y, z = (2.0 * np.pi * (points - self.middle) / np.asarray(WAVES)).T
        return np.asarray(OFF * np.sin(x + 0.7) * np.cos(y) * np.cos(z))


def scanned(toolpath: Toolpath, layer: int, seed: int = 0, noise: float = NOISE) -> Array:
    """A cloud (n, 3) [m] of the true top of a layer, counted from 1: noisy, with outliers and holes."""
    truth = Truth.of(toolpath, layer)
    random = np.random.default_rng(seed)
    clouds = []
    for bead in toolpath.beads:
        if bead.layer != layer - 1:
            continue
        s = np.arange(0.5 * APART, bead.length, APART)
        p, n = (np.stack([np.interp(s, bead.s, x) for x in v.T], axis=1) for v in (bead.points, bead.normals))
        way = np.gradient(p, s, axis=0)
        side = np.cross(n, way)
        side /= np.linalg.norm(side, axis=1)[:, None]
        for across in np.arange(-0.45, 0.46, APART / float(bead.width.mean())):
            lying = (
                p + (across * float(bead.width.mean()) + 0.2 * APART * random.standard_normal(len(s)))[:, None] * side
            )
            clouds.append(np.hstack([lying, n]))
    found = np.vstack(clouds)
    places, normals = found[:, :3], found[:, 3:]
    kept = np.ones(len(places), dtype=bool)
    while kept.mean() > 1.0 - HOLES:
        kept &= np.linalg.norm(places - places[random.integers(len(places))], axis=1) > HOLE
    places, normals = places[kept], normals[kept]
    height = truth.at(places) + noise * random.standard_normal(len(places))
    wild = random.random(len(places)) < OUTLIERS
    height[wild] += random.uniform(-FAR_OUT, FAR_OUT, int(wild.sum()))
    return np.asarray(places + height[:, None] * normals)


@dataclass(frozen=True)
class Outcome:
    """Of one print: the map, the plan on it, its seconds, and errors by layer above the scanned one [m].

    map_error        of the smoothed map at its cells, at most and root mean square [m]
    over             of the nozzle's height over the true top beneath, less its bead's height, at most, by layer
    beside_nominal   the same less the drawn height
    left             of the true top of each layer from the drawn one, at most
    """

    map: HeightMap
    plan: Plan
    seconds: tuple[float, float]
    map_error: tuple[float, float]
    over: tuple[float, ...]
    beside_nominal: tuple[float, ...]
    left: tuple[float, ...]


def outcome(print_: ScannedPrint, folder: Path, seed: int = 0) -> Outcome:
    """Scan, correct and verify one print; files go into a folder."""
    problem = print_.problem(folder)
    toolpath = build_toolpath(problem)
    cloud = scanned(toolpath, print_.layer, seed)
    begun = time.perf_counter()
    found = height_map(planned_top(toolpath, print_.layer), cloud, radius_of(toolpath), InputError)
    mapped = time.perf_counter()
    write_map(found, folder / "height_map.csv")
    target = folder / f"{print_.name}.yaml"
    text = write_problem(problem, found, print_.layer, bound_of(toolpath, print_.layer, SHARE), folder)
    target.write_text(text, encoding="utf-8")
    corrected = load_problem(target, problem.sources.overrides)
    plan = solve(corrected, baseline=False)
    planned = time.perf_counter()
    off = found.smoothed - Truth.of(toolpath, print_.layer).at(found.top.middle)
    errors = _errors(problem, toolpath, plan, print_.layer)
    seconds = (mapped - begun, planned - mapped)
    return Outcome(found, plan, seconds, (float(np.abs(off).max()), float(np.sqrt((off**2).mean()))), *errors)


def map_errors(print_: ScannedPrint, seeds: int) -> Array:
    """Errors [m] of the map (seeds, 3), for so many scans of a print: root mean square, greatest in measured cells, and in
    those that are interpolated."""
    with tempfile.TemporaryDirectory() as folder:
        toolpath = build_toolpath(print_.problem(Path(folder)))
    top, truth, radius = planned_top(toolpath, print_.layer), Truth.of(toolpath, print_.layer), radius_of(toolpath)
    rows = []
    for seed in range(seeds):
        found = height_map(top, scanned(toolpath, print_.layer, seed), radius, InputError)
        off = np.abs(found.smoothed - truth.at(top.middle))
        rows.append((np.sqrt((off**2).mean()), off[found.measured].max(), off[~found.measured].max(initial=0.0)))
    return np.array(rows)


def _errors(
    problem: Problem, drawn: Toolpath, plan: Plan, layer: int
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """By layer above the scanned one: nozzle over the true top less the bead's height, less the drawn one; what is left."""
    t, over, nominal, left = plan.trajectory, [], [], []
    beneath = _tops(drawn, layer - 1)
    truth = Truth.of(drawn, layer)
    true = truth.at(beneath)
    for level in range(layer, drawn.layers):
        own = [i for i, bead in enumerate(drawn.beads) if bead.layer == level]
        at = np.flatnonzero(t.deposit & np.isin(t.bead, own))
        places, rise, high, normal = [], [], [], []
        for i in np.unique(t.bead[at]):
            k, bead = at[t.bead[at] == i], plan.toolpath.beads[i]
            share = t.s[k] / bead.length
            s = share * drawn.beads[i].length
            p, n = (
                np.stack([np.interp(s, drawn.beads[i].s, x) for x in v.T], axis=1)
                for v in (drawn.beads[i].points, drawn.beads[i].normals)
            )
            places.append(p)
            normal.append(n)
            rise.append(((t.tip[k] - p) * n).sum(axis=1))
            high.append(
                np.stack(
                    [np.interp(s, drawn.beads[i].s, drawn.beads[i].height), np.interp(t.s[k], bead.s, bead.height)]
                )
            )
        tips, rises, (drawn_high, laid) = np.vstack(places), np.concatenate(rise), np.hstack(high)
        feet = tips - (level - layer + 1) * drawn_high[:, None] * np.vstack(normal)
        # the true top beneath: as scanned, then what was laid on it, by the nozzle's height over it
        if level == layer:
            true = truth.at(feet)
        else:
            true = true[cKDTree(beneath).query(feet)[1]]
        over.append(float(np.abs(rises + drawn_high - true - laid).max()))
        nominal.append(float(np.abs(rises - true).max()))
        left.append(float(np.abs(rises).max()))
        beneath, true = feet, rises
    return tuple(over), tuple(nominal), tuple(left)


def _tops(toolpath: Toolpath, level: int) -> Array:
    return np.vstack([bead.points for bead in toolpath.beads if bead.layer == level])


def _write(print_: ScannedPrint, picture: Path | None, cloud: Path | None) -> None:
    """Write the picture of a print's map, or the scan that it is found in, or both."""
    with tempfile.TemporaryDirectory() as folder:
        toolpath = build_toolpath(print_.problem(Path(folder)))
    found = scanned(toolpath, print_.layer)
    if cloud is not None:
        np.savetxt(cloud, found * 1e3, fmt="%.4f")
        print(
            f"{cloud}: {' '.join(('beadwise scan', print_.base, str(cloud), f'--after-layer {print_.layer}'))} "
            f"{' '.join(f'--set {each}' for each in print_.changes)}"
        )
    if picture is not None:
        top = planned_top(toolpath, print_.layer)
        most = bound_of(toolpath, print_.layer, SHARE)
        mapped = height_map(top, found, radius_of(toolpath), InputError)
        write_picture(mapped, print_.layer, layer_heights(toolpath, print_.layer), most, picture)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    names = [each.name for each in PRINTS]
    parser.add_argument(
        "prints", nargs="*", type=one_of(names), metavar="PRINT", help=f"of {', '.join(names)} (default all)"
    )
    parser.add_argument(
        "--seeds", type=int, metavar="N", help="errors of the maps of N scans each, and nothing planned"
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="the map of the first of them, and nothing planned")
    parser.add_argument(
        "--cloud", type=Path, metavar="FILE", help="a scan of the first of them (.xyz), and nothing planned"
    )
    options = parser.parse_args(arguments)
    chosen = options.prints or names
    for print_ in PRINTS:
        if print_.name not in chosen:
            continue
        if options.picture or options.cloud:
            _write(print_, options.picture, options.cloud)
            break
        if options.seeds:
            rms, measured, holes = (map_errors(print_, options.seeds) * 1e3).T
            print(
                f"{print_.name}: {rms.mean():.3f} mm rms; at most, median and worst of {options.seeds}: "
                f"{np.median(measured):.3f}, {measured.max():.3f} measured; {np.median(holes):.3f}, {holes.max():.3f} in holes"
            )
            continue
        with tempfile.TemporaryDirectory() as folder:
            found = outcome(print_, Path(folder))
        verdict = "verified" if found.plan.verified else "NOT verified"
        print(f"{print_.name}, scanned after layer {print_.layer} of {found.plan.toolpath.layers}: {verdict}")
        for check in found.plan.checks:
            if not check.ok:
                print(f"  {check.name}: {check.worst:.4g} {check.unit}, limit {check.limit:.4g} ({check.where})")
        print(
            f"  map: {found.map.covered:.1%} of {len(found.map.measured)} cells measured, noise {found.map.noise * 1e3:.3f} mm;"
        )
        print(f"    off the truth {found.map_error[1] * 1e3:.3f} mm rms, {found.map_error[0] * 1e3:.3f} at most")
        print(f"  {found.seconds[0]:.1f} s for the map, {found.seconds[1]:.1f} s for the plan")
        print("  layer  nozzle over print: off its bead, off the drawing;  top left off, mm")
        for k, row in enumerate(zip(found.over, found.beside_nominal, found.left, strict=True)):
            print("  {:5d}  {:8.3f} {:8.3f} {:8.3f}".format(print_.layer + 1 + k, *(1e3 * value for value in row)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
