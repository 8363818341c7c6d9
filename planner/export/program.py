"""What a robot program does once it is read back, whatever its language."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array

UNSAID = -128  # in place of a part of a configuration


@dataclass(frozen=True)
class Trigger:
    """Switches the extruder of a digital output `distance` [m] from the end of a move, or from its start."""

    distance: float
    from_start: bool
    value: bool
    signal: str


@dataclass(frozen=True)
class Program:
    """What a program does, in the order in which it runs (m moves; SI units, radians).

    tool, uframe, oframe       (7,) x y z [m], quaternion x y z w
    station                    mechanical unit that moves the part; empty for a fixed bed
    start                      (12,) joints and station axes of the first move [rad], NaN where unused
    linear, fine               (m,) bool
    position, quat             (m, 3) [m], (m, 4) x y z w
    conf                       (m, 4) cf1, cf4, cf6, cfx; UNSAID where the language has none
    external                   (m, 6) station axes [rad], NaN where unused
    zone                       (m,) radius of the corner zone at the target [m]; 0 where the motion comes to rest,
                               NaN where no distance says how large it is
    speed                      (m, 4) tip [m/s], reorientation [rad/s], linear axes [m/s], rotating axes [rad/s]
    wait                       (m,) time at rest after the move [s]
    triggers                   move → its triggers, in order
    joints                     (m, n) of the arm at targets of joint moves, where the language says them [rad]
    demands                    move → (distance [m] from its end, value that an analog output takes there), in order
    sends                      move → strings sent to the extruder's board after it, in order; -1: before the first
    send_rests                 move → for each of them, how long the robot has rested there when it is sent [s]
    """

    module: str
    tool: Array
    uframe: Array
    oframe: Array
    station: str
    start: Array
    linear: NDArray[np.bool_]
    fine: NDArray[np.bool_]
    position: Array
    quat: Array
    conf: NDArray[np.intp]
    external: Array
    zone: Array
    speed: Array
    wait: Array
    triggers: dict[int, tuple[Trigger, ...]]
    sends: dict[int, tuple[str, ...]]
    send_rests: dict[int, tuple[float, ...]] = field(default_factory=dict)
    demands: dict[int, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    joints: Array | None = None
