"""Wrong input and impossible prints: both are reported in a sentence, with the place and what would help."""

import numpy as np

from planner import Toolpath, load, solve
from planner.base.errors import InputError, Refusal

points = np.column_stack([np.linspace(0.0, 0.05, 50), np.zeros(50), np.zeros(50)])
normals = np.tile([0.0, 0.0, 1.0], (50, 1))
normals[7] = 0.0
wrong = (
    lambda: load("peer_cap", {"process.sped_mm_s": 30}),
    lambda: load("peer_cap", process__speed_mm_s="fast"),
    lambda: Toolpath.from_arrays(points[:, :2], normals),
    lambda: Toolpath.from_arrays(points, normals),
    lambda: solve("peer_cap", strategy="laddder"),
)
for what in wrong:
    try:
        what()
    except InputError as error:
        print("wrong:", error)

try:
    solve(load("peer_cap", {"cell.bed_mm": [1500, 0, 300]}))
except Refusal as refusal:
    print("no plan:", refusal)
    for hint in refusal.hints:  # changes that were tried
        print("try:", hint)
