"""Bad inputs by number: files of waypoints, drawings and joint paths as a broken exporter might write them.

The same number is the same case. Every case is one of the shapes below, spoilt in one to three of the ways below.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.base.arrays import Array

Rng = np.random.Generator

CREEPS = (0.0, 1e-9, 1e-6, 1e-3)  # mm between points that should be one
RADIUS = 120.0  # mm, of the cap of a sphere that waypoints lie on

CAP = """\
name: bad
cell:
  arm: irb140
  nozzle: {{tip_mm: [0, 0, 100], axis: [1, 0, 1], diameter_mm: 0.6}}
  home_deg: [0, 0, 0, 0, 45, 0]
  bed_mm: [450, 0, 150]
  limits: {{joint_5: {{range_deg: [-120, 120]}}}}
layers:
  source: {{waypoints: bad.txt{options}}}
process:
  speed_mm_s: {speed}
  travel_speed_mm_s: 200
  bead: {{width_mm: 0.6, height_mm: 0.5}}
resolve: {{roll_step_deg: 30, rung_mm: 10}}
strategy: {strategy}
"""


# Shapes: points (n, 2) in a plane [mm]


def _line(rng: Rng) -> Array:
    n, length = int(rng.integers(2, 40)), 10 ** rng.uniform(-0.5, 1.5)
    turn = rng.uniform(0.0, 2.0 * np.pi)
    return np.linspace(0.0, length, n)[:, None] * np.array([np.cos(turn), np.sin(turn)])


def _two_points(rng: Rng) -> Array:
    return np.array([[0.0, 0.0], rng.normal(size=2) * 10 ** rng.uniform(-4, 1.3)])


def _one_point(rng: Rng) -> Array:
    return rng.normal(size=(1, 2))


def _there_and_back(rng: Rng) -> Array:
    there = _walk(rng)
    return np.vstack([there, there[::-1][int(rng.integers(0, 2)) :]])


def _zigzag(rng: Rng) -> Array:
    n, pitch = int(rng.integers(3, 12)), 10 ** rng.uniform(-3, 0.5)
    return np.column_stack([(np.arange(n) % 2) * rng.uniform(1.0, 12.0), pitch * np.arange(n)])


def _walk(rng: Rng) -> Array:
    n = int(rng.integers(3, 40))
    turn = np.cumsum(rng.normal(size=n) * 10 ** rng.uniform(-2, 0.3))
    return np.cumsum(np.column_stack([np.cos(turn), np.sin(turn)]) * rng.uniform(0.2, 1.0), axis=0)


def _ring(rng: Rng) -> Array:
    n, radius = int(rng.integers(3, 60)), 10 ** rng.uniform(-2.5, 1.0)
    turn = np.linspace(0.0, 2.0 * np.pi, n + 1)
    return radius * np.column_stack([np.cos(turn), np.sin(turn)])


def _spiral(rng: Rng) -> Array:
    turn = np.linspace(0.0, rng.uniform(2.0, 12.0), int(rng.integers(20, 120)))
    return (turn * rng.uniform(0.05, 0.6))[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])


SHAPES: tuple[Callable[[Rng], Array], ...] = (
    _line, _two_points, _one_point, _there_and_back, _zigzag, _walk, _ring, _spiral,
)  # fmt: skip


# Ways to spoil points (n, 2)


def _repeat(rng: Rng, p: Array) -> Array:
    """Points that stand there several times."""
    return np.repeat(p, rng.integers(1, 5, len(p)), axis=0)


def _creep(rng: Rng, p: Array) -> Array:
    """After some points more of them, a hair further on."""
    step = float(rng.choice(CREEPS))
    times = np.where(rng.random(len(p)) < 0.4, rng.integers(1, 12, len(p)), 1)
    out = np.repeat(p, times, axis=0)
    return out + step * rng.choice([-1.0, 0.0, 1.0], size=out.shape)


def _spike(rng: Rng, p: Array) -> Array:
    """Out to the side and back to the same point."""
    i = int(rng.integers(0, len(p)))
    out = p[i] + rng.normal(size=2) * 10 ** rng.uniform(-3, 1)
    return np.vstack([p[: i + 1], out, p[i:]])


def _tiny_loop(rng: Rng, p: Array) -> Array:
    """A closed loop of next to no size in the middle."""
    i, radius = int(rng.integers(0, len(p))), 10 ** rng.uniform(-6, -0.5)
    turn = np.linspace(0.0, 2.0 * np.pi, int(rng.integers(4, 20)))
    loop = radius * np.column_stack([np.cos(turn) - 1.0, np.sin(turn)])
    return np.vstack([p[:i], p[i] + loop, p[i:]])


def _close_twice(rng: Rng, p: Array) -> Array:
    """Closed by its first point, more than once."""
    return np.vstack([p, np.repeat(p[:1], int(rng.integers(1, 4)), axis=0)])


def _collinear(rng: Rng, p: Array) -> Array:
    """Points on the chords, very near to each other or to the corners."""
    if len(p) < 2:
        return p
    i = int(rng.integers(0, len(p) - 1))
    share = np.sort(rng.random(int(rng.integers(2, 10))) ** int(rng.integers(1, 8)))
    return np.vstack([p[: i + 1], p[i] + share[:, None] * (p[i + 1] - p[i]), p[i + 1 :]])


def _dense_patch(rng: Rng, p: Array) -> Array:
    """A hundred points where there was one step: huge and tiny spacing side by side."""
    if len(p) < 2:
        return p
    i = int(rng.integers(0, len(p) - 1))
    share = np.linspace(0.0, 1.0, 100)[1:-1] * 10 ** rng.uniform(-4, 0)
    return np.vstack([p[: i + 1], p[i] + share[:, None] * (p[i + 1] - p[i]), p[i + 1 :]])


def _noise(rng: Rng, p: Array) -> Array:
    return p + rng.normal(size=p.shape) * 10 ** rng.uniform(-9, -1)


def _step_back(rng: Rng, p: Array) -> Array:
    """Two neighbours in the wrong order."""
    if len(p) < 3:
        return p
    i = int(rng.integers(0, len(p) - 1))
    out = p.copy()
    out[[i, i + 1]] = out[[i + 1, i]]
    return out


def _far(rng: Rng, p: Array) -> Array:
    """One point far off."""
    out = p.copy()
    out[int(rng.integers(0, len(p)))] += rng.normal(size=2) * 10 ** rng.uniform(0, 3)
    return out


def _as_it_is(rng: Rng, p: Array) -> Array:
    return p


WAYS: tuple[Callable[[Rng, Array], Array], ...] = (
    _repeat, _creep, _spike, _tiny_loop, _close_twice, _collinear, _dense_patch, _noise, _step_back, _far, _as_it_is,
)  # fmt: skip


def plane_points(rng: Rng) -> tuple[str, Array]:
    """What a bad path is, in words, and its points (n, 2) [mm]."""
    shape = SHAPES[int(rng.integers(0, len(SHAPES)))]
    p, told = shape(rng), [shape.__name__.strip("_")]
    for k in rng.integers(0, len(WAYS), int(rng.integers(1, 4))):
        p = WAYS[k](rng, p)
        told.append(WAYS[k].__name__.strip("_"))
    return " ".join(told), p


# Files of waypoints


def waypoint_case(seed: int) -> tuple[str, str, str]:
    """What is wrong, in words, a file of waypoints on a cap of a sphere, and further options of the source."""
    rng = np.random.default_rng([1, seed])
    told, rows = [], []
    for _ in range(1 if rng.random() < 0.7 else int(rng.integers(2, 4))):
        words, p = plane_points(rng)
        told.append(words)
        rows.append(_on_cap(p + (rng.normal(size=2) * 8.0 if rows else 0.0)))
    table = np.vstack(rows)
    spoilt = rng.random()
    if spoilt < 0.35:
        words, table = _spoil_normals(rng, table)
        told.append(words)
    digits = int(rng.choice([4, 6, 9, 12]))
    text = "\n".join(" ".join(f"{x:.{digits}f}" for x in row) for row in table)
    split = float(rng.choice([0.5, 5.0, 50.0, 1000.0])) if rng.random() < 0.7 else None  # mm
    return ", ".join(told), text + "\n", "" if split is None else f", split_mm: {split:g}"


def _on_cap(p: Array) -> Array:
    """Rows x y z nx ny nz above plane points, as far as the cap reaches."""
    r = np.minimum(np.linalg.norm(p, axis=1), 0.6 * RADIUS)
    at = p * (r / np.maximum(np.linalg.norm(p, axis=1), 1e-12))[:, None]
    outward = np.column_stack([at, np.sqrt(RADIUS**2 - r**2)]) / RADIUS
    return np.hstack([RADIUS * outward, outward])


def _spoil_normals(rng: Rng, table: Array) -> tuple[str, Array]:
    n = len(table)
    i, out = int(rng.integers(0, n)), table.copy()
    way = str(rng.choice(["flip one", "flip from", "alternate", "zero", "nan", "noise", "along", "inside", "tiny"]))
    if way == "flip one":
        out[i, 3:] *= -1.0
    elif way == "flip from":
        out[i:, 3:] *= -1.0
    elif way == "alternate":
        out[::2, 3:] *= -1.0
    elif way == "zero":
        out[i, 3:] = 0.0
    elif way == "nan":
        out[i, int(rng.integers(0, 6))] = float(rng.choice([np.nan, np.inf, -np.inf]))
    elif way == "noise":
        out[:, 3:] += rng.normal(size=(n, 3)) * 10 ** rng.uniform(-8, 0)
    elif way == "along":  # in the direction of the path: no normal at all
        out[:, 3:] = np.gradient(out[:, :3], axis=0) if n > 1 else out[:, 3:]
    elif way == "inside":
        out[:, 3:] *= -1.0
    else:
        out[:, 3:] *= 1e-7
    return "normals " + way, out


# Drawings


def drawing_case(seed: int) -> tuple[str, str]:
    """What is wrong, in words, and a drawing in mm."""
    rng = np.random.default_rng([2, seed])
    told, shapes = [], []
    for k in range(1 if rng.random() < 0.6 else int(rng.integers(2, 4))):
        words, p = plane_points(rng)
        told.append(words)
        p = p + 15.0 + (rng.normal(size=2) * 4.0 if k else 0.0)
        shapes.append(_shape(rng, p))
    return ", ".join(told), (
        '<svg xmlns="http://www.w3.org/2000/svg" width="30mm" height="30mm" viewBox="0 0 30 30">'
        + "".join(shapes)
        + "</svg>"
    )


def _shape(rng: Rng, p: Array) -> str:
    pairs = [f"{x:.10g},{y:.10g}" for x, y in p]
    way = str(rng.choice(["polyline", "polygon", "path", "closed path", "curves", "relative"]))
    if way in ("polyline", "polygon"):
        return f'<{way} points="{" ".join(pairs)}"/>'
    if way == "curves" and len(p) >= 4:
        return (
            f'<path d="M{pairs[0]} '
            + " ".join("C" + " ".join(pairs[i : i + 3]) for i in range(1, len(p) - 3, 3))
            + '"/>'
        )
    if way == "relative":
        steps = np.diff(p, axis=0)
        return f'<path d="M{pairs[0]} ' + " ".join(f"l{x:.10g},{y:.10g}" for x, y in steps) + '"/>'
    return f'<path d="M{" L".join(pairs)}{" Z" if way == "closed path" else ""}"/>'


# Joint paths


def joint_case(seed: int) -> tuple[str, Array, Array, float]:
    """What is wrong, in words; joints (n, 7) [rad], arc length (n) [m] that does not decrease, commanded speed [m/s]."""
    rng = np.random.default_rng([3, seed])
    n = int(rng.choice([2, 3, 4, 6, int(rng.integers(7, 40)), int(rng.integers(40, 400))]))
    q = _joints(rng, n)
    told = [f"{n} samples"]
    for _ in range(int(rng.integers(1, 3))):
        way = str(rng.choice(["repeat", "hold", "reverse", "kink", "jump", "noise", "constant", "one joint", "smooth"]))
        told.append(way)
        q = _spoil_joints(rng, q, way)
    steps = np.ones(len(q) - 1)
    way = str(rng.choice(["even", "uneven", "hardly", "tiny steps"]))
    if way == "uneven":
        steps = 10.0 ** rng.uniform(-3, 0, len(steps))
    elif way == "hardly":  # nearly all of the way lies in a few steps
        steps = np.where(rng.random(len(steps)) < 0.2, 1.0, 1e-9)
    elif way == "tiny steps":
        steps[int(rng.integers(0, len(steps)))] = 1e-9
    s = np.concatenate([[0.0], np.cumsum(steps)])
    s *= 10 ** rng.uniform(-4, -0.3) / s[-1]
    return " ".join([*told, way]), q, s, float(rng.choice([0.005, 0.04, 0.2, 1.0]))


def _joints(rng: Rng, n: int) -> Array:
    """A gentle random path of seven joints."""
    u = np.linspace(0.0, 1.0, n)[:, None]
    waves = sum(rng.normal(size=7) / k**2 * np.sin(np.pi * k * u + rng.uniform(0, 6, 7)) for k in range(1, 6))
    return np.asarray(waves) * 10 ** rng.uniform(-3, 0)


def _spoil_joints(rng: Rng, q: Array, way: str) -> Array:
    n, i = len(q), int(rng.integers(0, len(q)))
    out = q.copy()
    if way == "repeat":
        out = np.repeat(q, 2, axis=0)[: max(n, 2)]
    elif way == "hold":
        out[i : i + max(n // 5, 1)] = q[i]
    elif way == "reverse":
        out = np.vstack([q, q[::-1]])
    elif way == "kink":
        out[i:] += np.arange(n - i)[:, None] * rng.normal(size=7) * 10 ** rng.uniform(-4, -1)
    elif way == "jump":
        out[i:] += rng.normal(size=7) * 10 ** rng.uniform(-6, -0.5)
    elif way == "noise":
        out += rng.normal(size=q.shape) * 10 ** rng.uniform(-9, -3)
    elif way == "constant":
        out[:] = q[0]
    elif way == "one joint":
        out[:, np.arange(7) != int(rng.integers(0, 7))] = q[0, 0]
    return out
