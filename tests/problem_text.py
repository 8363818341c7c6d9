"""A problem file as text, and what becomes of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from planner.base.errors import InputError
from planner.problem import Problem, load_problem

# Lines are counted by the tests: keep one section per line.
TEXT = """\
name: test_1
cell:
  arm: irb140
  nozzle: {tip_mm: [-44.51, 9.9, 113.95], axis: [0, 3, 4], diameter_mm: 0.6}
  home_deg: [30, 20, 30, 90, -80, 60]
  positioner:
    robot: irbp_a250
    origin_mm: [633.5, 9.87, 380]
    free: [rotation]
    held_deg: {tilt: 45}
  limits:
    joint_1: {range_deg: [-180, 90], speed_deg_s: 200}
    rotation: {acceleration_rad_s2: 7, jerk_rad_s3: 350}
part:
  cylinder:
    radius_mm: 34
    height_mm: 100
layers:
  source: {svg: drawings/logo.svg, width_mm: 78}
  wrap: cylinder
  count: 10
  height_mm: 0.5
process:
  speed_mm_s: 40
  travel_speed_mm_s: 200
  bead: {width_mm: 0.6}
strategy: greedy
"""


def load(text: str | bytes, overrides: Sequence[str] = ()) -> Problem:
    file = Path("p.yaml")
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_problem(file, overrides)


def refused(text: str | bytes, overrides: Sequence[str] = ()) -> InputError:
    with pytest.raises(InputError) as caught:
        load(text, overrides)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    return caught.value


def swap(old: str, new: str) -> str:
    assert TEXT.count(old) == 1
    return TEXT.replace(old, new)
