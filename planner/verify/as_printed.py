"""Checks of a print continued on a scanned one: where it begins, and how high the nozzle is above the scan."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planner.plan import Check
from planner.problem.as_printed import AsPrintedSpec
from planner.verify.checks import DIGITS, Findings, Judged, place
from planner.verify.scanned import deviations, normals_along, over_print, scanned_top, still_off

OVER_PRINT = 0.1e-3  # m: the nozzle's height above the print may differ from its bead's height by this much
OVER_LOW = 0.5  # × the bead's height: the same limit for low beads, as beads may be pressed or be made higher
_LOOKS = 4000  # places checked on the first layer above the scan
_MAP_SHARE = 0.1  # of those: least share with measured places around them, since beads may bridge what lies beneath


def as_printed(judged: Judged) -> Findings:
    """Checks and metrics of material laid on a scanned print; none without a scan."""
    spec = judged.problem.as_printed
    if spec is None or not judged.trajectory.deposit.any():
        return Findings()
    top = scanned_top(spec)
    off = deviations(top, top.points, top.normals, spec.smoothing)
    layers = np.full(len(off), max(judged.toolpath.layers - spec.after_layer, 0))
    over, metrics = _over_print(judged, spec)
    return Findings(
        (*_begins_above(judged, spec), *over),
        {
            "print_off_max_mm": float(np.abs(off).max()) * 1e3,
            "print_left_off_max_mm": float(np.abs(still_off(off, spec.most, layers)).max()) * 1e3,
            **metrics,
        },
    )


def _begins_above(judged: Judged, spec: AsPrintedSpec) -> Iterator[Check]:
    """All material is laid above the scanned layer."""
    first = judged.trajectory.first_bead
    layers = [bead.layer for bead in judged.toolpath.beads]
    wrong = sum(layer < spec.after_layer for layer in layers[first:])
    wrong += first == 0
    yield Check("begins above the scanned layer", float(wrong), 0.0, "beads that do not", wrong == 0, f"bead {first}")


def _over_print(judged: Judged, spec: AsPrintedSpec) -> tuple[list[Check], dict[str, float]]:
    """On the first layer above the scan, the nozzle is one bead's height above the map's measured places."""
    t, beads = judged.trajectory, judged.toolpath.beads
    first = np.array([bead.layer == spec.after_layer for bead in beads])
    at = np.flatnonzero(t.deposit & first[t.bead])
    if not len(at):
        return [], {}
    at = at[np.unique(np.linspace(0, len(at) - 1, _LOOKS).astype(np.int64))]
    high = over_print(scanned_top(spec), judged.motion.tip[at], normals_along(judged.toolpath, t, at), spec.smoothing)
    bead = np.array([np.interp(t.s[k], beads[t.bead[k]].s, beads[t.bead[k]].height) for k in at])
    known = ~np.isnan(high)
    off, most = np.where(known, np.abs(high - bead), 0.0), np.minimum(OVER_PRINT, OVER_LOW * bead)
    i = int(np.argmax(off / most))
    seen = float(known.mean())
    ok = bool(off[i] <= most[i] * (1.0 + DIGITS)) and seen >= _MAP_SHARE
    where = place(t, int(at[i])) if seen >= _MAP_SHARE else f"only {seen:.0%} of the layer has measured places nearby"
    worst = Check(
        "nozzle over the print",
        float(off[i]) * 1e3,
        float(most[i]) * 1e3,
        "mm off the bead's height",
        ok,
        where,
        sample=int(at[i]),
    )
    return [worst], {"over_print_error_max_mm": float(off.max()) * 1e3}
