"""The smallest singular value against LAPACK's, of matrices of all shapes and of any condition."""

from __future__ import annotations

import numpy as np
import pytest

from planner.base.singular_values import least_singular_values


@pytest.mark.parametrize("shape", [(6, 6), (6, 7), (7, 6), (3, 3), (6, 1), (1, 6)])
def test_it_is_that_of_lapack(shape: tuple[int, int]) -> None:
    """To a few digits of the matrix's own size, as LAPACK's are."""
    rng = np.random.default_rng(3)
    matrices = rng.normal(size=(500, *shape)) * 10.0 ** rng.uniform(-8.0, 8.0, (500, 1, 1))
    matrices[:100, :1] *= 1e-4
    _check(matrices)


def test_it_finds_what_is_nearly_and_what_is_quite_singular() -> None:
    """Columns that are alike but for a trace of another, down to none of it; several that are; equal singular values."""
    rng = np.random.default_rng(4)
    nearly = rng.normal(size=(300, 6, 6))
    nearly[:, :, 0] = nearly[:, :, 1] + 10.0 ** rng.uniform(-16.0, -1.0, (300, 1)) * nearly[:, :, 2]
    turned = np.linalg.qr(rng.normal(size=(20, 6, 6)))[0]
    special = [np.zeros((6, 6)), np.ones((6, 6)), np.eye(6), np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])]
    special += [np.diag([1.0, 0.0, 0.0, 1.0, 1.0, 1.0]), np.eye(6) + np.eye(6, k=1) * 1e-12]
    _check(np.concatenate([nearly, turned, np.stack(special)]))


def test_no_number_comes_of_what_is_none() -> None:
    """NaN and infinity spoil their own matrix alone; of no matrices there are no values."""
    matrices = np.tile(np.eye(6), (3, 1, 1))
    matrices[0, 2, 3], matrices[1, 5, 5] = np.nan, -np.inf
    assert least_singular_values(matrices) == pytest.approx(np.array([np.nan, np.nan, 1.0]), rel=4e-15, nan_ok=True)
    assert least_singular_values(np.zeros((0, 6, 6))).shape == (0,)


def _check(matrices: np.ndarray) -> None:
    known = np.linalg.svd(matrices, compute_uv=False)
    assert (np.abs(least_singular_values(matrices) - known[:, -1]) <= 4e-15 * known[:, 0]).all()
