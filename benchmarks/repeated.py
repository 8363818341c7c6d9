"""A print of any length: a plan's motion many times in a row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.plan import Plan


def repeated(plan: Plan, times: int) -> Plan:
    """The plan's motion so many times in a row, from home to home, layers and beads counted on; its events are left out."""
    t = plan.trajectory
    n, beads, layers = len(t), len(plan.toolpath.beads), plan.layers
    each = np.repeat(np.arange(times), n)
    arrays = {name: np.concatenate([value] * times) for name, value in vars(t).items() if isinstance(value, np.ndarray)}
    arrays["t"] = np.arange(times * n) * t.dt
    arrays["bead"] = np.where(arrays["bead"] >= 0, arrays["bead"] + (each * beads).astype(np.int32), arrays["bead"])
    arrays["layer"] = (arrays["layer"] + each * layers).astype(np.int32)
    for name in ("extruded", "feed"):
        arrays[name] = arrays[name] + each * (getattr(t, name)[-1] - getattr(t, name)[0])
    dips = tuple(
        replace(dip, t=dip.t + k * n * t.dt, bead=dip.bead + k * beads, layer=dip.layer + k * layers)
        for k in range(times)
        for dip in plan.dips
    )
    series = {name: np.concatenate([value] * times) for name, value in plan.series.items()}
    laid = tuple(replace(bead, layer=bead.layer + k * layers) for k in range(times) for bead in plan.toolpath.beads)
    toolpath = replace(plan.toolpath, beads=laid)
    return replace(plan, trajectory=replace(t, **arrays, events=()), dips=dips, series=series, toolpath=toolpath)
