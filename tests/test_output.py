"""What of a results folder belongs to an earlier plan, and goes when another plan takes its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from export_fixtures import in_modules, make_plan, socket_plan

from planner.base.files import earlier_results, results_folder
from planner.base.versions import versions
from planner.export.languages import LANGUAGES
from planner.plan import Plan
from planner.problem.settings import MachineSpec


def short(**options: object) -> Plan:
    return make_plan(beads=1, length=0.010, **options)  # type: ignore[arg-type]


def for_machine(flavour: str) -> Plan:
    plan = short()
    rotary = ({"letter": "A", "direction": (1, 0, 0)}, {"letter": "C", "direction": (0, 0, 1)})
    machine = MachineSpec(flavour=flavour, type="table_table", rotary=rotary)
    program = plan.problem.program.model_copy(update={"machine": machine})
    return replace(plan, problem=SimpleNamespace(**vars(plan.problem) | {"program": program}))  # type: ignore[arg-type]


MADE: dict[str, tuple[str, Callable[[], Plan]]] = {
    "modules": ("rapid", lambda: in_modules(make_plan(), 40)),
    "socket": ("rapid", socket_plan),
    "urscript": ("urscript", lambda: short(positioner=False, arm="ur5e")),
    "krl": ("krl", lambda: short(arm="kr6_r900")),
    **{
        name: (name, lambda: short(positioner=False, arm="kr6_r900"))
        for name in ("fanuc", "inform", "val3", "kawasaki", "melfa")
    },
    "joint_trajectory": ("joint_trajectory", lambda: short(positioner=False)),
    "reprap": ("axes", lambda: for_machine("reprap")),
    "linuxcnc": ("axes", lambda: for_machine("linuxcnc")),
}


@pytest.mark.parametrize("kind", MADE)
def test_no_program_of_an_earlier_plan_stays(kind: str, tmp_path: Path) -> None:
    """A program that is there beside a plan that was not verified would be taken for that plan's."""
    language, made = MADE[kind]
    written = LANGUAGES[language].write(replace(made(), versions=versions()))
    assert len(written) >= {"modules": 4, "socket": 3, "krl": 2, "val3": 6, "melfa": 2, "joint_trajectory": 2}.get(
        kind, 1
    )
    for name, text in written.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    with results_folder(tmp_path) as fresh:
        (fresh / "report.html").write_text("refused")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_programs_of_others_stay(tmp_path: Path) -> None:
    theirs = {
        "Tool.mod": "MODULE Tool\nENDMODULE\n",
        "Tool_lines.csv": "n,what\n",
        "part.gcode": "; sliced by another\nG28\n",
        "wash.script": "def wash():\nend\n",
        "fetch.src": "DEF fetch()\nEND\n",
        "fetch.dat": "DEFDAT fetch\nENDDAT\n",
        "pick.ls": "/PROG  PICK\n/END\n",
        "PICK.JBI": "/JOB\n//NAME PICK\n",
        "start.pgx": "<Programs />\n",
        "PICK.prg": "1 Mov J1\n2 End\n",
        "pick.as": ".PROGRAM pick()\n.END\n",
        "pick_joint_trajectory.json": "{}\n",
        "pick_extruder.json": '{"nozzle": 0.4}\n',
        "far_extruder.json": '{"held":{},\n',
        "empty.ngc": "",
        "one_line.gcode": "G1" * 100_000,
    }
    for name, text in theirs.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "photos.mod").mkdir()
    assert earlier_results(tmp_path) == []
