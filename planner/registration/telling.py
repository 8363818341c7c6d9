"""What was found, in words: contacts and their residuals, the placement, how sure it is, where to touch next."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from planner.problem.rewrite import Value
from planner.readonly import Array
from planner.registration.finding import MISFIT, Registration, Scene
from planner.registration.placement import Placement
from planner.registration.places import Places


def verdict(found: Registration, tolerance: float) -> tuple[bool, str]:
    """Whether the nozzle's height keeps within a tolerance [m] over all beads with 95 % confidence, and the sentence."""
    sure, k = found.uncertainty, found.uncertainty.worst
    error, bound = float(sure.height[k]) * 1e3, float(sure.bound[k]) * 1e3
    at = f"{_where(found.scene, k)}"
    if math.isnan(bound):
        many = len(found.fit.residuals) + 1
        return False, (
            "the nozzle's height is not known to stay within the tolerance: no contact is to spare, so nothing tells "
            f"how exact they are; touch {many} places or more, or give --noise-mm"
        )
    text = f"standard error at most {error:.3f} mm ({at}); within {bound:.3f} mm everywhere with 95 % confidence"
    if bound <= tolerance * 1e3:
        return True, f"the nozzle's height keeps the tolerance of {tolerance * 1e3:g} mm: {text}"
    return False, f"the nozzle's height may leave the tolerance of {tolerance * 1e3:g} mm: {text}"


def lines_of(
    found: Registration,
    changes: Mapping[str, Value],
    further: tuple[Places, int, float] | None = None,
) -> list[str]:
    """Everything but the verdict; `further` is the place to touch next, as `suggest_next` has it."""
    fit, sure = found.fit, found.uncertainty
    outliers = int((~fit.kept).sum())
    out = ["contact      residual mm", *(_contact(found, i) for i in range(len(fit.kept)))]
    kept = fit.residuals[fit.kept] * 1e3
    spread = f"{len(kept)} contacts kept, {outliers} outlier{'s' if outliers != 1 else ''}"
    out.append(f"{spread}; root mean square {np.sqrt((kept**2).mean()):.3f} mm, greatest {np.abs(kept).max():.3f} mm")
    if not math.isnan(fit.noise):
        out.append(f"noise of a touch, from the residuals: {fit.noise * 1e3:.3f} mm ({fit.spare} to spare)")
    out += [f"found {field}: {value}" for field, value in changes.items()]
    out += [_moved(found)]
    if not np.isnan(sure.position).any():
        at = _numbers(sure.position * 1e3, 3)
        turned = _numbers(np.degrees(sure.angle), 3)
        out.append(f"standard error: {at} mm in x, y, z at the middle of the print, {turned} degrees about them")
        if found.ask.table:
            out.append(f"standard error of the table: {_numbers(sure.shift * 1e3, 3)} mm")
    out += [f"not seen by these contacts, and left as the problem has it: {each}" for each in found.held]
    if found.held:
        out.append("  (the nozzle's height does not depend on it)")
    out += turntable_lines(found)
    if further is not None:
        places, k, left = further
        spot = place_words(found.scene, places, k, fit.placement)
        out.append(f"touch next: {spot}; leaves {left * 100:.0f} % of the worst error")
    return out


def turntable_lines(found: Registration) -> list[str]:
    """The table and the cylinder as published, beside what least squares over the wall say."""
    table, fit = found.turntable, found.fit
    if table is None:
        return []
    contacts = fit.touch.contacts
    side = "" if contacts.axes is not None else " plus the radius towards the nozzle (its direction is not in the file)"
    published = "Pollard's eq. (1), sum of absolute differences"
    if table.cost > MISFIT:
        why = "it takes a nozzle that always comes from one side, or its direction in the file (ax, ay, az)"
        return [f"{published}: does not fit, {table.cost * 1e3:.1f} mm off on average; {why}"]
    spec = found.scene.problem.part
    centre = np.zeros(2) if spec is None or spec.cylinder is None else np.asarray(spec.cylinder.centre)
    T = fit.placement.T_plate_part
    ours = (T[:3, :3] @ np.append(centre, 0.0) + T[:3, 3])[:2]
    axis = contacts.T_world_plate[0, :2, 3] + fit.placement.shift[:2]
    off = np.abs(fit.residuals[fit.kept]).mean()
    return [
        f"{published}: table's axis at {_numbers(table.axis * 1e3, 3)} mm{side}, "
        f"cylinder at {_numbers(table.cylinder * 1e3, 3)} mm from it; {table.cost * 1e3:.3f} mm off on average",
        f"least squares over the wall: table's axis at {_numbers(axis * 1e3, 3)} mm"
        f"{'' if found.ask.table else ' (as the problem has it)'}, cylinder at {_numbers(ours * 1e3, 3)} mm from it; "
        f"{off * 1e3:.3f} mm off on average",
    ]


def place_words(scene: Scene, places: Places, k: int, placement: Placement) -> str:
    """A place to touch, in the part frame and in the world, with the angles of the holder."""
    p = places.points[k]
    T = places.T_world_plate[k] @ placement.T_plate_part
    world, axis = T[:3, :3] @ p + T[:3, 3] + placement.shift, -T[:3, :3] @ places.normals[k]
    names = scene.cell.joint_names[len(scene.cell.arm) :]
    turned = "".join(f", {n} {a:.0f} degrees" for n, a in zip(names, np.degrees(places.q[k]), strict=True))
    return (
        f"part ({_numbers(p * 1e3, 1)}) mm, world ({_numbers(world * 1e3, 1)}) mm{turned}, "
        f"nozzle along ({_numbers(axis, 2)})"
    )


def _contact(found: Registration, i: int) -> str:
    mark = "" if found.fit.kept[i] else "  outlier"
    contacts = found.fit.touch.contacts
    return f"{contacts.names[i]:<10} {found.fit.residuals[i] * 1e3:+12.3f}{mark}".rstrip()


def _moved(found: Registration) -> str:
    """How far the part is from where the problem has it."""
    middle = found.scene.waypoints.points.mean(axis=0)
    start, now = found.scene.start.T_plate_part, found.fit.placement.T_plate_part
    way = (now - start)[:3, :3] @ middle + (now - start)[:3, 3]
    cosine = 0.5 * (np.trace(start[:3, :3].T @ now[:3, :3]) - 1.0)
    text = f"the part is {np.linalg.norm(way) * 1e3:.3f} mm and {np.degrees(np.arccos(min(1.0, cosine))):.3f} degrees"
    text += " from where the problem has it"
    shift = float(np.linalg.norm(found.fit.placement.shift)) * 1e3
    if found.ask.table:
        text += f", on a table that is {shift:.3f} mm from there"
    if found.ask.size:
        text += f"; its radius is {found.fit.placement.growth * 1e3:+.3f} mm off"
    return text


def _where(scene: Scene, k: int) -> str:
    w = scene.waypoints
    bead = scene.toolpath.beads[int(w.bead[k])]
    return f"bead {w.bead[k]}, layer {bead.layer + 1}, {w.s[k] * 1e3:.0f} mm along it"


def _numbers(values: Array, decimals: int) -> str:
    return ", ".join(f"{v:.{decimals}f}" for v in np.round(values, decimals) + 0.0)
