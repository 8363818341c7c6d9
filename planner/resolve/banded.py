"""Compiled kernels on banded symmetric matrices: products, Cholesky, and sums of rows' outer products.

A matrix that is factorised is held by its upper band, U (n, w): U[i, d] is the entry (i, i + d). So what a row of the
factor does to the rows after it goes along memory.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Sums may be taken in any order, and products join them without rounding: vectors of the processor ask for both.
SUMS = {"reassoc", "contract"}
_ROWS = 64  # that are multiplied at once: few enough for one thread
_PANEL = 8  # rows of the factor that change the rows after them at once, as one product of matrices


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def times_band(H, x, out) -> None:
    """Fill out with H x; H (n, w) is the lower band, H[i, d] the entry (i, i - d)."""
    n, w = H.shape
    for i in range(n):
        out[i] = H[i, 0] * x[i]
    for i in range(n):
        for d in range(1, min(w, i + 1)):
            out[i] += H[i, d] * x[i - d]
            out[i - d] += H[i, d] * x[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def upper_band(H, U) -> None:
    """Fill U (n, w) with the matrix whose lower band is H (n, w)."""
    n, w = H.shape
    U[:] = 0.0
    for i in range(n):
        for d in range(min(w, i + 1)):
            U[i - d, d] = H[i, d]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def factorise(U) -> bool:
    """Banded Cholesky in place: U (n, w) holds the upper band of a symmetric matrix, then that of its upper factor.

    What lies beyond the matrix's last column must be zero. False where the matrix is not positive definite.
    """
    n, w = U.shape
    panel = np.zeros((_PANEL, w + _PANEL))  # finished rows, each from the first one's diagonal on
    beyond, product = np.zeros((_PANEL, w - 1)), np.empty((w - 1, w - 1))
    for j in range(0, n, _PANEL):
        size = min(_PANEL, n - j)
        for e in range(size):
            for f in range(e):
                share = panel[f, e]
                for d in range(w):
                    U[j + e, d] -= share * panel[f, e + d]
            pivot = U[j + e, 0]
            if not pivot > 0.0:
                return False
            inverse = 1.0 / np.sqrt(pivot)
            for d in range(w):
                U[j + e, d] *= inverse
                panel[e, e + d] = U[j + e, d]
        if j + size < n and w > 1:
            for e in range(size):
                for c in range(w - 1):
                    beyond[e, c] = panel[e, size + c]
            np.dot(beyond.T, beyond, product)
            for c in range(min(w - 1, n - j - size)):
                for d in range(w - 1 - c):
                    U[j + size + c, d] -= product[c, c + d]
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def substitute(U, x) -> None:
    """Solve with a factor of `factorise`, in place."""
    n, w = U.shape
    for i in range(n):
        x[i] /= U[i, 0]
        value = x[i]
        for d in range(1, min(w, n - i)):
            x[i + d] -= U[i, d] * value
    for i in range(n - 1, -1, -1):
        s = x[i]
        for d in range(1, min(w, n - i)):
            s -= U[i, d] * x[i + d]
        x[i] = s / U[i, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def chunks_of(at, group):
    """First groups of chunks, and the number of groups: the rows of a chunk begin at the same variable and are few."""
    groups = group.size - 1
    chunks = np.empty(groups + 1, dtype=np.int64)
    count, rows = 0, 0
    for k in range(groups):
        own = group[k + 1] - group[k]
        if k == 0 or rows + own > _ROWS or (own and rows and at[group[k]] != at[group[k] - 1]):
            chunks[count] = k
            count += 1
            rows = 0
        rows += own
    chunks[count] = groups
    return chunks[: count + 1]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def add_rows(A, at, group, chunks, D, own, S, U) -> None:
    """Add all groups' rows to the Newton matrix U (n, w), their slacks eliminated; D (rows) are the rows' weights, own
    (groups) that of the slack, S (groups) the sum of both.

    A group adds the outer products of its rows, less one for its slack: of its rows with what each is more than a part
    of their mean. Those of a chunk are one product of two matrices, which goes into the band once.
    """
    w = U.shape[1]
    most = 0
    for k in range(chunks.size - 1):
        most = max(most, group[chunks[k + 1]] - group[chunks[k]])
    product, scaled, mean = np.empty((w, w)), np.empty((most, w)), np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        if start == stop:
            continue
        for k in range(chunks[chunk], chunks[chunk + 1]):
            first, end = group[k], group[k + 1]
            if end == first + 1:
                weight = D[first] * own[k] / S[k]  # D - D^2 / S
                for c in range(w):
                    scaled[first - start, c] = weight * A[first, c]
                continue
            mean[:] = 0.0
            for r in range(first, end):
                share = D[r] / S[k]
                for c in range(w):
                    mean[c] += share * A[r, c]
            for r in range(first, end):
                for c in range(w):
                    scaled[r - start, c] = D[r] * (A[r, c] - mean[c])
        np.dot(A[start:stop].T, scaled[: stop - start], product)
        for c in range(w):
            for d in range(w - c):
                U[at[start] + c, d] += product[c, c + d]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def rows_times(A, at, group, chunks, x, out) -> None:
    """Fill out (rows) with A x."""
    w = A.shape[1]
    own = np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        if start < stop:
            for c in range(w):
                own[c] = x[at[start] + c]
        for r in range(start, stop):
            total = 0.0
            for c in range(w):
                total += A[r, c] * own[c]
            out[r] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def add_times_rows(A, at, group, chunks, y, out) -> None:
    """Add A^T y to out (n)."""
    w = A.shape[1]
    own = np.empty(w)
    for chunk in range(chunks.size - 1):
        start, stop = group[chunks[chunk]], group[chunks[chunk + 1]]
        own[:] = 0.0
        r = start
        while r + 4 <= stop:  # four at once: what they add up to is read and written once
            for c in range(w):
                own[c] += y[r] * A[r, c] + y[r + 1] * A[r + 1, c] + y[r + 2] * A[r + 2, c] + y[r + 3] * A[r + 3, c]
            r += 4
        while r < stop:
            for c in range(w):
                own[c] += y[r] * A[r, c]
            r += 1
        if start < stop:
            for c in range(w):
                out[at[start] + c] += own[c]
