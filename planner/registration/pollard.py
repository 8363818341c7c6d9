"""The turntable and a cylinder on it from contacts at several angles, as published (Pollard et al., eq. 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from planner.readonly import Array, ReadOnlyArrays


@dataclass(frozen=True)
class Turntable(ReadOnlyArrays):
    """Where a table turns and what is on it, seen from above.

    axis (2)    of the table in the world [m];  cylinder (2) the cylinder's own axis on the plate [m]
    off (n, 2)  measured minus estimated places [m];  their absolute values add up to the least that is possible
    """

    axis: Array
    cylinder: Array
    off: Array

    @property
    def cost(self) -> float:
        """Eq. (1b): the mean over contacts of |x| + |y| [m]."""
        return float(np.abs(self.off).sum(axis=1).mean())


def locate(tips: Array, turns: Array, reach: Array) -> Turntable:
    """The axes that bring estimated and measured places closest in the sum of absolute differences.

    tips (n, 2) of the nozzle in the world; turns (n, 2, 2) of the plate; reach (n, 2) from the cylinder's axis to the
    tip, which the paper, whose nozzle always points the same way, counts to the table's axis. A linear program: its
    optimum is exact, where the paper's routine searches for it. Raises ValueError where the angles are all alike.
    """
    n = len(tips)
    A = np.concatenate([np.tile(np.eye(2), (n, 1, 1)), turns], axis=2).reshape(2 * n, 4)
    if np.linalg.matrix_rank(A, tol=1e-3) < 4:
        raise ValueError("the table stands at one angle only")
    b = (tips - reach).ravel()
    least = np.eye(2 * n)
    solved = linprog(
        np.append(np.zeros(4), np.ones(2 * n)),
        A_ub=np.block([[A, -least], [-A, -least]]),
        b_ub=np.append(b, -b),
        bounds=[(None, None)] * 4 + [(0.0, None)] * (2 * n),
    )
    z = solved.x[:4]
    return Turntable(z[:2], z[2:], (b - A @ z).reshape(n, 2))
