"""Where the part is, from a scan: thousands of points on the bare part and around it, fitted to its surface.

Weights fall to 0 with the residual (Tukey), within a shrinking reach, so that the bed, fixtures and stray points do not
count. The points on the part give the same kind of fit as contacts, which is judged and reported in the same way.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from planner.base.arrays import Array
from planner.base.errors import Complaint, InputError
from planner.feedback.height_map import robust
from planner.problem.clouds import read_cloud
from planner.register.contacts import Contacts, plate_poses
from planner.register.finding import Ask, Registration, Scene, judged, unknowns_of
from planner.register.fitting import Fit, Placement, Touch, least_moved, split

SCANS = (".ply", ".xyz", ".asc", ".pts", ".npy", ".npz")
MOST = 6_000  # about the number of points used: more add no information
FEWEST = 200  # points that must be near the part
_REACH = (30e-3, 12e-3, 6e-3, 3e-3, 2e-3)  # m: points within this distance count, one after the other
_ROUNDS = 12  # most steps for each reach
_STILL = 1e-7  # m: a smaller step is the last one
_FARTHEST_STEP = 10e-3  # m
_TUKEY = 4.685  # robust deviations: a larger residual has no weight
_KEPT = 3.5  # robust deviations: points farther off are outliers
_LEAST = 0.01e-3  # m: least robust deviation, as no scanner is more accurate
_ROUGHEST = 0.5e-3  # m: a scan with a larger robust deviation is of another part
_BESIDE = 5e-3  # m from a place of the print to the nearest point: farther, there is a hole;
_SPACINGS = 3.0  # or so many spacings of the scan, if that is more
_COVERED = 0.6  # × the places under the print: least share to be covered


def is_scan(file: Path) -> bool:
    """Whether a file's suffix is that of a point cloud; .csv and others are contacts."""
    return file.suffix.lower() in SCANS


def register_scan(scene: Scene, file: Path, ask: Ask, unit: str | None = None) -> Registration:
    """Find the part from a cloud in the world, scanned with the part's holder at home.

    Raises InputError for a cloud that cannot be read, that is in another unit, far from the part, full of holes under the
    print, or of another part, and for one that leaves a freedom undetermined that changes the nozzle's height.
    """
    complain = partial(InputError, file=file)
    cloud = read_cloud(file, unit)
    T_world_plate = plate_poses(scene.cell, scene.cell.home[None, len(scene.cell.arm) :])
    near = _near(scene, T_world_plate, cloud, complain)
    unknowns = unknowns_of(scene, ask, T_world_plate)
    touch = Touch(scene.surface, scene.tangents, _contacts(file, near, T_world_plate), unknowns)
    placement, spread = scene.start, 0.0
    for reach in _REACH:
        placement, spread = _drawn(touch, placement, reach, complain)
    if spread > _ROUGHEST:
        raise complain(
            f"does not lie on this part: wherever that is, points near its surface are {spread * 1e3:.2f} mm off",
            hint="is it this problem's part, bare, and in the world frame?",
        )
    off = touch.residuals(placement)
    there = np.abs(off) <= _REACH[-1]
    touch = replace(touch, contacts=_contacts(file, near[there], T_world_plate))
    kept = np.abs(off[there]) <= _KEPT * spread
    found = Fit(touch, least_moved(touch, scene.start, placement, kept), kept)
    _check_covered(scene, found, complain)
    return judged(scene, ask, found)


def _contacts(file: Path, points: Array, T_world_plate: Array) -> Contacts:
    """Points (n, 3) [m] in the world as unnamed contacts, all with the plate at (1, 4, 4)."""
    n = len(points)
    return Contacts((), np.zeros(n, dtype=np.int64), file, points, None, np.repeat(T_world_plate, n, axis=0))


def _near(scene: Scene, T_world_plate: Array, cloud: Array, complain: Complaint) -> Array:
    """Points (n, 3) [m] near the part's place in the problem, thinned. Raises InputError if there are too few."""

    def off(points: Array) -> Array:
        seen = scene.start.seen(points, np.repeat(T_world_plate, len(points), axis=0))
        return np.abs(scene.surface.signed_distance(seen))

    some = whole = _thinned(cloud)
    if len(whole) < len(cloud):  # in a wide scan of a small part, few of these may be near
        about = _about(scene, T_world_plate[0], cloud)
        some = _thinned(about) if len(about) >= FEWEST else whole
    near = off(some) <= _REACH[0]
    if near.sum() >= FEWEST:
        return np.asarray(some[near])
    for size, factor in (("small", 1e3), ("large", 1e-3)):
        if (off(whole * factor) <= _REACH[0]).sum() >= FEWEST:
            raise complain(
                f"is in another unit: a thousand times too {size}, but otherwise on the part",
                hint="lengths in mm, or --unit m",
            )
    far = off(whole)
    near = far <= _REACH[0]
    raise complain(
        f"is {np.median(far) * 1e3:.0f} mm from where the problem has the part: {near.sum()} of {len(near)} "
        f"points checked lie within {_REACH[0] * 1e3:g} mm of it, and {FEWEST} are needed",
        hint="points in the world, whose origin is the arm's base unless cell.base_mm says otherwise, the part at home",
    )


def _thinned(cloud: Array) -> Array:
    """Points (n, 3), evenly thinned if there are many more than MOST."""
    return cloud[:: max(1, len(cloud) // MOST)]


def _about(scene: Scene, T_world_plate: Array, cloud: Array) -> Array:
    """Points (n, 3) in the box, along the world's axes, that contains everything near part and print."""
    shape = scene.toolpath.shape
    part = np.vstack([scene.points, scene.waypoints.points, *([] if shape is None else [shape.vertices])])
    T = T_world_plate @ scene.start.T_plate_part
    there = part @ T[:3, :3].T + T[:3, 3]
    low, high = there.min(axis=0) - _REACH[0], there.max(axis=0) + _REACH[0]
    return np.asarray(cloud[((cloud >= low) & (cloud <= high)).all(axis=1)])


def _drawn(touch: Touch, placement: Placement, reach: float, complain: Complaint) -> tuple[Placement, float]:
    """The placement that fits the points within `reach` [m] best, and their robust deviation [m]."""
    spread = 0.0
    for _ in range(_ROUNDS):
        residuals = touch.residuals(placement)
        there = np.abs(residuals) <= reach
        if there.sum() < FEWEST:
            raise complain(f"has {there.sum()} points within {reach * 1e3:g} mm of the part: too few to fit")
        some = replace(
            touch, contacts=_contacts(touch.contacts.file, touch.contacts.tips[there], touch.contacts.T_world_plate[:1])
        )
        spread = max(robust(residuals[there]), _LEAST)
        weight = np.clip(1.0 - (residuals[there] / (_TUKEY * spread)) ** 2, 0.0, 1.0) ** 2
        root = np.sqrt(weight)
        J = some.columns(placement)
        seen = split(J[weight > 0.0])[0]
        z = np.linalg.lstsq(root[:, None] * (J @ seen), -root * residuals[there], rcond=None)[0]
        size = float(np.linalg.norm(z))
        placement = placement.moved(
            touch.unknowns.step(seen @ z * min(1.0, _FARTHEST_STEP / max(size, _STILL))), touch.unknowns.centre
        )
        if size < _STILL:
            break
    return placement, spread


def _check_covered(scene: Scene, found: Fit, complain: Complaint) -> None:
    """Raise InputError if the scan has holes under too much of the print."""
    contacts = found.touch.contacts
    points = found.placement.seen(contacts.tips, contacts.T_world_plate)[found.kept]
    tree = cKDTree(points)
    reach = max(_BESIDE, _SPACINGS * float(np.median(tree.query(points, k=2)[0][:, 1])))
    w = scene.waypoints
    lowest = {i for i, bead in enumerate(scene.toolpath.beads) if bead.layer == scene.toolpath.beads[0].layer}
    under = w.points[np.isin(w.bead, list(lowest))]
    far = tree.query(under)[0]
    share = float((far <= reach).mean())
    if share < _COVERED:
        x, y, z = under[int(np.argmax(far))] * 1e3
        raise complain(
            f"covers {share:.0%} of what lies under the print: nothing within {far.max() * 1e3:.1f} mm of x {x:.1f}, "
            f"y {y:.1f}, z {z:.1f} mm of the part",
            hint=f"cover at least {_COVERED:.0%}: scan it from more sides",
        )
