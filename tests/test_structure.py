"""The rooms of the house and the way through them, held by reading the sources."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "planner"
LONGEST_MODULE = 350  # lines: beyond, a module is two ideas

# From left to right. A module sees its own room and those to the left.
ROOMS = (
    "errors",
    "readonly",
    "interrupts",
    "garbage",
    "background",
    "problem",
    "input_file",
    "facets",
    "solids",
    "point_tree",
    "least_singular",
    "kinematics",
    "robot",
    "cell",
    "toolpath",
    "surface_points",
    "print_body",
    "run_ends",
    "process",
    "task",
    "obstacles",
    "given",
    "resolve",
    "cubics",
    "timing",
    "travel",
    "plan",
    "extrusion",
    "events",
    "nearest",
    "motion",
    "dips",
    "replay",
    "verify",
    "headroom",
    "export",
    "measures",
    "report",
    "plots",
    "versions",
    "spread",
    "chains",
    "progress",
    "output",
    "listing",
    "command",
    "problem_words",
    "check",
    "robots",
    "new",
    "planning",
    "solve",
    "placement",
    "place",
    "registration",
    "register",
    "view",
    "simulate",
    "link",
    "reference",
)
EVERYWHERE = {"errors"}
# Rooms that see less than what is to their left, when the program runs.
NARROW = {
    "": {"garbage", "interrupts"},
    "garbage": {"errors"},
    "readonly": {"errors"},
    "nearest": {"errors", "readonly"},
    "versions": {"errors"},
    "spread": {"errors", "interrupts", "versions"},
    "progress": {"errors"},
    "interrupts": {"errors"},
    "robot": {"errors", "problem", "solids", "kinematics"},
    "surface_points": set(),
    "run_ends": {"toolpath"},
    "listing": {"problem"},
    "problem_words": {"problem"},
    "output": {"errors", "interrupts"},
    "command": {"errors", "garbage", "interrupts", "problem", "plan", "spread"},
    "background": {"errors", "interrupts"},
    "export": {"errors", "plan"},
    "measures": set(),
    "report": {"errors", "plan", "measures"},
    "simulate": {"errors", "command", "problem", "cell", "export"},
}
FORBIDDEN = {
    name: {"resolve", "timing", "travel", "extrusion", "motion", "dips", "kinematics"} for name in ("replay", "verify")
}
# Modules that may import a heavy package; a room stands for all its modules.
HEAVY = {
    "numba": {
        "point_tree",
        "least_singular",
        "replay",
        "surface_points",
        "verify.nozzle_kernel",
        "kinematics",
        "toolpath.substrate.facet_tree",
        "toolpath.substrate.height_field",
        "toolpath.ordering",
        "toolpath.step.splines",
        "toolpath.step.trim",
        "toolpath.step.nearest",
        "toolpath.coverage.marching",
        "toolpath.coverage.two_opt",
        "toolpath.waypoints.surfels",
        "toolpath.transport",
        "resolve",
        "cubics",
        "timing",
        "travel",
        "nearest",
        "obstacles",
        "export.digits",
        "export.axes.choice",
        "export.beside",
        "export.fit",
        "placement.margin_kernel",
    },
    "ruckig": {"travel"},
    "pinocchio": {"robot.bodies", "robot.robot", "robot.urdf", "cell.cell", "replay"},
    "coal": {"robot.bodies", "verify.bodies"},
    "shapely": {
        "toolpath.step.shape",
        "toolpath.svg.cuts",
        "toolpath.volume.fill",
        "toolpath.volume.layers",
        "toolpath.volume.morph",
        "toolpath.volume.solid",
    },
    "svgelements": {"toolpath"},
    "OCP": {"toolpath.step.reader"},
    "tornado": {"view.server"},
    "trimesh": {"facets", "export.part_stl", "report.finished"},
    "matplotlib": {"report", "placement.chart", "plots", "registration.picture"},
    "plotly": set(),
    "rich": {"link.command", "link.show", "new", "place", "progress", "report.summary", "robots", "solve"},
    "pydantic": {"problem", "view.content"},
    "pydantic_core": {"problem"},
    "ruamel": {"problem"},
    "toppra": set(),
    "casadi": {"kinematics.symbolic", "resolve.nlp_program"},
    "osqp": {"resolve.osqp_reference"},
    "distributed": {"spread.cluster"},
    "pyvrp": {"toolpath.coverage.tour"},
}
NEVER = {"pickle", "cPickle", "dill", "shelve", "marshal", "joblib", "cloudpickle", "importlib.util", "runpy"}
NEVER_CALLED = {"eval", "exec", "compile", "__import__", "execfile"}

FILES = sorted(SOURCES.rglob("*.py"))


@dataclass(frozen=True)
class Import:
    """One imported module, and whether only type checkers see it."""

    module: str
    line: int
    typing_only: bool


def dotted(path: Path) -> str:
    """Name of a module below planner: `toolpath.bead`; a package is its folder's name."""
    parts = path.relative_to(SOURCES).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def room_of(module: str) -> str:
    """What stands in the folder planner/ is a room: a module, or a package."""
    return module.split(".")[0]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


@cache
def imports_of(path: Path) -> list[Import]:
    """All imports of a file, those inside functions too, relative ones spelt out."""
    package = ["planner", *path.relative_to(SOURCES).parts[:-1]]
    out: list[Import] = []

    def walk(node: ast.AST, typing_only: bool) -> None:
        if isinstance(node, ast.Import):
            out.extend(Import(alias.name, node.lineno, typing_only) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from planner import cell` imports the module planner.cell
            names = [f"{module}.{alias.name}" for alias in node.names]
            inner = [name for name in names if (ROOT / name.replace(".", "/")).with_suffix(".py").exists()]
            inner += [name for name in names if (ROOT / name.replace(".", "/") / "__init__.py").exists()]
            out.extend(Import(name, node.lineno, typing_only) for name in inner or [module])
        elif isinstance(node, ast.If) and _is_type_checking(node.test):
            for child in node.body:
                walk(child, True)
            for child in node.orelse:
                walk(child, typing_only)
            return
        for child in ast.iter_child_nodes(node):
            walk(child, typing_only)

    walk(tree(path), False)
    return out


def own_imports(path: Path) -> Iterator[tuple[str, Import]]:
    """(room, import) of what a file imports from the project."""
    for found in imports_of(path):
        parts = found.module.split(".")
        if parts[0] == "planner" and len(parts) > 1:
            yield room_of(parts[1]), found


def test_there_is_something_to_read() -> None:
    assert len(FILES) > 30
    assert len(list(own_imports(SOURCES / "planning.py"))) > 10
    assert sum(found.typing_only for path in FILES for found in imports_of(path)) > 5


def test_every_module_has_a_room() -> None:
    homeless = {dotted(path) for path in FILES if dotted(path) and room_of(dotted(path)) not in ROOMS}
    assert not homeless, "give these a place in the order of the rooms"
    assert {room_of(dotted(path)) for path in FILES if dotted(path)} == set(ROOMS), "a room that is no more"


def test_the_table_of_rooms_has_them_all() -> None:
    table = re.findall(r"^\| (`.+?) \|", (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"), re.MULTILINE)
    told = [name.removesuffix("/").removesuffix(".py") for cell in table for name in re.findall(r"`(.+?)`", cell)]
    assert sorted(told) == sorted([*ROOMS, "__init__"])


def test_imports_point_one_way() -> None:
    wrong = []
    for path in FILES:
        here = room_of(dotted(path))  # empty: the package itself
        left = set(ROOMS[: ROOMS.index(here) + 1] if here else ROOMS) | EVERYWHERE
        for room, found in own_imports(path):
            seen = left if found.typing_only else NARROW.get(here, left) | {here} | EVERYWHERE
            if room not in seen or room in FORBIDDEN.get(here, ()):
                wrong.append(f"{dotted(path)}:{found.line}: {found.module}")
    assert not wrong, "these look into a room that they must not see"


def test_modules_do_not_import_each_other_in_circles() -> None:
    edges: dict[str, set[str]] = {}
    for path in FILES:
        seen = {found.module.removeprefix("planner.") for _, found in own_imports(path) if not found.typing_only}
        edges[dotted(path)] = seen - {dotted(path)}
    done: set[str] = set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        assert module not in way, " -> ".join([*way, module])
        if module in done:
            return
        for other in sorted(edges.get(module, ())):
            visit(other, (*way, module))
        done.add(module)

    for module in sorted(edges):
        visit(module, ())


def test_heavy_packages_stay_in_their_rooms() -> None:
    wrong = []
    for path in FILES:
        module = dotted(path)
        for found in imports_of(path):
            allowed = HEAVY.get(found.module.split(".")[0])
            if allowed is not None and not {module, room_of(module)} & allowed:
                wrong.append(f"{module}:{found.line} imports {found.module}")
    assert not wrong


def test_every_permission_is_used() -> None:
    """A permission that nobody needs any more is taken back."""
    used: dict[str, set[str]] = {package: set() for package in HEAVY}
    for path in FILES:
        for found in imports_of(path):
            used.get(found.module.split(".")[0], set()).update({dotted(path), room_of(dotted(path))})
    assert not {(package, room) for package, rooms in HEAVY.items() for room in rooms if room not in used[package]}


def test_a_module_is_one_idea() -> None:
    lines = {dotted(path): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES}
    assert not {name: count for name, count in lines.items() if count > LONGEST_MODULE}


def test_nothing_is_executed_swallowed_or_asserted() -> None:
    assert not [f"{dotted(path)}: {wrong}" for path in FILES for wrong in _forbidden_in(path)]


def test_what_is_forbidden_is_found() -> None:
    for text in (
        "assert x",
        "eval('x')",
        "load(allow_pickle=True)",
        "run(shell=True)",
        "try:\n    pass\nexcept:\n    pass",
        "try:\n    pass\nexcept (KeyError, Exception):\n    pass",
    ):
        assert list(_wrong_nodes(ast.parse(text))), text
    assert not list(_wrong_nodes(ast.parse("import re\nre.compile('x', shell=False)")))


def _forbidden_in(path: Path) -> Iterator[str]:
    yield from _wrong_nodes(tree(path))
    for found in imports_of(path):
        if found.module in NEVER or found.module.split(".")[0] in NEVER:
            yield f"line {found.line}: imports {found.module}"


def _wrong_nodes(module: ast.Module) -> Iterator[str]:
    for node in ast.walk(module):
        if isinstance(node, ast.Assert):
            yield f"line {node.lineno}: assert"
        elif isinstance(node, ast.Call):
            called = node.func
            # a method of that name (re.compile) is another matter
            if isinstance(called, ast.Name) and called.id in NEVER_CALLED:
                yield f"line {node.lineno}: {called.id}()"
            for name in ("allow_pickle", "shell"):
                if any(k.arg == name and not _is_false(k.value) for k in node.keywords):
                    yield f"line {node.lineno}: {name}"
        elif isinstance(node, ast.ExceptHandler):
            caught = (
                [] if node.type is None else [name.id for name in ast.walk(node.type) if isinstance(name, ast.Name)]
            )
            if node.type is None or {"Exception", "BaseException"} & set(caught):
                yield f"line {node.lineno}: catches everything"


def _is_false(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and value.value is False


def test_nothing_global_is_set_while_running() -> None:
    wrong = [
        f"{dotted(path)}:{node.lineno}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, (ast.Global, ast.Nonlocal))
    ]
    assert not wrong


def test_dataclasses_are_frozen() -> None:
    wrong = []
    for path in FILES:
        for node in ast.walk(tree(path)):
            if not isinstance(node, ast.ClassDef):
                continue
            for decorator in node.decorator_list:
                call = decorator.func if isinstance(decorator, ast.Call) else decorator
                name = call.attr if isinstance(call, ast.Attribute) else getattr(call, "id", "")
                frozen = isinstance(decorator, ast.Call) and any(
                    k.arg == "frozen" and isinstance(k.value, ast.Constant) and k.value.value is True
                    for k in decorator.keywords
                )
                if name == "dataclass" and not frozen:
                    wrong.append(f"{dotted(path)}:{node.lineno} {node.name}")
    assert not wrong
