"""How controllers move: what a player needs to know of one to predict pace and path. One frozen value for each."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class MotionModel:
    """A controller's way of moving.

    ramp          duration of the S-shaped ramp from rest to 1 m/s [s]; it grows with the cube root of the speed
    peak          ratio of a ramp's greatest acceleration, which the joints must provide, to its mean
    corner        share of the joints' accelerations that is used where a programmed path turns at a target
    settling      time that joints have for such a turn in addition to that spent in the zone [s]; it makes small
                  zones passable
    sharing       exponent that combines the programmed speed with that of a corner; inf: the lesser of the two
    depth         of a corner's path within its zone, as a share of that of a parabola
    lag           time constant with which the arm follows its commands [s], which rounds corners of the path
    ahead_moves   moves beyond the current one that the controller knows, and can brake for
    move_time     longest time to plan a move [s]: `ahead_moves` successive moves take at least this long on average
    assumed       which of these values no public recording shows
    """

    name: str
    ramp: float = 0.0
    peak: float = 1.0
    corner: float = 1.0
    settling: float = 0.0
    sharing: float = float("inf")
    depth: float = 1.0
    lag: float = 0.0
    ahead_moves: int = 10**9
    move_time: float = 0.0
    assumed: tuple[str, ...] = ()


# A controller that does just what the program says: the cell's accelerations, no jerk limits, parabolas in zones.
PLAIN = MotionModel("as programmed")

# Fitted to 48 runs of one corner in RobotStudio and to a real run of curve 1, of an IRB 6640-180/2.55; 144 other runs
# were held out (docs/controller_model.md; hehonglu123/ABB_Primitive_Study and Motion-Primitive-Planning). A real IRC5
# ran 62 lines a second at full speed, and braked from that within 0.1 m, so it knows at least 6 of them.
ABB = MotionModel(
    "ABB IRC5",
    ramp=0.18,
    peak=1.35,
    corner=0.5,
    settling=0.037,
    sharing=3.5,
    depth=0.87,
    lag=0.0197,
    ahead_moves=10,
    move_time=0.016,
    assumed=("ahead_moves",),
)

# ASSUMED: no recording of other controllers was found. They move like the ABB, but may know fewer moves ahead, and take
# other times to plan a move.
ASSUMED = ("ramp", "peak", "corner", "settling", "sharing", "depth", "lag", "ahead_moves", "move_time")
ASSUMED_ABB = {
    "krl": replace(ABB, name="KUKA KR C", ahead_moves=3, move_time=0.012, assumed=ASSUMED),
    "urscript": replace(ABB, name="Universal Robots", move_time=0.008, assumed=ASSUMED),
    "fanuc": replace(ABB, name="FANUC", assumed=ASSUMED),
    "inform": replace(ABB, name="Yaskawa", move_time=0.008, assumed=ASSUMED),
    "val3": replace(ABB, name="Stäubli", move_time=0.008, assumed=ASSUMED),
    "kawasaki": replace(ABB, name="Kawasaki", move_time=0.008, assumed=ASSUMED),
    "melfa": replace(ABB, name="Mitsubishi", assumed=ASSUMED),
}
