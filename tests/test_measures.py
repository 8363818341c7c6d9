"""Every metric, check, column and key that a plan has is described, and none that no plan has."""

from __future__ import annotations

import ast
import io
import json
from pathlib import Path

from export_fixtures import make_plan
from solved import small_plan

from planner.export.plan_json import DIP_KEYS, KEYS, plan_json
from planner.export.tables import write_table
from planner.plan.measures import CHECKS, COLUMNS, METRICS

ROOT = Path(__file__).resolve().parents[1]
FOUND_IN = sorted((ROOT / "planner" / "verify").rglob("*.py"))
BY_LIMIT = ("velocity", "acceleration", "jerk")  # whose names the verifier puts together
NAMES_A_CHECK = {
    "Check": 0,
    "_check": 0,
    "check_most": 1,
    "check_least": 1,
    "_share_check": 1,
    "_worst": 2,
}  # its name's place


def constants() -> set[str]:
    """Every text in the sources that find metrics and checks."""
    found = set()
    for path in [*FOUND_IN, *(ROOT / "planner" / "planning").glob("*.py")]:
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        found |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return found


def named(tree: ast.AST) -> tuple[set[str], set[str]]:
    """Names of the metrics that a source sets, and of the checks that it makes, as far as they are written out."""
    metrics, checks = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "metrics":
            if isinstance(node.slice, ast.Constant):
                metrics.add(str(node.slice.value))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Findings":
            for given in (
                (each for each in ast.walk(node.args[1]) if isinstance(each, ast.Dict)) if node.args[1:] else ()
            ):
                metrics |= {str(key.value) for key in given.keys if isinstance(key, ast.Constant)}
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in NAMES_A_CHECK:
            at = NAMES_A_CHECK[node.func.id]
            if len(node.args) > at and isinstance(node.args[at], ast.Constant):
                checks.add(str(node.args[at].value))
    return metrics, checks


def test_what_a_solved_plan_has_is_described() -> None:
    plan = small_plan()
    assert set(plan.metrics) <= set(METRICS)
    assert {check.name for check in plan.checks} <= set(CHECKS)
    assert {check.name: check.unit for check in plan.checks} == {
        check.name: CHECKS[check.name].unit for check in plan.checks
    }
    always = {name for name, each in METRICS.items() if not each.only}
    always |= {"wrist_margin_deg", "bound_deposition_time_s", "bound_any_path_s", "bound_gap_fraction"}
    assert set(plan.metrics) == always
    assert {check.name for check in plan.checks} >= {name for name, each in CHECKS.items() if not each.only}


def test_what_the_verifier_can_find_is_described() -> None:
    seen = [named(ast.parse(path.read_text(encoding="utf-8"))) for path in FOUND_IN]
    metrics, checks = (set.union(*each) for each in zip(*seen, strict=True))
    assert len(metrics) > 20 and len(checks) > 25
    assert metrics <= set(METRICS)
    assert checks <= set(CHECKS)


def test_nothing_else_is_described() -> None:
    told = constants() | {f"{name}_ratio_max" for name in BY_LIMIT} | {f"joint {name}" for name in BY_LIMIT}
    assert set(METRICS) | set(CHECKS) <= told


def test_columns_are_those_of_the_table() -> None:
    plan = make_plan()
    stream = io.StringIO()
    write_table(plan, stream)
    assert stream.getvalue().splitlines()[0].split(",") == [*COLUMNS, *plan.cell.joint_names]


def test_keys_of_plan_json() -> None:
    data = json.loads((ROOT / "tests" / "golden" / "plan.json").read_text(encoding="utf-8"))
    assert list(data) == [key for key in KEYS if key in data]
    assert set(KEYS) - set(data) <= {"materials", "nearer", "splits", "tolerance", "refusal"}
    dips = json.loads(plan_json(small_plan()))["dips"]
    assert [list(dip) for dip in dips] == [list(DIP_KEYS)] * len(dips)
    assert dips
