"""Compiled kernels on banded symmetric matrices: products, Cholesky, and sums of rows' outer products."""

from __future__ import annotations

import numpy as np
from numba import njit

# Sums may be taken in any order, and products join them without rounding: vectors of the processor ask for both.
SUMS = {"reassoc", "contract"}
_ROWS = 64  # that are multiplied at once: few enough for one thread


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def times_band(H, x, out) -> None:
    n, w = H.shape
    for i in range(n):
        out[i] = H[i, 0] * x[i]
    for i in range(n):
        for d in range(1, min(w, i + 1)):
            out[i] += H[i, d] * x[i - d]
            out[i - d] += H[i, d] * x[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def factorise(L) -> bool:
    """Banded Cholesky in place: L (n, w) holds the lower band of a symmetric matrix, then that of its factor."""
    n, w = L.shape
    for i in range(n):
        for d in range(min(w - 1, i), -1, -1):
            j = i - d
            s = L[i, d]
            for m in range(d + 1, min(w, i + 1)):
                k = i - m
                if j - k < w:
                    s -= L[i, m] * L[j, j - k]
            if d == 0:
                if s <= 0.0:
                    return False
                L[i, 0] = np.sqrt(s)
            else:
                L[i, d] = s / L[j, 0]
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def substitute(L, x) -> None:
    """Solve with a factor of `factorise`, in place."""
    n, w = L.shape
    for i in range(n):
        s = x[i]
        for d in range(1, min(w, i + 1)):
            s -= L[i, d] * x[i - d]
        x[i] = s / L[i, 0]
    for i in range(n - 1, -1, -1):
        x[i] /= L[i, 0]
        for d in range(1, min(w, i + 1)):
            x[i - d] -= L[i, d] * x[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def add_rows(A, at, group, lam, s, mu, slack, D, S, L) -> None:
    """Add all groups' rows to the Newton matrix L (n, w), their slacks eliminated; fills D (rows) and S (groups).

    A group adds the outer products of its rows, less one for its slack. Those of groups that begin at the same variable
    are products of two matrices, which go into the band once.
    """
    w = L.shape[1]
    block, product = np.zeros((w, w)), np.empty((w, w))
    own, scaled = np.empty((_ROWS, w)), np.empty((_ROWS, w))  # rows, as they are and times their weights
    bands, shares = np.empty((_ROWS, w)), np.empty((_ROWS, w))
    rows, slacks = 0, 0
    for k in range(S.size):
        first, end = group[k], group[k + 1]
        S[k] = mu[k] / slack[k]
        for r in range(first, end):
            D[r] = lam[r] / s[r]
            S[k] += D[r]
        alone = end == first + 1
        bands[slacks] = 0.0
        for r in range(first, end):
            weight = D[r] * mu[k] / (slack[k] * S[k]) if alone else D[r]  # alone: D - D^2 / S
            for c in range(w):
                value = np.float64(A[r, c])
                own[rows, c] = value
                scaled[rows, c] = weight * value
                bands[slacks, c] += weight * value
            rows += 1
            if rows == _ROWS:
                np.dot(scaled.T, own, product)
                block += product
                rows = 0
        if end > first + 1:
            for c in range(w):
                shares[slacks, c] = bands[slacks, c] / -S[k]
            slacks += 1
        last = end == at.size or at[end] != at[first]
        if slacks and (slacks == _ROWS or last):
            np.dot(shares[:slacks].T, bands[:slacks], product)
            block += product
            slacks = 0
        if last and first < end:
            if rows:
                np.dot(scaled[:rows].T, own[:rows], product)
                block += product
            for c in range(w):
                for d in range(c + 1):
                    L[at[first] + c, c - d] += block[c, d]
            block[:] = 0.0
            rows = 0
