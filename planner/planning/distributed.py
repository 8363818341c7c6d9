"""A large print refined in other processes: beads that lie on each other form a chain, and chains are independent.

Each bead starts from the refined one below it, so the layers of a chain are refined in order; its neighbours in the
layer do not matter, once the ladder has chosen for all beads. Pieces of work are whole chains, or a few short ones
together.
"""

from __future__ import annotations

from collections.abc import Sequence

from planner.base.arrays import Array
from planner.base.distribution import Spread
from planner.base.errors import PlannerError
from planner.planning.context import PlanningContext, context_elsewhere, digest_of, found_anywhere
from planner.resolve.guides import stacks_of
from planner.resolve.joint_path import JointPath, choose_turns
from planner.resolve.ladder import ladder
from planner.resolve.sqp import Priced, given_prices, refine_beads, refine_paths, sigma_floor
from planner.resolve.terms import model_of, terms_of

Joints = tuple[Array, Array, Array, int]  # roll, tilt, joints and branch of a JointPath
# name and overrides of the problem, its digest; prices of a piece's beads, the floor of sigma they must keep; their
# indices
WorkPiece = tuple[tuple[str, tuple[str, ...], str], list[Priced | None], float, list[int], list[Joints]]

LEAST = 4000  # samples of a piece: fewer take longer to send than to refine


def sqp_over(over: Spread, given: PlanningContext) -> tuple[JointPath, ...]:
    """The joint paths of strategy `sqp`, bit for bit, refined in the processes of `over`. Raises Refusal like `sqp`."""
    problem, cell, settings = given.problem, given.cell, given.problem.resolve
    paths = given.start or ladder(cell, given.tasks, settings, given.obstacles)
    if cell.nozzles:  # a worker's model is that of one nozzle
        return refine_paths(cell, paths, settings, given.obstacles)
    prices = given_prices(model_of(cell, given.obstacles, terms_of(settings.weights)), paths, settings)
    floor = sigma_floor(prices, settings)
    where = found_anywhere(problem), problem.overrides, digest_of(problem, cell, given.toolpath, given.tasks)
    pieces: list[WorkPiece] = [
        (where, [prices.get(i) for i in piece], floor, piece, [_joints(paths[i]) for i in piece])
        for piece in pieces_of(paths)
    ]
    done = list(paths)
    for k, refined in over(_refined, pieces):
        if isinstance(refined, PlannerError):
            raise refined
        for i, joints in zip(pieces[k][3], refined, strict=True):
            done[i] = JointPath(paths[i].task, *joints)
    return choose_turns(cell, done)


def pieces_of(paths: Sequence[JointPath]) -> list[list[int]]:
    """Indices of the beads of each piece, in order: chains, the long ones first, several short ones together."""
    chains = stacks_of([path.task for path in paths])
    size = [sum(len(paths[i].task) for i in chain) for chain in chains]
    pieces: list[list[int]] = []
    room = 0
    for k in sorted(range(len(chains)), key=lambda k: -size[k]):
        if room <= 0:
            pieces.append([])
            room = LEAST
        pieces[-1] += chains[k]
        room -= size[k]
    return [sorted(piece) for piece in pieces]


def _refined(piece: WorkPiece) -> list[Joints]:
    """Refine the beads of a piece; runs on a worker."""
    where, prices, floor, beads, joints = piece
    given = context_elsewhere(*where)
    paths = [JointPath(given.tasks[i], *each) for i, each in zip(beads, joints, strict=True)]
    known = {k: price for k, price in enumerate(prices) if price is not None}
    settings = given.problem.resolve
    model = model_of(given.cell, given.obstacles, terms_of(settings.weights))
    return [_joints(path) for path in refine_beads(given.cell, model, paths, settings, known, floor)]


def _joints(path: JointPath) -> Joints:
    return path.roll, path.tilt, path.q, path.branch
