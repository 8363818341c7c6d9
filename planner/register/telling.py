"""The result in words, as a figure, and as fields of a problem file."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from planner.base.arrays import Array
from planner.base.errors import OutputError
from planner.base.warned import warnings_are
from planner.problem import Problem
from planner.problem.rewrite import Value
from planner.register.contacts import axis_of
from planner.register.finding import MISFIT, Published, Registration, Scene
from planner.register.fitting import Fit, Placement
from planner.register.places import TouchPlaces

# ----------------------------------------------------------------------------------------------------
# The fields of a problem file that place its part and its table.

_MM, _DEG = 4, 5  # decimals: 0.1 um, and about as much at a distance of 1 m
_TURNED = 1e-8  # rad: less is rounding


def changes_of(problem: Problem, placement: Placement, start: Placement, free: Sequence[str]) -> dict[str, Value]:
    """The fields of a problem file that place the part, dotted, with their new values in mm and degrees."""
    cell, out = problem.cell, dict[str, Value]()
    T = placement.T_plate_part
    moved = np.linalg.inv(start.T_plate_part) @ T
    if free:
        name = "cell.bed" if cell.positioner is None else "cell.positioner.part"
        out[f"{name}_mm"] = _mm(T[:3, 3])
        if np.abs(moved[:3, :3] - np.eye(3)).max() > _TURNED:
            out[f"{name}_rpy_deg"] = rpy_degrees(T[:3, :3])
    if cell.positioner is not None and np.abs(placement.shift).max() > 0.0:
        origin = cell.positioner.origin
        key, at = ("base_mm", cell.positioner.base) if origin is None else ("origin_mm", origin)
        out[f"cell.positioner.{key}"] = _mm(np.asarray(at) + placement.shift)
    if placement.growth != 0.0 and problem.part is not None:
        for body, spec in (("cylinder", problem.part.cylinder), ("sphere", problem.part.sphere)):
            if spec is not None:
                out[f"part.{body}.radius_mm"] = _mm(np.array([spec.radius + placement.growth]))[0]
    return out


def rpy_degrees(R: Array) -> list[float]:
    """The turns [deg] about x, then y, then z of the parent's frame that make up a rotation (3, 3)."""
    with warnings_are("ignore", UserWarning):  # gimbal lock at 90 degrees about y: only x is used
        angles = Rotation.from_matrix(R).as_euler("xyz", degrees=True)
    return [float(a) + 0.0 for a in np.round(angles, _DEG)]


def _mm(p: Array) -> list[float]:
    return [float(v) + 0.0 for v in np.round(p * 1e3, _MM)]


# ----------------------------------------------------------------------------------------------------
# A figure of the residuals, and of the uncertainty of the nozzle's height over the beads.

KINDS = (".png", ".html")
_BINS = 60
_GOOD, _BAD = "#3b6ea8", "#c8503c"
_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222}}
pre{{white-space:pre-wrap;background:#f5f5f3;padding:1em}}svg{{max-width:100%;height:auto}}</style></head>
<body><h1>{title}</h1><p><b>{verdict}</b></p>{figure}<pre>{lines}</pre></body></html>
"""


def write_picture(found: Registration, tolerance: float, verdict: str, lines: list[str], target: Path) -> None:
    """Write the figure as PNG, or as a self-contained HTML page with all of the text. Raises OutputError."""
    figure = _figure(found, tolerance)
    try:
        if target.suffix == ".png":
            FigureCanvasAgg(figure).print_png(str(target), metadata={"Software": None})
            return
        stream = io.StringIO()
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
        svg = stream.getvalue()
        page = _PAGE.format(
            title=escape(f"Where {found.scene.problem.name} is"),
            verdict=escape(verdict),
            figure=svg[svg.index("<svg") :],
            lines=escape("\n".join(lines)),
        )
        target.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror}") from error


def _figure(found: Registration, tolerance: float) -> Figure:
    fit, scene, sure = found.fit, found.scene, found.uncertainty
    residuals = fit.residuals * 1e3
    figure = Figure(figsize=(11.0, 4.6), dpi=120, facecolor="white", layout="constrained")
    bars, space = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    # outliers extend beyond the picture, otherwise nothing could be seen of the others
    reach = max(3.0 * float(np.abs(residuals[fit.kept]).max()), tolerance * 1.2e3)
    each = bool(fit.touch.contacts.names)  # otherwise there are thousands
    (_draw_each if each else _draw_many)(bars, fit, reach, tolerance)
    bars.spines[["top", "right"]].set_visible(False)

    shape = scene.toolpath.shape
    if shape is not None:
        space.plot_trisurf(*(shape.vertices.T * 1e3), triangles=shape.triangles, color="#999", alpha=0.12, shade=False)
    points = scene.waypoints.points * 1e3
    dots = space.scatter(*points.T, c=sure.height * 1e3, s=3, cmap="viridis")
    touched = fit.placement.seen(fit.touch.contacts.tips, fit.touch.contacts.T_world_plate) * 1e3
    space.scatter(*touched[fit.kept].T, color=_GOOD, s=30 if each else 0.3, depthshade=False)
    space.scatter(*touched[~fit.kept].T, color=_BAD, s=30, marker="x", depthshade=False)
    if not np.isnan(sure.height).any():
        figure.colorbar(dots, ax=space, shrink=0.7, label="standard error of the nozzle's height [mm]")
    space.set_aspect("equal")
    space.set_title(f"beads and {'contacts' if each else 'scan'}, part frame [mm]", fontsize=10)
    return figure


def _draw_each(axes: Axes, fit: Fit, reach: float, tolerance: float) -> None:
    """A bar for each contact, up to `reach` [mm]."""
    residuals = fit.residuals * 1e3
    shown, at = np.clip(residuals, -reach, reach), np.arange(len(residuals))
    axes.bar(at, shown, color=[_GOOD if kept else _BAD for kept in fit.kept])
    for k in np.flatnonzero(np.abs(residuals) > reach):
        axes.annotate(f"{residuals[k]:+.2f}", (k, shown[k]), ha="center", va="bottom" if shown[k] > 0 else "top")
    for side in (-tolerance, tolerance):
        axes.axhline(side * 1e3, color="#999", linestyle="--", linewidth=0.8)
    axes.set_ylim(-1.15 * reach, 1.15 * reach)
    if len(at) <= 30:
        axes.set_xticks(at, fit.touch.contacts.names, rotation=60 if len(at) > 12 else 0)
    axes.set_ylabel("residual [mm]")
    axes.set_title("contacts: off the surface (outliers in red)", fontsize=10)


def _draw_many(axes: Axes, fit: Fit, reach: float, tolerance: float) -> None:
    """A histogram of the residuals of a scan's points, up to `reach` [mm]."""
    shown = np.clip(fit.residuals * 1e3, -reach, reach)
    axes.hist([shown[fit.kept], shown[~fit.kept]], bins=_BINS, stacked=True, color=[_GOOD, _BAD])
    for side in (-tolerance, tolerance):
        axes.axvline(side * 1e3, color="#999", linestyle="--", linewidth=0.8)
    axes.set_xlabel("residual [mm]")
    axes.set_ylabel("points")
    axes.set_title("points of the scan: off the surface (outliers in red)", fontsize=10)


# ----------------------------------------------------------------------------------------------------
# The result in words: contacts and their residuals, the placement, its uncertainty, and where to touch next.


def verdict(found: Registration, tolerance: float) -> tuple[bool, str]:
    """Whether the nozzle's height stays within a tolerance [m] over all beads with 95 % confidence, also in words."""
    sure, k = found.uncertainty, found.uncertainty.worst
    error, bound = float(sure.height[k]) * 1e3, float(sure.bound[k]) * 1e3
    at = f"{_where(found.scene, k)}"
    if math.isnan(bound):
        many = len(found.fit.residuals) + 1
        return False, (
            "the nozzle's height is not known to stay within the tolerance: there is no contact to spare, so nothing shows "
            f"how exact they are; touch {many} places or more, or give --noise-mm"
        )
    text = f"standard error at most {error:.3f} mm ({at}); within {bound:.3f} mm everywhere with 95 % confidence"
    if bound <= tolerance * 1e3:
        return True, f"the nozzle's height keeps the tolerance of {tolerance * 1e3:g} mm: {text}"
    return False, f"the nozzle's height may leave the tolerance of {tolerance * 1e3:g} mm: {text}"


def lines_of(
    found: Registration,
    changes: Mapping[str, Value],
    further: tuple[TouchPlaces, int, float] | None = None,
) -> list[str]:
    """Everything but the verdict; `further` is the place to touch next, as returned by `suggest_next`."""
    fit, sure = found.fit, found.uncertainty
    outliers = int((~fit.kept).sum())
    scan = not fit.touch.contacts.names
    out = [] if scan else ["contact      residual mm", *(_contact(found, i) for i in range(len(fit.kept)))]
    kept = fit.residuals[fit.kept] * 1e3
    spread = f"{len(kept)} {'points' if scan else 'contacts'} kept, {outliers} outlier{'s' if outliers != 1 else ''}"
    out.append(f"{spread}; root mean square {np.sqrt((kept**2).mean()):.3f} mm, greatest {np.abs(kept).max():.3f} mm")
    if not math.isnan(fit.noise):
        out.append(
            f"noise of a {'point' if scan else 'touch'}, from the residuals: {fit.noise * 1e3:.3f} mm ({fit.spare} to spare)"
        )
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


def published_lines(found: Published, changes: Mapping[str, Value]) -> list[str]:
    """The result of eq. (1) of Pollard et al., contact by contact, and the fields written."""
    table, settled = found.table, found.settled
    off = np.linalg.norm(table.off, axis=1) * 1e3
    mark = np.where(found.right, "", "  outlier").tolist()
    moved = _numbers(np.linalg.norm([settled.axis - table.axis, settled.cylinder - table.cylinder], axis=1) * 1e3, 3)
    return [
        "contact      off mm",
        *(f"{name:<10} {each:+9.3f}{wrong}" for name, each, wrong in zip(found.names, off, mark, strict=True)),
        f"Pollard's eq. (1), sum of absolute differences: {table.cost * 1e3:.3f} mm off on average",
        f"least squares over the contacts that it fits: table and cylinder {moved} mm from there",
        *(f"found {field}: {value}" for field, value in changes.items()),
        "this does not show how sure the nozzle's height is; leave out --published for contacts from all sides",
    ]


def turntable_lines(found: Registration) -> list[str]:
    """The table and the cylinder as published, next to the result of least squares over the wall."""
    table, fit = found.turntable, found.fit
    if table is None:
        return []
    contacts = fit.touch.contacts
    side = "" if contacts.axes is not None else " plus the radius towards the nozzle (its direction is not in the file)"
    published = "Pollard's eq. (1), sum of absolute differences"
    if table.cost > MISFIT:
        why = "it needs a nozzle that always comes from one side, or its direction in the file (ax, ay, az)"
        return [f"{published}: does not fit, {table.cost * 1e3:.1f} mm off on average; {why}"]
    spec = found.scene.problem.part
    centre = np.zeros(2) if spec is None or spec.cylinder is None else np.asarray(spec.cylinder.centre)
    T = fit.placement.T_plate_part
    stands, aside = axis_of(contacts.T_world_plate)
    ours = (T[:3, :3] @ np.append(centre, 0.0) + T[:3, 3])[:2] + aside
    axis = stands + fit.placement.shift[:2]
    off = np.abs(fit.residuals[fit.kept]).mean()
    return [
        f"{published}: table's axis at {_numbers(table.axis * 1e3, 3)} mm{side}, "
        f"cylinder at {_numbers(table.cylinder * 1e3, 3)} mm from it; {table.cost * 1e3:.3f} mm off on average",
        f"least squares over the wall: table's axis at {_numbers(axis * 1e3, 3)} mm"
        f"{'' if found.ask.table else ' (as the problem has it)'}, cylinder at {_numbers(ours * 1e3, 3)} mm from it; "
        f"{off * 1e3:.3f} mm off on average",
    ]


def place_words(scene: Scene, places: TouchPlaces, k: int, placement: Placement) -> str:
    """A place to touch, in the part frame and in the world, and the positions of the holder's axes."""
    p = places.points[k]
    T = places.T_world_plate[k] @ placement.T_plate_part
    world, axis = T[:3, :3] @ p + T[:3, 3] + placement.shift, -T[:3, :3] @ places.normals[k]
    cell = scene.cell
    turned = "".join(
        f", {cell.joint_names[j]} {f'{q * 1e3:.0f} mm' if j in cell.limits.sliding else f'{np.degrees(q):.0f} degrees'}"
        for j, q in enumerate(places.q[k], len(cell.arm))
    )
    return (
        f"part ({_numbers(p * 1e3, 1)}) mm, world ({_numbers(world * 1e3, 1)}) mm{turned}, "
        f"nozzle along ({_numbers(axis, 2)})"
    )


def _contact(found: Registration, i: int) -> str:
    mark = "" if found.fit.kept[i] else "  outlier"
    contacts = found.fit.touch.contacts
    return f"{contacts.names[i]:<10} {found.fit.residuals[i] * 1e3:+12.3f}{mark}".rstrip()


def _moved(found: Registration) -> str:
    """How far the part is from its place in the problem."""
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
