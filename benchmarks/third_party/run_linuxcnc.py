"""Runs G-code through LinuxCNC's own interpreter, which its Debian package brings as a module of the system's Python.

/usr/bin/python3 run_linuxcnc.py FILE LETTER

LETTER is the filament's axis. Prints a JSON object: accepted; said; time [s] at the programmed feeds, rapids left out;
filament [mm]; path [mm], the length of X, Y and Z where filament moves. M428 and M429 are remapped to nothing, as
sample configurations remap them to their switching of kinematics.
"""

import json
import math
import os
import sys
import tempfile

MM = 25.4  # the interpreter tells its canon inches
LETTERS = "XYZABCUVW"
SETTINGS = """\
[EMC]
VERSION = 1.1
[RS274NGC]
SUBROUTINE_PATH = {folder}
REMAP = M428 modalgroup=10 ngc=nothing
REMAP = M429 modalgroup=10 ngc=nothing
"""
NOTHING = "o<nothing> sub\no<nothing> endsub\nM2\n"


class Canon:
    """Receives the machine's basic motions; those that it does not count are passed over."""

    def __init__(self, letter, variables):
        self.parameter_file = variables
        self.filament_axis = LETTERS.index(letter)
        self.at = [0.0] * len(LETTERS)
        self.rate = self.time = self.filament = self.path = 0.0
        self.lines = 0

    def next_line(self, state):
        self.lines = state.sequence_number

    def get_axis_mask(self):
        return (1 << len(LETTERS)) - 1

    def get_external_angular_units(self):
        return 1.0

    def get_external_length_units(self):
        return 1.0

    def get_block_delete(self):
        return 0

    def get_tool(self, pocket):
        return (-1, *([0.0] * 12), 0)

    def check_abort(self):
        return False

    def set_feed_rate(self, rate):
        self.rate = rate * MM  # mm/min, or deg/min: both are told divided

    def dwell(self, seconds):
        self.time += seconds

    def straight_traverse(self, *position):
        self.at = list(position)

    def straight_feed(self, *position):
        moved = [b - a for a, b in zip(self.at, position)]  # noqa: B905  # nine both
        self.at = list(position)
        xyz, uvw = math.hypot(*moved[:3]) * MM, math.hypot(*moved[6:]) * MM
        length = xyz or uvw or math.hypot(*moved[3:6])  # what LinuxCNC counts of a line's length
        if length:
            self.time += 60.0 * length / self.rate
        pushed = moved[self.filament_axis] * MM
        self.filament += pushed
        self.path += xyz if pushed > 0.0 else 0.0

    def arc_feed(self, *told):
        end_x, end_y, centre_x, centre_y, turns, end_z, *others = told
        end = [end_x, end_y, end_z, *others]
        a = math.atan2(self.at[1] - centre_y, self.at[0] - centre_x)
        b = math.atan2(end_y - centre_y, end_x - centre_x)
        swept = (b - a) % math.tau if turns > 0 else (a - b) % math.tau
        length = math.hypot(end_x - centre_x, end_y - centre_y) * swept * MM
        pushed = (end[self.filament_axis] - self.at[self.filament_axis]) * MM
        self.at = end
        self.time += 60.0 * length / self.rate
        self.filament += pushed
        self.path += length if pushed > 0.0 else 0.0

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return lambda *_: None


def main(file, letter):
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (("nothing.ngc", NOTHING), ("machine.ini", SETTINGS.format(folder=folder)), ("vars", "")):
            with open(os.path.join(folder, name), "w", encoding="utf-8") as stream:
                stream.write(text)
        os.environ["INI_FILE_NAME"] = os.path.join(folder, "machine.ini")  # read when the module is loaded
        import gcode

        canon = Canon(letter, os.path.join(folder, "vars"))
        result, line = gcode.parse(file, canon, "G21", "")
    accepted = result <= gcode.MIN_ERROR
    said = "" if accepted else f"line {line}: {gcode.strerror(result)}"
    counted = {"time": canon.time, "filament": canon.filament, "path": canon.path}
    print(json.dumps({"accepted": accepted, "said": said, **counted}))


if __name__ == "__main__":
    main(*sys.argv[1:])
