"""Compiled: directions that stay within a cone about the vertical, and how near to singular a Jacobian is."""

from __future__ import annotations

import numpy as np

from planner.base.compiled import inner_njit, njit

# ----------------------------------------------------------------------------------------------------
# Compiled kernels on directions that must stay within a cone about the vertical.
#
# The lean of a direction is a vector in the plane whose length is the angle: nearly linear in the joints, whereas the
# cosine of the angle is flat. A cone is a circle in that plane, and in a quadratic program a polygon around it.

# Facets of the polygon around a cone [rad], from where the direction leans: dense there, since a step along a facet
# leaves the circle by the square of its length.
FACETS = np.radians([0.0, 1.5, -1.5, 4.5, -4.5, 10.0, -10.0, 22.0, -22.0, 50.0, -50.0, 110.0, -110.0, 180.0])
FIRST_FACETS = 3  # facets, from the first one on, that the program may watch from the start
NEAR_LEAN = 0.85  # share of a cone's angle above which the program watches a facet from the start
MISSED_LEAN = 1e-5  # rad that a step must exceed a cone by before the program watches another facet
_LEVEL = 1e-7  # sine of the angle to the vertical, below which the lean has no direction


@inner_njit
def lean_of(d, lean) -> None:
    """Fill lean (2) with the horizontal vector towards which a direction d (3) leans, as long as its angle to the
    vertical [rad]."""
    level = np.sqrt(d[0] * d[0] + d[1] * d[1])
    if level > _LEVEL:
        share = np.arctan2(level, d[2]) / level
        lean[0], lean[1] = share * d[0], share * d[1]
    else:
        lean[0], lean[1] = d[0], d[1]
        if d[2] < 0.0:
            lean[0] = np.pi  # upside down, in any direction


@inner_njit
def lean_slope_of(d, spin, slope) -> None:
    """Fill slope (2) with the change of `lean_of` d (3) as d turns about `spin` (3), per radian."""
    x = spin[1] * d[2] - spin[2] * d[1]
    y = spin[2] * d[0] - spin[0] * d[2]
    level = np.sqrt(d[0] * d[0] + d[1] * d[1])
    if level > _LEVEL:
        share = np.arctan2(level, d[2]) / level
        outwards = (d[0] * x + d[1] * y) / level
        # a step outwards turns d by outwards / d_z; across it the vector only turns with d
        angle = d[2] * outwards - level * (spin[0] * d[1] - spin[1] * d[0])
        more = (angle - share * outwards) / level
        slope[0], slope[1] = share * x + more * d[0], share * y + more * d[1]
    else:
        slope[0], slope[1] = (x, y) if d[2] > 0.0 else (0.0, 0.0)


@inner_njit
def facet(lean, k: int):
    """Unit vector of the k-th facet of the polygon around a cone, for a direction that leans as `lean` (2) says."""
    angle = np.arctan2(lean[1], lean[0]) + FACETS[k]
    return np.cos(angle), np.sin(angle)


@njit
def watch_leans(step, lean, cones, watch) -> None:
    """Mark in watch (n, b, facets) the facets of cones (b) [rad] that leans (n, b, 2) are close to."""
    for i in range(len(lean)):
        for c in range(cones.size):
            for k in range(FIRST_FACETS):
                x, y = facet(lean[i, c], k)
                if step[i] > 0.0 and x * lean[i, c, 0] + y * lean[i, c, 1] > NEAR_LEAN * cones[c]:
                    watch[i, c, k] = True


@njit
def watch_missed_leans(step, lean, lean_slope, cones, first, B, free, x, watch):
    """Mark the facets that a step x of the control values goes beyond; returns how many."""
    m = lean_slope.shape[3]
    moved = np.empty(m)
    missed = 0
    for i in range(len(lean)):
        if step[i] == 0.0:
            continue
        for v in range(m):
            moved[v] = 0.0
            for e in range(B.shape[2]):
                moved[v] += B[i, 0, e] * free[first[i] + e] * x[(first[i] + e) * m + v]
        for c in range(cones.size):
            to_x, to_y = lean[i, c, 0], lean[i, c, 1]
            for v in range(m):
                to_x += lean_slope[i, c, 0, v] * moved[v]
                to_y += lean_slope[i, c, 1, v] * moved[v]
            if to_x * to_x + to_y * to_y <= cones[c] * cones[c]:
                continue
            for k in range(FACETS.size):
                u_x, u_y = facet(lean[i, c], k)
                if u_x * to_x + u_y * to_y > cones[c] + MISSED_LEAN and not watch[i, c, k]:
                    watch[i, c, k] = True
                    missed += 1
    return missed


# ----------------------------------------------------------------------------------------------------
# Compiled: parts of the smallest singular value of a Jacobian along a path, by the power method, and of its slope.


@inner_njit
def gram(B, out) -> None:
    """Fill out with B^T B (6, 6)."""
    for a in range(6):
        for b in range(6):
            out[a, b] = B[0, a] * B[0, b]
        for k in range(1, 6):
            for b in range(6):
                out[a, b] += B[k, a] * B[k, b]


@inner_njit
def square(M, out) -> None:
    """Fill out with M M of a symmetric M (6, 6), scaled so that its diagonal sums to 1."""
    trace = 0.0
    for a in range(6):
        for b in range(a, 6):
            # written out as two sums of three products, which do not wait for each other
            x = M[a, 0] * M[b, 0] + M[a, 1] * M[b, 1] + M[a, 2] * M[b, 2]
            out[a, b] = x + (M[a, 3] * M[b, 3] + M[a, 4] * M[b, 4] + M[a, 5] * M[b, 5])
            out[b, a] = out[a, b]
        trace += out[a, a]
    scale = 1.0 / trace
    for a in range(6):
        for b in range(6):
            out[a, b] *= scale


@inner_njit
def power(M, u, w) -> None:
    """Replace u (6) by M u, with a symmetric M (6, 6). w (6) is room."""
    for a in range(6):
        w[a] = M[0, a] * u[0]
    for b in range(1, 6):
        for a in range(6):
            w[a] += M[b, a] * u[b]
    for a in range(6):
        u[a] = w[a]


@inner_njit
def to_unit(u) -> float:
    """Scale u (6) to length 1; returns the length that it had."""
    length = np.sqrt((u[0] * u[0] + u[1] * u[1]) + (u[2] * u[2] + u[3] * u[3]) + (u[4] * u[4] + u[5] * u[5]))
    for a in range(6):
        u[a] /= length
    return length


@inner_njit
def sigma_slope_by_joints(J, u, v, before, after, slope) -> None:
    """Fill slope (na) with d sigma / dq_k = u^T (dJ/dq_k) v, with v (na) of unit length; before, after (6): scratch.

    Turning joint k moves everything after it: d_k x columns k and later, while column k moves its own lever as joints
    before it turn. Running sums from both sides of k make this linear in the number of joints.
    """
    na = v.size
    for a in range(6):
        before[a], after[a] = 0.0, 0.0
    for k in range(na - 1, -1, -1):
        for a in range(6):
            after[a] += J[a, k] * v[k]
        d0, d1, d2 = J[3, k], J[4, k], J[5, k]
        slope[k] = (
            u[0] * (d1 * after[2] - d2 * after[1])
            + u[1] * (d2 * after[0] - d0 * after[2])
            + u[2] * (d0 * after[1] - d1 * after[0])
            + u[3] * (d1 * after[5] - d2 * after[4])
            + u[4] * (d2 * after[3] - d0 * after[5])
            + u[5] * (d0 * after[4] - d1 * after[3])
        )
    for k in range(na):
        d0, d1, d2 = before[3], before[4], before[5]
        slope[k] += (
            u[0] * (d1 * J[2, k] - d2 * J[1, k])
            + u[1] * (d2 * J[0, k] - d0 * J[2, k])
            + u[2] * (d0 * J[1, k] - d1 * J[0, k])
        )
        for a in range(6):
            before[a] += J[a, k] * v[k]
