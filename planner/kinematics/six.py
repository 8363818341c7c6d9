"""Six by six matrices, compiled: the inverse, and the largest singular value nearly."""

from __future__ import annotations

import numpy as np
from numba import njit

from planner.readonly import Array

_SINGULAR = 1e-12  # pivot below which a matrix has no inverse
_SQUARINGS = 3


@njit(cache=True, nogil=True, error_model="numpy")
def invert6(A: Array, B: Array) -> bool:
    """Fill B with the inverse of A (6, 6), which is spoilt; False if A is singular to rounding (Gauss and Jordan, in
    place: a column that has become one of the unit matrix makes room for one of the inverse)."""
    for k in range(6):
        best, most = k, abs(A[k, k])
        for i in range(k + 1, 6):
            if abs(A[i, k]) > most:
                best, most = i, abs(A[i, k])
        if not most >= _SINGULAR:
            return False
        B[0, k] = best  # noted here until B is filled
        if best != k:
            for j in range(6):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        scale = 1.0 / A[k, k]
        A[k, k] = 1.0
        for j in range(6):
            A[k, j] *= scale
        for i in range(6):
            if i != k:
                f = A[i, k]
                A[i, k] = 0.0
                for j in range(6):
                    A[i, j] -= f * A[k, j]
    for k in range(5, -1, -1):  # rows that changed places are columns of the inverse that did
        best = int(B[0, k])
        if best != k:
            for i in range(6):
                A[i, k], A[i, best] = A[i, best], A[i, k]
    for i in range(6):
        for j in range(6):
            B[i, j] = A[i, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def largest_singular_value(B: Array, M: Array, S: Array) -> float:
    """Of B (6, 6), within 2 % from below, for prices only; M, S (6, 6) are room.

    The column of (B B^T)^8 with the greatest diagonal entry is close to the dominant singular vector; a Rayleigh
    quotient with it gives the value.
    """
    for i in range(6):
        for j in range(6):
            S[i, j], M[i, j] = B[j, i], 0.0
    for i in range(6):  # rows as a whole, for a processor adds several numbers at once, but not to each other
        for k in range(6):
            b = B[i, k]
            for j in range(6):
                M[i, j] += b * S[k, j]
    for _ in range(_SQUARINGS):
        trace = 0.0
        for i in range(6):
            trace += M[i, i]
        for i in range(6):
            for j in range(6):
                S[i, j] = 0.0
            for k in range(6):
                m = M[i, k]
                for j in range(6):
                    S[i, j] += m * M[k, j]
        scale = 1.0 / (trace * trace)
        for i in range(6):
            for j in range(6):
                M[i, j] = S[i, j] * scale
    best = 0
    for i in range(6):
        if M[i, i] > M[best, best]:
            best = i
    above, below = 0.0, 0.0
    for i in range(6):
        below += M[i, best] * M[i, best]
        w = 0.0
        for k in range(6):
            w += B[k, i] * M[k, best]
        above += w * w
    return np.sqrt(above / below)
