"""How accurately a part is found from noisy contacts, some of them wrong: many misplaced parts, not one lucky one.

python -m benchmarks.registration [--seeds 200] [--noise-mm 0.05] [--picture docs/pictures/registration_bowl.png]
python -m benchmarks.registration --published --seeds 100 --solve 3

Each seed displaces the part (3 mm and 2 degrees, standard deviation in each freedom), touches it with noise along the
normal, and registers it from the problem's own placement. Wrong contacts are 0.5 to 5 mm off, to either side. `refused`
is the share of seeds whose contacts, without the wrong ones, do not suffice. `told` is the share of the others in which
the true error of the nozzle's height over all beads is below the bound reported with 95 % confidence.

With --published, a cylinder and its table are displaced and touched from one side at nine angles, as Pollard et al. do, and
go through the command: contacts are written, `register --published` writes the problem, and that is read again. The first
few are planned and verified, and the resulting error of the nozzle's height over the real cylinder is printed.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from benchmarks.command import told
from benchmarks.touching import cartesian, from_one_side, misplaced, tips_of, write_contacts
from planner.base.arrays import Array
from planner.base.errors import EXIT_NOT_VERIFIED, EXIT_VERIFIED, InputError
from planner.cell.cell import build_cell
from planner.plan import Plan
from planner.planning.pipeline import solve
from planner.problem import load_problem
from planner.register.command import main as register_main
from planner.register.contacts import plate_poses
from planner.register.finding import Ask, Registration, Scene, plan_contacts, register, scene_of
from planner.register.fitting import Placement
from planner.register.places import TouchPlaces
from planner.register.telling import lines_of, verdict, write_picture

MOVED_MM, TURNED_DEG = 3.0, 2.0  # standard deviations of where the part really is
WRONG_MM = (0.5, 5.0)
TOLERANCE = 0.1e-3  # m, of the picture
COARSE = ("layers.count=1", "resolve.rung_mm=10", "resolve.roll_step_deg=30", "resolve.table_step_deg=30")
COLUMNS = ("case", "contacts", "wrong", "position mm", "angle deg", "nozzle's height mm", "within", "told", "refused")


PART = Ask()


@dataclass(frozen=True)
class Case:
    """Contacts of a problem: how many, how many of them wrong; limits of position [mm] and angle [deg] that should hold.

    chosen: at places that the planner suggests, or drawn at random among all that the arm reaches
    """

    title: str
    problem: str
    contacts: int
    limits: tuple[float, float]
    wrong: int = 0
    chosen: bool = True
    overrides: tuple[str, ...] = ()
    ask: Ask = PART


WIDE = ("part.ellipsoid.radii_mm=[95, 80, 60]",)
CASES = (
    Case("cylinder, table known", "cylinder_logo", 9, (0.05, np.inf)),
    Case("cylinder, table known", "cylinder_logo", 9, (0.1, np.inf), wrong=2),
    Case("cylinder, random places", "cylinder_logo", 9, (0.05, np.inf), chosen=False),
    Case("cylinder and table", "cylinder_logo", 9, (0.05, np.inf), ask=Ask(table=True)),
    Case("cylinder and table", "cylinder_logo", 9, (0.1, np.inf), wrong=2, ask=Ask(table=True)),
    Case("cylinder and table", "cylinder_logo", 18, (0.05, np.inf), ask=Ask(table=True)),
    Case("bowl", "fibre_bowl", 12, (0.1, 0.1)),
    Case("bowl", "fibre_bowl", 12, (0.2, 0.2), wrong=2),
    Case("bowl, noise known", "fibre_bowl", 12, (0.2, 0.2), wrong=2, ask=Ask(noise=5e-5)),
    Case("bowl, random places", "fibre_bowl", 12, (0.1, 0.1), chosen=False),
    Case("bowl", "fibre_bowl", 24, (0.1, 0.1)),
    Case("bowl", "fibre_bowl", 24, (0.2, 0.2), wrong=5),
    Case("bowl of 190 by 160 mm", "fibre_bowl", 12, (0.1, 0.1), overrides=WIDE),
    Case("bowl of 190 by 160 mm", "fibre_bowl", 24, (0.1, 0.1), overrides=WIDE),
)


def touched(
    scene: Scene,
    case: Case,
    places: TouchPlaces,
    best: Sequence[int],
    noise: float,
    random: np.random.Generator,
    folder: Path,
) -> tuple[Placement, Registration]:
    """One misplaced part: where it really is, and what its contacts say."""
    free = case.ask.free or (("x", "y") if scene.problem.part and scene.problem.part.cylinder else ("x", "y", "z", "r"))
    move = random.normal(0.0, MOVED_MM, 3) * [1.0, 1.0, "z" in free]
    turn = random.normal(0.0, TURNED_DEG, 3) * ("r" in free)
    shift = random.normal(0.0, MOVED_MM, 2) * case.ask.table
    truth = misplaced(scene, move, turn, shift)
    at = np.array(best) if case.chosen else random.choice(len(places), case.contacts, replace=False)
    off = random.normal(0.0, noise, len(at))
    wrong = random.choice(len(at), case.wrong, replace=False)
    off[wrong] += random.uniform(*WRONG_MM, case.wrong) * 1e-3 * random.choice([-1.0, 1.0], case.wrong)
    tips = tips_of(scene, truth, places.points[at], off, places.q[at])
    file = write_contacts(folder / "contacts.csv", cartesian(scene, tips, places.q[at]))
    return truth, register(scene, file, case.ask)


def errors_of(scene: Scene, truth: Placement, found: Registration) -> tuple[float, float, float, bool]:
    """Errors of position [mm] and angle [deg], what no contact can see left out; of the nozzle's height [mm]; and
    whether that was told."""
    now = found.fit.placement
    E = np.linalg.inv(truth.T_plate_part) @ now.T_plate_part
    position = float(np.linalg.norm(E[:3, 3]))
    turn = Rotation.from_matrix(E[:3, :3]).as_rotvec()
    if found.held:
        turn = turn[:2]  # a body of revolution about z
    if scene.problem.part is not None and scene.problem.part.cylinder is not None:
        position = float(np.linalg.norm(E[:2, 3]))
    w, height, told = scene.waypoints, 0.0, True
    plates = (
        scene.home_plates if found.ask.table else plate_poses(scene.cell, scene.cell.home[None, len(scene.cell.arm) :])
    )
    planned = scene.surface.signed_distance(w.points)
    for T in plates:
        world = (T @ now.T_plate_part)[:3, :3] @ w.points.T + ((T @ now.T_plate_part)[:3, 3] + now.shift)[:, None]
        real = truth.seen(world.T, np.broadcast_to(T, (len(w.points), 4, 4)))
        off = np.abs(scene.surface.signed_distance(real) - planned)
        height, told = max(height, float(off.max())), told and bool((off <= found.uncertainty.bound).all())
    return position * 1e3, float(np.degrees(np.linalg.norm(turn))), height * 1e3, told


def row_of(case: Case, seeds: int, noise: float, folder: Path) -> list[str]:
    """One line of the table."""
    scene = scene_of(load_problem(case.problem, case.overrides))
    places, best = plan_contacts(scene, case.ask, case.contacts)
    results = []
    for seed in range(seeds):
        try:
            truth, found = touched(scene, case, places, best, noise, np.random.default_rng(seed), folder)
        except InputError:  # what is left without the wrong contacts says too little, and that is told
            results.append((np.inf, np.inf, np.inf, True))
        else:
            results.append(errors_of(scene, truth, found))
    position, angle, height, told = np.array(results).T
    told = told[np.isfinite(position)]
    within = (position <= case.limits[0]) & (angle <= case.limits[1])
    refused = f"{np.isinf(position).mean() * 100:.0f} %" if np.isinf(position).any() else ""
    limits = f"{case.limits[0]:g} mm" + (f", {case.limits[1]:g}°" if np.isfinite(case.limits[1]) else "")
    return [
        case.title,
        str(case.contacts),
        str(case.wrong),
        _spread(position),
        _spread(angle) if np.isfinite(case.limits[1]) else "",
        _spread(height),
        f"{within.mean() * 100:.1f} % ({limits})",
        f"{told.mean() * 100:.1f} %" if len(told) else "",
        refused,
    ]


@dataclass(frozen=True)
class OneSided:
    """Nine contacts from one side: how well they are aimed [m], how many are wrong."""

    aim: float
    wrong: int = 0


ONE_SIDED = (OneSided(0.0), OneSided(5e-5), OneSided(5e-5, wrong=2), OneSided(1e-3))
ONE_SIDED_COLUMNS = ("aimed to", "wrong", "axis mm", "cylinder mm", "both within 0.05 mm", "verified", "height off by")


def one_sided_row(case: OneSided, seeds: int, solved: int, noise: float, folder: Path) -> list[str]:
    """One line of the published way: errors of axis and cylinder in the problems that the command wrote."""
    scene, off, verified, height = scene_of(load_problem("cylinder_logo")), [], 0, 0.0
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        truth = misplaced(scene, random.normal(0.0, MOVED_MM, 2), (), random.normal(0.0, MOVED_MM, 2))
        wrong = np.zeros(9)
        wrong[random.choice(9, case.wrong, replace=False)] = 1e-3 * random.uniform(*WRONG_MM, case.wrong)
        wrong *= random.choice([-1.0, 1.0], 9)
        file = write_contacts(folder / "contacts.csv", from_one_side(scene, truth, noise, case.aim, random, wrong))
        target = folder / "registered.yaml"
        target.unlink(missing_ok=True)
        with redirect_stdout(io.StringIO()):
            code = register_main([str(file), "cylinder_logo", "--published", "--out", str(target)])
        if code not in (EXIT_VERIFIED, EXIT_NOT_VERIFIED):
            off.append((np.inf, np.inf))
            continue
        written = build_cell(load_problem(target))
        still = np.zeros((1, len(written.holder)))
        real, now = plate_poses(scene.cell, still)[0] @ truth.T_plate_part, written.holder.poses(still)[0]
        axis = plate_poses(written, still)[0, :2, 3] - plate_poses(scene.cell, still)[0, :2, 3] - truth.shift[:2]
        apart = now[:2, 3] - real[:2, 3] - truth.shift[:2] - axis
        off.append((1e3 * float(np.linalg.norm(axis)), 1e3 * float(np.linalg.norm(apart))))
        if seed < solved:
            plan = solve(load_problem(target, COARSE), "ladder", baseline=False)
            verified += plan.verified
            height = max(height, 1e3 * height_error(scene, truth, plan))
    errors = np.array(off).T
    within = (errors <= 0.05).all(axis=0)
    told = [f"{verified} of {solved}", f"{height:.3f} mm"] if solved else ["", ""]
    return [f"{1e3 * case.aim:g} mm", str(case.wrong), *map(_spread, errors), f"{within.mean():.0%}", *told]


def height_error(scene: Scene, truth: Placement, plan: Plan) -> float:
    """How far the nozzle's height over the real cylinder is at most off what was planned [m], where material is laid."""
    part, on = scene.problem.part, plan.trajectory.deposit
    if part is None or part.cylinder is None:
        raise ValueError("the problem has no cylinder")
    q, arm = plan.trajectory.q[on], len(plan.cell.arm)
    tips = plan.cell.arm.poses(q[:, :arm])[:, :3, 3]
    real = truth.seen(tips, plate_poses(scene.cell, q[:, arm:]))
    far, planned = (np.hypot(*(p[:, :2] - part.cylinder.centre).T) for p in (real, plan.trajectory.tip[on]))
    return float(np.abs(far - planned).max())


def one_sided_table(seeds: int, solved: int, noise: float, folder: Path) -> Table:
    """The published way, a line for each case; problems are planned where contacts are right and well aimed."""
    table = Table(title=f"{seeds} cylinders a line, noise {1e3 * noise:g} mm: median, 95th percentile")
    for name in ONE_SIDED_COLUMNS:
        table.add_column(name, justify="right")
    for case in ONE_SIDED:
        table.add_row(*one_sided_row(case, seeds, solved if case == ONE_SIDED[1] else 0, noise, folder))
    return table


def picture(target: Path, noise: float, folder: Path) -> None:
    """The bowl with twelve contacts, two of them wrong, as the first seed has it."""
    case = replace(next(case for case in CASES if case.problem == "fibre_bowl"), wrong=2)
    scene = scene_of(load_problem(case.problem))
    places, best = plan_contacts(scene, case.ask, case.contacts)
    _, found = touched(scene, case, places, best, noise, np.random.default_rng(0), folder)
    write_picture(found, TOLERANCE, verdict(found, TOLERANCE)[1], lines_of(found, {}), target)


def _spread(values: Array) -> str:
    return "{:.3f}, {:.3f}".format(*np.percentile(values, [50, 95], method="lower"))


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.registration", description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=200, help="parts for each line (default 200)")
    parser.add_argument("--noise-mm", type=float, default=0.05, help="standard deviation of a touch (default 0.05)")
    parser.add_argument("--picture", type=Path, help="write a figure of the bowl instead")
    parser.add_argument("--published", action="store_true", help="Pollard's way instead, written and read again")
    parser.add_argument(
        "--solve", type=int, default=0, metavar="N", help="with --published: plan N of the problems, too"
    )
    options = parser.parse_args(arguments)
    noise = options.noise_mm * 1e-3
    table = Table(title=f"{options.seeds} parts a line, noise {options.noise_mm:g} mm: median, 95th percentile")
    for name in COLUMNS:
        table.add_column(name, justify="left" if name == "case" else "right")
    with tempfile.TemporaryDirectory() as folder:
        if options.picture is not None:
            picture(options.picture, noise, Path(folder))
            return EXIT_VERIFIED
        if options.published:
            table = one_sided_table(options.seeds, options.solve, noise, Path(folder))
        for case in () if options.published else CASES:
            table.add_row(*row_of(case, options.seeds, noise, Path(folder)))
            print(f"{len(table.rows)} of {len(CASES)}", file=sys.stderr)
    Console(width=150, highlight=False).print(table)
    return EXIT_VERIFIED


if __name__ == "__main__":
    sys.exit(main())
