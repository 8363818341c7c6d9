"""The rooms of the house and the way through them, held by reading the sources."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "planner"
# Rooms of planner/ in layers: a room imports from those in layers before its own, and from itself.
LAYERS = (
    "base", "problem", "cell", "toolpath", "collision", "resolve", "plan", "motion", "verify", "export report", "planning",
    "solve check robots new place register feedback view link simulate",
)  # fmt: skip
# Packages that only some commands or problems need, or that are slow to import: the modules that may name them.
HEAVY = {
    "numba": {"base.compiled"},
    "pinocchio": {
        "cell.bodies",
        "cell.carrier",
        "cell.cell",
        "cell.robot",
        "cell.urdf",
        "robots.adding",
        "robots.from_model",
        "verify.executed",
    },
    "coal": {"robots.touching", "cell.bodies", "verify.bodies", "verify.reread"},
    "ruckig": {"motion.travel"},
    "shapely": {"plan.stored", "toolpath.skirt", "toolpath.step", "toolpath.svg", "toolpath.volume", "verify.reread"},
    "svgelements": {"toolpath", "verify.reread"},
    "ezdxf": {"toolpath.dxf.reader", "verify.reread"},
    "OCP": {
        "problem.cad_curves",
        "problem.cad_facets",
        "toolpath.step.reader",
        "toolpath.step.shapes",
        "verify.reread.curve_process",
        "verify.reread.step_process",
    },
    "trimesh": {"problem.mesh_files", "export.tables", "report.picture", "problem.clouds"},
    "pyvrp": {"toolpath.coverage.tours"},
    "pydantic": {"problem", "view.content"},
    "ruamel": {"problem"},
    "casadi": {"resolve.reference"},
    "osqp": {"resolve.reference"},
    "toppra": {"motion.timing.toppra_profile"},
    "jinja2": {"report.templates"},
    "matplotlib": {"report", "place.command", "register.telling", "feedback.learn_telling", "feedback.scan_telling"},
    "plotly": set(),
    "tornado": {"base.web.server", "view.server"},
    "distributed": {"base.distribution"},
    "requests": {"link"},
    "websocket": {"link"},
    "pandas": {"plan.frames", "plan.plan"},
    "xarray": {"plan.frames", "plan.plan"},
    "xacro": {"robots.survey"},
    "xacrodoc": {"robots.survey"},
    "rosbags": {"feedback.bags"},
}
# What the verifier must not see, so that it judges the planner with none of the planner's own code.
JUDGED = {"resolve", "motion", "cell.kinematics", "planning"}
NEVER = {"pickle", "cPickle", "dill", "shelve", "marshal", "joblib", "cloudpickle", "importlib.util", "runpy"}
NEVER_CALLED = {"eval", "exec", "compile", "__import__", "execfile"}

FILES = sorted(SOURCES.rglob("*.py"))
MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in FILES}


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


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file's tree: walking it takes longer than looking at what is found."""
    return tuple(ast.walk(tree(path)))


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
            out.extend(Import(name, node.lineno, typing_only) for name in MODULES.intersection(names) or [module])
        elif isinstance(node, ast.If) and _is_type_checking(node.test):
            for child in node.body:
                walk(child, True)
            for child in node.orelse:
                walk(child, typing_only)
            return
        for child in ast.iter_child_nodes(node):
            if not isinstance(child, ast.expr):  # no import stands in one
                walk(child, typing_only)

    walk(tree(path), False)
    return out


def own_imports(path: Path) -> Iterator[Import]:
    """What a file imports from the project, as `Import`s below planner."""
    for found in imports_of(path):
        if found.module.startswith("planner."):
            yield Import(found.module.removeprefix("planner."), found.line, found.typing_only)


def within(module: str, places: set[str]) -> bool:
    """Whether a module is one of some places, or in one of them."""
    return any(module == place or module.startswith(f"{place}.") for place in places)


def test_there_is_something_to_read() -> None:
    assert len(FILES) > 30
    assert len(list(own_imports(SOURCES / "planning" / "pipeline.py"))) > 10
    assert sum(found.typing_only for path in FILES for found in imports_of(path)) > 5


def test_layers() -> None:
    """Every room has a layer, and imports only from itself and from layers before its own; commands from each other."""
    layer = {room: k for k, rooms in enumerate(LAYERS) for room in rooms.split()}
    entries = {path.stem for path in SOURCES.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert entries - {"__pycache__", "__init__"} == set(layer)
    commands, wrong = len(LAYERS) - 1, []
    for path in FILES:
        room = dotted(path).partition(".")[0]
        for found in own_imports(path):
            other = found.module.partition(".")[0]
            ends = room in ("", other) or found.typing_only or layer[room] == layer[other] == commands
            if not ends and layer[other] >= layer[room]:
                wrong.append(f"{dotted(path)}:{found.line}: {found.module}")
    assert not wrong


def test_the_verifier_sees_nothing_of_what_it_judges() -> None:
    seen = [(dotted(p), found.module) for p in FILES if dotted(p).startswith("verify") for found in own_imports(p)]
    assert not [(here, module) for here, module in seen if within(module, JUDGED)]


def test_export_and_report_see_only_the_plan() -> None:
    """But for the plots of notebooks, which also draw what was not chosen."""
    for path in FILES:
        if dotted(path).startswith(("export", "report")) and dotted(path) != "report.plots":
            rooms = {found.module.partition(".")[0] for found in own_imports(path) if not found.typing_only}
            assert rooms <= {"base", "plan", "export" if dotted(path).startswith("export") else "report"}, path


def test_modules_do_not_import_each_other_in_circles() -> None:
    edges: dict[str, set[str]] = {}
    for path in FILES:
        seen = {found.module for found in own_imports(path) if not found.typing_only}
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
    named = [(dotted(path), found) for path in FILES for found in imports_of(path)]
    heavy = [(module, found) for module, found in named if found.module.split(".")[0] in HEAVY]
    wrong = [(m, f.line, f.module) for m, f in heavy if not within(m, HEAVY[f.module.split(".")[0]])]
    assert not wrong
    unused = {(package, place) for package, places in HEAVY.items() for place in places} - {
        (f.module.split(".")[0], place)
        for m, f in heavy
        for place in HEAVY[f.module.split(".")[0]]
        if within(m, {place})
    }
    assert not unused, "permissions that nobody needs any more"


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
        assert list(_wrong_nodes(ast.walk(ast.parse(text)))), text
    assert not list(_wrong_nodes(ast.walk(ast.parse("import re\nre.compile('x', shell=False)"))))


def _forbidden_in(path: Path) -> Iterator[str]:
    yield from _wrong_nodes(nodes(path))
    for found in imports_of(path):
        if found.module in NEVER or found.module.split(".")[0] in NEVER:
            yield f"line {found.line}: imports {found.module}"


def _is_empty_text(arguments: list[ast.expr]) -> bool:
    """Running nothing at all has an effect of its own: see `interrupts_answered`."""
    return len(arguments) == 1 and isinstance(arguments[0], ast.Constant) and arguments[0].value == ""


def _wrong_nodes(found: Iterable[ast.AST]) -> Iterator[str]:
    for node in found:
        if isinstance(node, ast.Assert):
            yield f"line {node.lineno}: assert"
        elif isinstance(node, ast.Call):
            called = node.func
            # a method of that name (re.compile) is another matter
            if isinstance(called, ast.Name) and called.id in NEVER_CALLED and not _is_empty_text(node.args):
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
        for node in nodes(path)
        if isinstance(node, (ast.Global, ast.Nonlocal))
    ]
    assert not wrong


def test_functions_have_few_parameters() -> None:
    """Compiled kernels too: what belongs together is handed over in one tuple."""
    wrong = []
    for path in FILES:
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef):
                count = len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)
                wrong += [f"{dotted(path)}:{node.lineno} {node.name} has {count}"] if count > 12 else []
    assert not wrong


def test_python_calls_no_inner_kernel() -> None:
    """Called from Python, an inner kernel is compiled anew by every process (see `inner_njit`)."""
    kernels = {f"planner.{dotted(path)}.{name}": kind for path in FILES for name, kind in kernels_of(path).items()}
    wrong = []
    for path in FILES:
        own = kernels_of(path)
        known = {name: f"planner.{dotted(path)}.{name}" for name in own}
        for node in nodes(path):
            if isinstance(node, ast.ImportFrom):
                known |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
        inner = {name for name, full in known.items() if kernels.get(full) == "inner_njit"}
        plain = [node for node in tree(path).body if getattr(node, "name", "") not in own]
        calls = [node for statement in plain for node in ast.walk(statement) if isinstance(node, ast.Call)]
        wrong += [f"{dotted(path)}:{c.lineno} {ast.unparse(c.func)}" for c in calls if ast.unparse(c.func) in inner]
    assert not wrong


@cache
def kernels_of(path: Path) -> dict[str, str]:
    """The decorator of each compiled function of a file."""
    functions = [node for node in tree(path).body if isinstance(node, ast.FunctionDef)]
    decorators = [(node.name, ast.unparse(each).split("(")[0]) for node in functions for each in node.decorator_list]
    return {name: decorator for name, decorator in decorators if decorator in ("njit", "inner_njit")}


def test_a_class_has_a_name_of_its_own() -> None:
    where: dict[str, list[str]] = {}
    for path in FILES:
        for node in nodes(path):
            if isinstance(node, ast.ClassDef):
                where.setdefault(node.name, []).append(f"{dotted(path)}:{node.lineno}")
    assert not {name: places for name, places in where.items() if len(places) > 1}


def test_what_is_public_says_what_it_is() -> None:
    """But for methods of a class with a base: there the base's are described."""
    wrong = []
    for path in FILES:
        classes = [node for node in tree(path).body if isinstance(node, ast.ClassDef)]
        plain = {"Protocol", "NamedTuple"}
        alone = [c for c in classes if c.name[0] != "_" and {ast.unparse(base) for base in c.bases} <= plain]
        for node in [each for owner in (tree(path), *alone) for each in owner.body]:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                wrong += [] if ast.get_docstring(node) else [f"{dotted(path)}:{node.lineno} {node.name}"]
    assert not wrong


def test_dataclasses_are_frozen() -> None:
    wrong = []
    for path in FILES:
        for node in nodes(path):
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
