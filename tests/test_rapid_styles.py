"""Style `demand`, and programs in several modules: what is written, what is read back, and what is found in them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from export_fixtures import (
    BEAD_AREA,
    GOLDEN,
    SPEED,
    demand_plan,
    in_modules,
    make_plan,
    problem,
    resting_in_a_bead,
    socket_plan,
)

from planner.base.errors import InputError
from planner.export.languages import LANGUAGES
from planner.export.rapid.reader import read_rapid, read_rapid_files
from planner.export.rapid.text import Procedure, batches_of
from planner.export.rapid.writer import rapid, rapid_files
from planner.motion.extrusion import feed, filament_area
from planner.problem.process import ExtruderSpec

RAPID = LANGUAGES["rapid"]


# ---- style demand -------------------------------------------------------------------------------------------------


def test_golden_file():
    assert rapid(demand_plan()) == (GOLDEN / "AskedBead.mod").read_text(encoding="utf-8")


@pytest.mark.parametrize("run_in", [0.003, 0.0])
def test_the_flow_is_asked_for_where_it_is_laid(run_in):
    plan = demand_plan()
    plan.problem.process = plan.problem.process.model_copy(update={"run_in": run_in})
    files = RAPID.write(plan)
    assert RAPID.differences(plan, files) == []
    program = read_rapid(files["AskedBead.mod"])
    ends = sorted(program.triggers)
    # half a volt for each mm3/s, in steps of a hundredth of the largest
    levels = np.array([value for own in program.demands.values() for _, value in own])
    assert levels.max() == pytest.approx(0.5 * SPEED * BEAD_AREA * 1e9, rel=1e-3)
    assert np.abs(levels / levels.max() * 100 - np.round(levels / levels.max() * 100)).max() < 0.01
    assert levels.min() == 0.0 and np.sort(levels)[1] < 0.55 * levels.max()  # the dip, and nothing behind the bead
    assert min(program.demands) == ends[0] and max(program.demands) == ends[-1]
    # distances count from the end of the move
    first = program.demands[ends[0]][0][0]
    length = np.linalg.norm(program.position[ends[0]] - program.position[ends[0] - 1])
    assert first == pytest.approx(0.0 if run_in else length)


@pytest.mark.parametrize(
    ("pattern", "new", "difference"),
    [
        (r"aoDemand,6\.0000", "aoDemand,5.0000", "off by"),
        (r"(trgOff)\\T2:=trgFlow000", r"\1\\T2:=trgFlow100", "outside beads"),
        (r"(trgOn)\\T2:=trgFlow100", r"\1", "off by"),
        (r"TriggC (.*),trgFlow044,z1", r"MoveC \1,z1", "off by"),
        (r"(TriggL .*),trgFlow095,", r"\1,trgFlow099,", "off by"),
    ],
)
def test_another_flow_is_found(pattern, new, difference):
    plan = demand_plan()
    files = RAPID.write(plan)
    text = re.sub(pattern, new, files["AskedBead.mod"], count=1)
    assert text != files["AskedBead.mod"]
    found = RAPID.differences(plan, files | {"AskedBead.mod": text})
    assert any(difference in each for each in found), found


def test_steps_of_the_flow_are_of_what_is_laid_however_fast_pressure_is_built_up():
    plan = make_plan(positioner=False, beads=1, length=0.020, dip=False, detour=False)
    spec, t = problem(False, style="demand", demand_most=1000), plan.trajectory
    spec.name = "asked_bead"
    spec.process = spec.process.model_copy(update={"extruder": ExtruderSpec(lag_s=0.2)})
    fed = feed(t.t, t.bead, t.extruded, t.flow, (), filament_area(spec.process), 0.2)
    plan = replace(plan, problem=spec, trajectory=replace(t, feed=fed))
    files = RAPID.write(plan)
    assert RAPID.differences(plan, files) == []
    levels = np.array([value for own in read_rapid(files["AskedBead.mod"]).demands.values() for _, value in own])
    step = 0.01 * 0.5 * SPEED * BEAD_AREA * 1e9
    assert levels.max() > 110 * step
    usual = levels[levels < 200 * step] / step
    assert np.abs(usual - np.round(usual)).max() < 0.01


def test_a_rest_in_a_bead_is_no_part_of_the_flow_around_it():
    plan = resting_in_a_bead(demand_plan())
    assert RAPID.differences(plan, RAPID.write(plan)) == []


def test_a_flow_beyond_the_output_is_refused():
    with pytest.raises(
        InputError, match=r"program.demand_scale: 12 mm3/s requires 12, and the output only goes up to 10"
    ):
        rapid_files(demand_plan(demand_scale=1))
    plan = demand_plan(demand_scale=1, demand_most=12.5)
    assert RAPID.differences(plan, RAPID.write(plan)) == []


# ---- modules ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("style", ["output", "demand", "socket"])
def test_modules_say_what_one_module_says(style):
    plan = replace(make_plan(), problem=problem(style=style))
    whole = read_rapid_files(rapid_files(plan))
    split = in_modules(plan, 20)
    files = RAPID.write(split)
    assert RAPID.differences(split, files) == []
    assert len([name for name in files if name.endswith(".mod")]) > 5
    assert files["TwoBeads.pgf"] == rapid_files(plan)["TwoBeads.pgf"]
    parts = read_rapid_files(files)
    assert whole.circular.any()
    for name in ("position", "via", "quat", "conf", "external", "linear", "circular", "speed", "wait", "fine"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
    assert (whole.triggers, whole.sends, whole.demands) == (parts.triggers, parts.sends, parts.demands)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_foreign_parser_accepts_modules_and_demands(monkeypatch):
    config = pytest.importorskip("rapidchecker.config")
    monkeypatch.setattr(config.CONFIG, "indentation_size", 4)
    check = pytest.importorskip("rapidchecker.check")
    whitespace = pytest.importorskip("rapidchecker.whitespace_checks")
    files = rapid_files(in_modules(demand_plan(), 4))
    modules = [text for name, text in files.items() if name.endswith(".mod")]
    assert len(modules) == 4 and any("TriggC " in text and "trgOn\\T2:=" in text for text in modules)
    for text in modules:
        assert check.check_format(text) == []
        assert whitespace.check_whitespace(text) == []


def procedure(name, moves, rests):
    return Procedure(name, (), tuple((f"MoveJ {name}{k},z1,",) for k in range(moves)), rests)


def test_modules_end_where_the_robot_rests():
    rows = [procedure("A", 40, True), procedure("B", 40, False), procedure("C", 40, True), procedure("D", 10, True)]
    names = [[[p.name for p in m.procedures] for m in batch] for batch in batches_of("M", rows, 100)]
    assert names == [[["A"]], [["B", "C", "D"]]]
    # where it never rests it is stopped in travel
    rows = [procedure(name, 60, False) for name in "ABC"]
    batches = batches_of("M", rows, 100)
    assert [[m.name for m in batch] for batch in batches] == [["M_1"], ["M_2"], ["M_3"]]
    assert all(batch[-1].procedures[-1].steps[-1][0].endswith(",fine,") for batch in batches)
    # a bead longer than a module is loaded whole, and is not stopped within
    rows = [procedure("A", 10, True), procedure("B", 250, True), procedure("C", 10, True)]
    batches = batches_of("M" * 32, rows, 100)
    assert [[len(m.procedures[0].steps) for m in batch] for batch in batches] == [[10], [83, 83, 84], [10]]
    assert [p.rests for m in batches[1] for p in m.procedures] == [False, False, True]
    assert not any("fine" in step[0] for m in batches[1][:-1] for p in m.procedures for step in p.steps)
    assert {len(m.name) for batch in batches for m in batch} == {32}
    # a rest keeps the bead that it begins with
    (batch,) = batches_of("AVeryLongNameOfAPrintThatFrom123", [procedure("A", 10, True)], 100)
    assert batch[0].name == "AVeryLongNameOfAPrin275From123_1"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("OneBead.mod", '%"Bead0001Part1"%', '%"Bead0002"%', "unknown name"),
        ("OneBead.mod", '        Load \\Dynamic,"HOME:"\\File:="OneBead_1.mod";\n', "", "unknown name"),
        (
            "OneBead.mod",
            'UnLoad "HOME:"\\File:="OneBead_1.mod";',
            'UnLoad "HOME:"\\File:="OneBead_9.mod";',
            "unknown name",
        ),
        ("OneBead.mod", "ERRNO=ERR_UNLOAD", "TRUE", "errors other"),
        ("OneBead.mod", '        UnLoad "HOME:"\\File:="OneBead_1.mod";\n', "", "not unloaded: OneBead_1"),
        ("OneBead.mod", "        RAISE;\n", "", "errors other"),
        ("OneBead_1.mod", "PROC Bead0001Part1", "PROC Start", "twice"),
        ("OneBead_1.mod", "MODULE OneBead_1", "MODULE OneBead_1\n    CONST speeddata vel1:=[1,1,1,1];", "nothing else"),
        (
            "OneBead_1.mod",
            "MODULE OneBead_1",
            "MODULE OneBead_1\n    CONST zonedata zon0_1:=[FALSE,0.1,0.1,0.1,0.01,0.1,0.01];",
            "nothing else",
        ),
        ("OneBead_1.mod", "vel42_3,z5", "vel777,z5", "unknown name"),
        ("OneBead_1.mod", "    ENDPROC", "    ENDPROC\n    ENDPROC", "outside a procedure"),
    ],
)
def test_reader_refuses_other_modules(file, old, new, message):
    files = dict(rapid_files(in_modules(socket_plan(), 3)))
    assert old in files[file]
    files[file] = files[file].replace(old, new, 1)
    with pytest.raises(InputError, match=message) as error:
        read_rapid_files(files)
    assert error.value.file in files


def test_modules_are_loaded_at_rest_and_all_of_them():
    files = rapid_files(in_modules(make_plan(), 30))
    moved = files["TwoBeads.mod"].replace(r"        Load \Dynamic", "        SKIP", 1)
    with pytest.raises(InputError, match="unknown statement"):
        read_rapid_files(files | {"TwoBeads.mod": moved})
    with pytest.raises(InputError, match="not loaded: Other"):
        read_rapid_files(files | {"Other.mod": "MODULE Other\nENDMODULE\n"})
    last = files["TwoBeads_1.mod"].rindex(",fine,")
    flying = files["TwoBeads_1.mod"][:last] + ",z1," + files["TwoBeads_1.mod"][last + 6 :]
    with pytest.raises(InputError, match="at rest"):
        read_rapid_files(files | {"TwoBeads_1.mod": flying})
