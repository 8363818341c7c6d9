"""Generated references: as committed; the schema takes what the loader takes, and refuses most of what it refuses."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from benchmarks.reference.__main__ import MADE, main
from benchmarks.reference.fields import example_of, meaning, sections, shipped_examples, values
from planner.base.errors import InputError
from planner.base.rapid_names import LONGEST_NAME
from planner.base.shipped import PROBLEMS, ROBOTS
from planner.cell.robot import robot_names
from planner.cell.robot_file import KEYS
from planner.problem import Problem, load_problem, shipped_problems
from planner.problem.fields import described
from planner.problem.overrides import apply_overrides, parse_override
from planner.problem.yaml_file import parse_yaml, read_problem_file, read_yaml_file

ROOT = Path(__file__).resolve().parents[1]
MODELINE = "# yaml-language-server: $schema=../docs/problem.schema.json"


@pytest.mark.parametrize("what", MADE)
def test_what_is_committed_is_what_is_made(what: str) -> None:
    told = "python -m benchmarks.reference all"
    file, make = MADE[what]
    assert (ROOT / "docs" / file).read_text(encoding="utf-8") == make(), told


def test_the_command_writes_and_prints_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["all", "--out", str(tmp_path)]) == 0
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")) == sorted(
        file for file, _ in MADE.values()
    )
    capsys.readouterr()
    assert main(["robot-schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "Beadwise robot file"
    (tmp_path / "file").touch()
    assert main(["all", "--out", str(tmp_path / "file")]) == 2


@cache
def schema(what: str) -> jsonschema.Draft7Validator:
    made = json.loads(MADE[what][1]())
    jsonschema.Draft7Validator.check_schema(made)
    return jsonschema.Draft7Validator(made)


def plain(value: Any) -> Any:
    """Values as an editor sees them: lists, not tuples."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, tuple) else value


@pytest.mark.parametrize("name", shipped_problems())
def test_shipped_problems_are_valid_and_name_their_schema(name: str) -> None:
    file = PROBLEMS / f"{name}.yaml"
    assert file.read_text(encoding="utf-8").splitlines()[0] == MODELINE
    assert [error.message for error in schema("schema").iter_errors(plain(read_problem_file(file)[0]))] == []


def test_shipped_robots_are_valid() -> None:
    for name in robot_names():
        file = ROBOTS / f"{name}.yaml"
        assert file.read_text(encoding="utf-8").splitlines()[0] == MODELINE.replace("problem", "robot")
        data, _ = read_yaml_file(file, "")
        assert [error.message for error in schema("robot-schema").iter_errors(plain(data))] == [], name
    data["jerk_rad_s3"] = "high"
    assert not schema("robot-schema").is_valid(plain(data))


# What is wrong by itself, wherever it stands: the schema sees it as the loader does.
WRONG = (
    "layers.cuont=1",
    "layers.count=0",
    "layers.count=1.5",
    "layers.count=many",
    "layers.height_mm=100",
    "layers.wrap=sphere",
    "layers.source.width_mm=wide",
    "layers.source={svg: logo.svg}",
    "layers.source={waypoints: a.txt, width_mm: 3}",
    "layers.project=z",
    "cell.arm=irb9000",
    "cell.arm=irbp_a250",
    "cell.bed_mm=[0, 0, 0]",
    "cell.home_deg=[]",
    "cell.nozzle.tip_mm=[1, 2]",
    "cell.nozzle.diameter_mm=-1",
    "cell.nozzle.diameter_mm='0.6'",
    "cell.positioner.robot=irbp",
    "cell.base={robot: irb140, free: []}",
    "cell.positioner.base_mm=[0, 0, 0]",
    "cell.positioner.free=rotation",
    "cell.fixtures={table: {box_mm: [1, 1, 1], mesh: a.stl}}",
    "cell.limits={joint_1: {speed: 3}}",
    "part={}",
    "part.sphere={radius_mm: 3}",
    "process.speed_mm_s=0",
    "process.bead=0.6",
    "process.bead.section=round",
    "process.hand_over=moving",
    "process.fibre={cut_length_mm: 40, cut_code: [G28]}",
    "process.materials={'1a': {}}",
    "strategy=lader",
    "name=my part",
    f"name={'a' * (LONGEST_NAME + 1)}",
    "program.languages=[rapd]",
    "program.socket.address=here",
    "program.machine={flavour: linuxcnc}",
)


@pytest.mark.parametrize("change", WRONG)
def test_what_the_loader_refuses_the_schema_refuses(change: str) -> None:
    data, source = apply_overrides(*read_problem_file(PROBLEMS / "cylinder_logo.yaml"), [parse_override(change)])
    seen = not schema("schema").is_valid(plain(data))
    try:
        Problem.model_validate(data, context=source)
        refused = False
    except ValueError:
        refused = True
    if not change.startswith(("cell.arm", "cell.positioner.robot", "cell.base")):  # which only the cell finds out
        assert refused
    assert seen


def test_a_missing_section_is_seen() -> None:
    data = plain(read_problem_file(PROBLEMS / "cylinder_logo.yaml")[0])
    for key in ("name", "cell", "layers", "process"):
        assert not schema("schema").is_valid({name: value for name, value in data.items() if key != name})


def test_every_field_has_meaning_values_and_an_example_that_is_taken() -> None:
    examples = shipped_examples()
    count = 0
    for model, places in sections():
        for one in described(model).values():
            text, default = meaning(one)
            where = f"{places[0]}.{one.key}"
            assert text and "; default" not in text and values(one), where
            assert one.required == (not default), where
            example = examples.get((model, one.key)) or example_of(model, one.key)
            count += 1
            if "…" in example:
                continue
            value = parse_yaml(example, lambda reason, *_: InputError(reason), {})
            if one.choices:
                assert set(value if isinstance(value, tuple) else [value]) & set(one.choices) or int in one.types, where
            if one.quantity is not None and one.shape == "value":
                one.quantity.to_si(value)
            if one.quantity is None and one.shape == "value" and not one.choices:
                assert isinstance(value, (dict, str, bool)), where
    assert count > 250


def test_every_key_is_on_its_page() -> None:
    page, robots = MADE["problem"][1](), MADE["robot"][1]()
    for model, _ in sections():
        for one in described(model).values():
            assert f"| `{one.key}` |" in page
    assert all(f"| `{name}` |" in robots for name in KEYS)


def test_described_values_come_back() -> None:
    problem = load_problem("cylinder_logo")
    bead = described(type(problem.process.bead))
    assert bead["width"].shown(problem.process.bead.width) == pytest.approx(0.6)
    home = described(type(problem.cell))["home"]
    assert home.shown(problem.cell.home) == pytest.approx((30, 20, 30, 90, -80, 60))
    held = described(type(problem.cell.positioner))["held"]
    assert held.shown(problem.cell.positioner.held) == {"tilt": 0.0}
    assert held.unit == "deg"


def test_the_citation_names_this_version() -> None:
    data, _ = read_yaml_file(ROOT / "CITATION.cff", "")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (data["version"], data["license"]) == (project["version"], project["license"])
    assert data["title"].lower() == project["name"]
