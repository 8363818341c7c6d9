"""Compiled kernels on banded symmetric matrices: products, Cholesky, and sums of rows' outer products."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def times_band(H, x, out) -> None:
    n, w = H.shape
    for i in range(n):
        out[i] = H[i, 0] * x[i]
    for i in range(n):
        for d in range(1, min(w, i + 1)):
            out[i] += H[i, d] * x[i - d]
            out[i - d] += H[i, d] * x[i]


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def add_rows(A, at, group, lam, s, mu, slack, D, S, L) -> None:
    """Add all groups' rows to the Newton matrix L (n, w), their slacks eliminated; fills D (rows) and S (groups).

    A group adds the outer products of its rows, less one for its slack. They are summed four at a time in a square
    block, whose rows lie in one piece, and go into the band once for all groups that begin at the same variable.
    """
    w = L.shape[1]
    block, band = np.zeros((w, w)), np.empty(w)
    left, right = np.zeros((4, w)), np.zeros((4, w))
    products = 0
    for k in range(S.size):
        first, end = group[k], group[k + 1]
        S[k] = mu[k] / slack[k]
        for r in range(first, end):
            D[r] = lam[r] / s[r]
            S[k] += D[r]
        if first == end:
            continue
        alone = end == first + 1
        band[:] = 0.0
        for r in range(first, end if alone else end + 1):
            if r == end:
                for c in range(w):
                    left[products, c], right[products, c] = -band[c] / S[k], band[c]
            else:
                own = D[r] * mu[k] / (slack[k] * S[k]) if alone else D[r]  # alone: D - D^2 / S
                for c in range(w):
                    left[products, c], right[products, c] = own * A[r, c], A[r, c]
                    band[c] += left[products, c]
            products += 1
            if products == 4:
                _add_four(left, right, block)
                products = 0
        if end == at.size or at[end] != at[first]:
            left[products:] = 0.0
            _add_four(left, right, block)
            products = 0
            for c in range(w):
                for d in range(c + 1):
                    L[at[first] + c, c - d] += block[c, d]
            block[:] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _add_four(left, right, block) -> None:
    """Add the outer products of the four rows of left and right (4, w) to block (w, w)."""
    w = block.shape[0]
    for c in range(w):
        l0, l1, l2, l3 = left[0, c], left[1, c], left[2, c], left[3, c]
        for d in range(min(w, (c // 8 + 1) * 8)):  # the lower triangle, in whole vectors
            block[c, d] += l0 * right[0, d] + l1 * right[1, d] + l2 * right[2, d] + l3 * right[3, d]
