"""A spiral on a cap from two arrays: points and normals."""

import numpy as np

from planner import Toolpath, load, solve, write

RADIUS, TURNS, WIDEST = 0.060, 8, 0.4  # m, and rad from the top of the cap

turn = np.linspace(0.0, 2.0 * np.pi * TURNS, 1200)
polar = WIDEST * np.sqrt(turn / turn[-1] + 0.01)  # evenly spaced where it matters
normals = np.column_stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
spiral = Toolpath.from_arrays(RADIUS * normals, normals)  # metres; unit="mm" for millimetres

plan = solve(load("peer_cap", toolpath=spiral))
print(plan.summary())
for note in plan.toolpath.notes:  # what was changed in the arrays, if anything was
    print("note:", note)
write(plan, "out/spiral")
