"""Clouds of a scanned layer that are spoilt: each is refused by name, or its height map is that of the print.

python -m benchmarks.attack --only clouds
"""

from __future__ import annotations

import csv
import io
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.attack import files
from benchmarks.attack.cases import ESCAPED, HARMLESS, Case, Chance, Kind, Outcome
from benchmarks.attack.in_process import Said, attack_command, own_folder
from benchmarks.scan import Truth, scanned
from planner.base.arrays import Array
from planner.feedback.scan_command import main
from planner.feedback.scan_telling import MAP, MEASURED
from planner.problem import load_problem
from planner.toolpath.as_printed import COLUMNS
from planner.toolpath.build import build_toolpath

COUNT = 300
PRINT = ("layers.count=4", "layers.source.size_mm=[30, 30]", "resolve.roll_step_deg=30")
NAME, LAYER = "hemisphere_honeycomb", 2
# m by which a map may be off the truth: a measured cell, and what is smoothed over, holes too
OFF, OFF_IN_HOLES = 0.3e-3, 0.4e-3
FITTED = 0.3  # of the clouds are moved first, and fitted

# ---- files ------------------------------------------------------------------------------------------------------------


def ply(points: Array, binary: bool) -> bytes:
    form = "binary_little_endian" if binary else "ascii"
    head = f"ply\nformat {form} 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    with np.errstate(over="ignore"):  # some are spoilt by what no float holds
        return head.encode() + (points.astype("<f4").tobytes() if binary else rows(points, " "))


def rows(points: Array, mark: str) -> bytes:
    return "".join(mark.join(f"{value:.4f}" for value in row) + "\n" for row in points.tolist()).encode()


def numpy_file(save: Callable[[io.BytesIO], object]) -> bytes:
    out = io.BytesIO()
    save(out)
    return out.getvalue()


FORMS: dict[str, tuple[str, Callable[[Array], bytes]]] = {
    "PLY": ("cloud.ply", partial(ply, binary=False)),
    "binary PLY": ("cloud.ply", partial(ply, binary=True)),
    "XYZ": ("cloud.xyz", partial(rows, mark=" ")),
    "CSV": ("cloud.csv", lambda points: b"x_mm,y_mm,z_mm\n" + rows(points, ",")),
    "PTS": ("cloud.pts", lambda points: f"{len(points)}\n".encode() + rows(points, " ")),
    "NPY": ("cloud.npy", lambda points: numpy_file(lambda out: np.save(out, points))),
    "NPZ": ("cloud.npz", lambda points: numpy_file(lambda out: np.savez(out, **dict(zip("xyz", points.T, strict=True))))),
}  # fmt: skip

# ---- changes: (points [mm], random) → points ------------------------------------------------------------------------------


def _random(by: random.Random) -> np.random.Generator:
    return np.random.default_rng(by.getrandbits(30))


def fewer(x: Array, by: random.Random) -> Array:
    return x[_random(by).random(len(x)) < by.choice([0.5, 0.2, 0.05, 0.01])]


def part_missing(x: Array, by: random.Random) -> Array:
    """What the scanner did not see."""
    middle, radius = x[by.randrange(len(x))], by.uniform(1.0, 20.0)
    return x[np.linalg.norm(x - middle, axis=1) > radius]


def outliers(x: Array, by: random.Random) -> Array:
    own = _random(by)
    wild = own.random(len(x)) < by.choice([0.01, 0.1, 0.3, 0.6])
    out = x.copy()
    out[wild] += own.normal(0.0, by.choice([0.5, 3.0, 50.0, 1e4]), (int(wild.sum()), 3))
    return out


def noisy(x: Array, by: random.Random) -> Array:
    return x + _random(by).normal(0.0, by.choice([0.02, 0.1, 0.5, 3.0]), x.shape)


def surroundings(x: Array, by: random.Random) -> Array:
    """Bed and fixtures."""
    own = _random(by)
    more = own.uniform(x.min(axis=0) - 40.0, x.max(axis=0) + 40.0, (by.choice([100, 20_000]), 3))
    more[:, 2] = x[:, 2].min() - by.uniform(3.0, 30.0)
    return np.vstack([x, more])


def twice(x: Array, by: random.Random) -> Array:
    return np.vstack([x, x])


def one_place(x: Array, by: random.Random) -> Array:
    """Many points at one, as scanners write what they have not seen."""
    place = by.choice([np.zeros(3), x[0], np.full(3, 1e6)])
    return np.vstack([x, np.tile(place, (by.choice([10, 5000]), 1))])


def scaled(x: Array, by: random.Random) -> Array:
    return x * by.choice([1e-3, 1e3, 0.1, 10.0, 1 / 25.4, 25.4, 0.0, 1e30, 1.2])


def mirrored(x: Array, by: random.Random) -> Array:
    """Upside down: of a dome from the side nobody could tell."""
    return x * [1.0, 1.0, -1.0]


def axes_swapped(x: Array, by: random.Random) -> Array:
    return x[:, by.choice([[0, 2, 1], [2, 1, 0], [1, 2, 0]])]


def elsewhere(x: Array, by: random.Random) -> Array:
    return x + by.choice([-1.0, 1.0]) * 10.0 ** by.uniform(0.8, 5.0) * np.eye(3)[by.randrange(3)]


def turned(x: Array, by: random.Random) -> Array:
    turn = Rotation.from_rotvec(np.radians(90.0) * np.eye(3)[by.randrange(2)])
    return (x - x.mean(axis=0)) @ turn.as_matrix().T + x.mean(axis=0)


def no_numbers(x: Array, by: random.Random) -> Array:
    out = x.copy()
    for _ in range(by.choice([1, 100])):
        out[by.randrange(len(x)), by.choice([0, 1, 2, slice(None)])] = by.choice(
            [np.nan, np.inf, -np.inf, 1e308, 1e200]
        )
    return out


def flat(x: Array, by: random.Random) -> Array:
    """Another axis is missing."""
    return np.asarray(x * np.where(np.arange(3) == by.randrange(3), 0.0, 1.0))


def shuffled(x: Array, by: random.Random) -> Array:
    return np.asarray(_random(by).permutation(x))


POINT_CHANGES: dict[str, Callable[[Array, random.Random], Array]] = {
    "fewer": fewer, "part missing": part_missing, "outliers": outliers, "noisy": noisy, "surroundings": surroundings,
    "twice": twice, "one place": one_place, "scaled": scaled, "mirrored": mirrored, "axes swapped": axes_swapped,
    "elsewhere": elsewhere, "turned": turned, "no numbers": no_numbers, "flat": flat, "shuffled": shuffled,
}  # fmt: skip

# ---- what becomes of it -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scan:
    """What was printed and scanned: the true top, and a cloud (n, 3) [mm] of it."""

    folder: Path
    truth: Truth
    cloud: Array


def displaced(x: Array, by: random.Random) -> Array:
    """A scanner that does not quite know where the part is: by what a fit makes up for."""
    turn = Rotation.from_rotvec(np.radians(by.uniform(-1.5, 1.5)) * np.array([0.0, 0.0, 1.0]))
    shift = np.array([by.uniform(-2.0, 2.0), by.uniform(-2.0, 2.0), 0.0])
    return (x - x.mean(axis=0)) @ turn.as_matrix().T + x.mean(axis=0) + shift


def attack_cloud(given: Scan, by: Chance) -> Outcome:
    """Spoil a cloud, its points or its file, and have its height map made."""
    own = own_folder(given.folder, by)
    form = by.choice([*FORMS])
    points, whats, options = given.cloud, [], ["--frame", "part"]
    if by.random() < FITTED:
        points, whats, options = displaced(points, by), ["displaced"], [*options, "--fit", "x,y,rz"]
    by_points = by.random() < 0.6
    if by_points:
        for _ in range(by.choice([1, 1, 2])):
            if len(points) and np.abs(points).max() < 1e9:  # what is spoilt beyond that is not spoilt any more
                whats.append(by.choice([*POINT_CHANGES]))
                points = POINT_CHANGES[whats[-1]](points, by)
    name, data = FORMS[form][0], FORMS[form][1](points)
    if not by_points:
        for _ in range(by.choice([1, 1, 2])):
            if data:
                whats.append(by.choice([*files.CHANGES]))
                data = files.CHANGES[whats[-1]](data, by)
    (own / name).write_bytes(data)
    what, out = f"{form}: {', '.join(whats)}", own / "out"
    arguments = [NAME, str(own / name), "--after-layer", str(LAYER), "--map-only", *options, "--out", str(out)]
    try:
        sets = [word for each in PRINT for word in ("--set", each)]
        return attack_command(main, [*arguments, *sets], out, (name,), what, partial(_map, given, out, what))
    finally:
        shutil.rmtree(own)


def _map(given: Scan, out: Path, what: str, said: Said) -> Outcome:
    """Whether the map that was written is the print's."""
    load_problem(out / f"{NAME}_after_{LAYER}.yaml", PRINT)
    with (out / MAP).open(encoding="utf-8", newline="") as stream:
        cells = list(csv.DictReader(stream))
    middle = np.array([[float(cell[name]) for name in COLUMNS[:3]] for cell in cells])
    found = np.array([[float(cell[name]) for name in (COLUMNS[6], "smoothed_mm")] for cell in cells])
    measured = np.array([cell["how"] == MEASURED for cell in cells])
    off = np.abs(1e-3 * found - given.truth.at(1e-3 * middle)[:, None])
    worst = float(off[measured, 0].max()), float(off[:, 1].max())
    bad = worst[0] > OFF or worst[1] > OFF_IN_HOLES or not np.isfinite(worst).all()
    return Outcome(what, ESCAPED if bad else HARMLESS, f"{1e3 * worst[0]:.3f} mm, smoothed {1e3 * worst[1]:.3f}")


def prepared(folder: Path) -> Case:
    """A print whose second layer was scanned."""
    toolpath = build_toolpath(load_problem(NAME, PRINT))
    given = Scan(folder, Truth.of(toolpath, LAYER), scanned(toolpath, LAYER) * 1e3)
    return partial(attack_cloud, given)


KINDS = {"clouds": Kind("clouds of a scanned layer: PLY, text, NumPy", COUNT, prepared)}
