"""Simulators of the hardware of a print: a robot controller and an extruder's board, on this computer's network.

They use the protocols of the real hardware, and know nothing of the programs that talk to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from types import TracebackType

from planner.cell.cell import Cell
from planner.simulate.board import BOARD_FAULTS, CONTROLLER_FAULTS, Record, faults_of
from planner.simulate.controller import OTHER_PROGRAM, Controller, Reader, RunState, own_clock, played_motion
from planner.simulate.rws import RWS_FAULTS, Access, RwsServer
from planner.simulate.servers import HOST, BoardServer, bound_socket


@dataclass(frozen=True)
class Simulated:
    """Both simulators, running until `close` or the end of a with block.

    rws       (host, port) of the controller's web services, user "Default User"
    program   (host, port) where its program listens once started
    board     (host, port)
    """

    rws: tuple[str, int]
    program: tuple[str, int]
    board: tuple[str, int]
    controller: Controller
    _servers: tuple[RwsServer, BoardServer]

    def state(self) -> RunState | None:
        """State of the controller's program; None before there is one."""
        return self.controller.state()

    def board_record(self) -> Record:
        """What the board has done."""
        return self._servers[1].record()

    def requests(self) -> list[str]:
        """The requests to the controller's web services."""
        return self._servers[0].requests()

    def close(self) -> None:
        """End both."""
        self._servers[0].close()
        self.controller.close()
        self._servers[1].close()

    def __enter__(self) -> Simulated:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def start(
    *,
    pace: float = 1.0,
    host: str = HOST,
    controller_faults: Sequence[str] = (),
    board_faults: Sequence[str] = (),
    rws_faults: Sequence[str] = (),
    access: Access | None = None,
    in_use: bool = False,
    board_password: str = "",
    board_tool: int | None = None,
    read: Reader | None = None,
    cell: Cell | None = None,
    arms: int = 1,
) -> Simulated:
    """Start both simulators on free ports; faults as words such as `drop@25` (see `faults_of`).

    access: to the web services, by default as on a new controller; in_use: another program is already loaded.
    read: modules (name → text) → programs, in place of our own RAPID reader; cell: the motion keeps its limits;
    without, it follows the programmed speeds alone. board_tool: selected on the board from the start; arms: of the
    controller.
    Raises InputError for an invalid fault.
    """
    of_controller = faults_of(controller_faults, CONTROLLER_FAULTS)
    of_board = faults_of(board_faults, BOARD_FAULTS)
    of_rws = faults_of(rws_faults, RWS_FAULTS)
    with bound_socket(host, 0) as free:
        program: tuple[str, int] = free.getsockname()
    move = own_clock if cell is None else partial(played_motion, cell=cell)
    controller = Controller(program, pace, of_controller, read, move, OTHER_PROGRAM if in_use else None, arms)
    rws = RwsServer(host, 0, controller, access or Access(), of_rws)
    board = BoardServer(host, 0, pace, of_board, board_password, board_tool)
    return Simulated(rws.address, program, board.address, controller, (rws, board))
