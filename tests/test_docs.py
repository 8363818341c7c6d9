"""README and pages: links lead somewhere, the site's menu is whole, commands on the pages exist."""

from __future__ import annotations

import importlib
import inspect
import re
import shlex
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from planner.base.launch import COMMANDS
from planner.problem import load_problem, shipped_problems

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [*(ROOT / f"{name}.md" for name in ("README", "ARCHITECTURE", "CONTRIBUTING", "CHANGELOG"))]
PAGES += sorted(DOCS.rglob("*.md"))
FROM_ROOT = {"architecture.md", "contributing.md", "changelog.md"}  # pages that the site takes from the root
MOST_WORDS = 1050  # of the README: who wants more finds a page
LINK = re.compile(r"\]\(([^)\s]+)\)")
PICTURE = re.compile(r"!\[([^\]]*)\]\(")
FILE = re.compile(r"`((?:planner|benchmarks)/[\w/]+(?:\.\w+)?)`")
API = re.compile(r"^::: ([\w.]+)\.(\w+)$", re.MULTILINE)
ENTRY = re.compile(r"^ {4}(\*{0,2}\w+): \S", re.MULTILINE)  # of a section in a docstring
FENCED = re.compile(r"^```.*?^```|<!--.*?-->", re.MULTILINE | re.DOTALL)
SCRIPT = re.compile(r"(?:^ {4}|`)beadwise ([a-z]+)([^`\n]*)", re.MULTILINE)
COMMAND = re.compile(r"python(?:3\.11)? -m ((?:planner|benchmarks)(?:\.\w+)*)([^`\n]*)")


def names(pages: list[Path]) -> list[str]:
    return [str(page.relative_to(ROOT)) for page in pages]


def headings(page: Path) -> set[str]:
    """Anchors of a page, as Python-Markdown makes them."""
    found: set[str] = set()
    for title in re.findall(r"^#+ (.+)$", FENCED.sub("", page.read_text(encoding="utf-8")), re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
        slug = re.sub(r"[^\w\s-]", "", plain.encode("ascii", "ignore").decode()).strip().lower()
        found.add(re.sub(r"[-\s]+", "-", slug))
    return found


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Modules and arguments of the commands that a page names, as modules or as `beadwise NAME`."""
    scripts = [(f"planner.{name}", rest) for name, rest in SCRIPT.findall(text)]
    for module, rest in [*COMMAND.findall(text), *scripts]:
        line = re.split(r"\s+#\s|[|;>…]", rest)[0].strip().rstrip(").,:")
        try:
            yield module, shlex.split(line)
        except ValueError:
            yield module, line.split()


def source_of(module: str) -> str:
    """Source of a command and of what it takes options from; empty where there is no such module."""
    path = ROOT / Path(*module.split("."))
    files = [ROOT / "planner" / "base" / "command_line.py", ROOT / "planner" / "planning" / "options.py"]
    name = module.removeprefix("planner.")
    if path.is_dir():
        files += sorted(path.glob("*.py"))
    elif path.with_suffix(".py").is_file():
        files += [path.with_suffix(".py")]
        files += sorted(path.parent.glob("*.py")) if path.parent.name not in ("planner", "benchmarks") else []
    elif name not in COMMANDS:
        return ""
    if module.startswith("planner.") and name in COMMANDS:
        files.append((ROOT / Path(*COMMANDS[name].module.split("."))).with_suffix(".py"))
    return "".join(file.read_text(encoding="utf-8") for file in files)


def menu() -> list[str]:
    """Pages in the order of the site's menu."""

    def leaves(entry: Any) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        else:
            for below in entry.values() if isinstance(entry, dict) else entry:
                yield from leaves(below)

    return list(leaves(YAML(typ="safe").load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]))


@pytest.mark.parametrize("name", names(PAGES))
def test_a_page_is_one_version_of_itself(name: str) -> None:
    """No marks of a merge that nobody settled."""
    assert not re.search(r"^(?:<{7}|={7}|>{7})(?: |$)", (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("name", names(PAGES))
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for link in LINK.findall(FENCED.sub("", page.read_text(encoding="utf-8"))):
        if "://" in link:
            continue
        target, _, anchor = link.partition("#")
        file = (page.parent / target).resolve() if target else page
        assert file.exists(), link
        if anchor and file.suffix == ".md":
            assert anchor in headings(file), link


@pytest.mark.parametrize("name", names(PAGES))
def test_files_of_the_code_that_pages_name_exist(name: str) -> None:
    for file in FILE.findall((ROOT / name).read_text(encoding="utf-8")):
        if name != "CHANGELOG.md" and file != "planner/shipped":  # the latter is in an installed package
            assert (ROOT / file).exists(), file


def test_the_page_of_python_names_what_there_is() -> None:
    named = API.findall((DOCS / "reference" / "api.md").read_text(encoding="utf-8"))
    assert len(named) > 15
    for module, name in named:
        assert hasattr(importlib.import_module(module), name), f"{module}.{name}"


def entries(documented: Any, section: str) -> list[str]:
    """Names under a heading of a docstring in Google style."""
    found = re.search(rf"^{section}:\n((?: {{4}}.*\n|\n)+)", f"{inspect.getdoc(documented)}\n", re.MULTILINE)
    return ENTRY.findall(found[1]) if found else []


def public_fields(kind: type) -> list[str]:
    """Those of a dataclass or a named tuple; none of any other class."""
    each = [field.name for field in fields(kind)] if is_dataclass(kind) else getattr(kind, "_fields", ())
    return [name for name in each if not name.startswith("_")]


def parameters(function: Any) -> list[str]:
    """Names as in a signature, with their stars."""
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    each = inspect.signature(function).parameters.values()
    return [stars.get(one.kind, "") + one.name for one in each if one.name not in ("self", "cls")]


@pytest.mark.parametrize(("module", "name"), API.findall((DOCS / "reference" / "api.md").read_text(encoding="utf-8")))
def test_docstrings_of_the_reference_list_parameters_and_fields(module: str, name: str) -> None:
    found = getattr(importlib.import_module(module), name)
    functions = {name: found} if inspect.isfunction(found) else {}
    if inspect.isclass(found):
        if each := public_fields(found):
            assert entries(found, "Attributes") == each, name
        functions = {key: getattr(found, key) for key in vars(found) if key[0] != "_" or key == "__call__"}
    for key, function in functions.items():
        if inspect.isroutine(function):
            assert entries(function, "Args") == parameters(function), f"{name}.{key}"


@pytest.mark.parametrize("name", names(PAGES))
def test_pictures_are_described(name: str) -> None:
    for words in PICTURE.findall((ROOT / name).read_text(encoding="utf-8")):
        assert len(words.split()) >= 3, words


def test_the_menu_lists_every_page_once() -> None:
    listed = menu()
    assert len(listed) == len(set(listed))
    assert set(listed) == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} | FROM_ROOT


def test_every_shipped_problem_has_a_page_and_a_row() -> None:
    pages = {page.stem for page in (DOCS / "problems").glob("*.md")} - {"index"}
    assert pages == set(shipped_problems())
    rows = (DOCS / "problems" / "index.md").read_text(encoding="utf-8")
    for name in pages:
        assert f"[{name}]({name}.md)" in rows
        assert f"<!-- figures: {name} -->" in (DOCS / "problems" / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", names(PAGES))
def test_commands_on_the_pages_exist(name: str) -> None:
    for module, arguments in commands((ROOT / name).read_text(encoding="utf-8")):
        source = source_of(module)
        assert source, f"python -m {module}"
        for word in arguments:
            option = word.split("=")[0]
            if option.startswith("--") and option != "--help":
                assert f'"{option}"' in source, f"python -m {module} {option}"


@pytest.mark.parametrize("name", names(PAGES))
def test_changes_on_the_pages_are_valid(name: str) -> None:
    """What pages say after --set is taken by the problem that they say it of."""
    for module, arguments in commands((ROOT / name).read_text(encoding="utf-8")):
        changes = [b for a, b in zip(arguments, arguments[1:], strict=False) if a == "--set"]
        if module == "planner.solve" and changes and arguments[0] in shipped_problems():
            load_problem(arguments[0], changes)


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= MOST_WORDS
