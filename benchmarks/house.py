"""Figures of the code's structure: entries, files, lines of code, imports, parameters, names, docstrings.

python -m benchmarks.house [--tree FOLDER]…
"""

from __future__ import annotations

import argparse
import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
Documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def code_lines(text: str) -> int:
    """Lines that hold code: no blanks, comments or docstrings."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, Documented) and ast.get_docstring(node) is not None:
            docstrings |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in SILENT:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many parameters a function has, of every kind."""
    given = function.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return len(named) + (given.vararg is not None) + (given.kwarg is not None)


def imports(tree: ast.AST) -> Iterator[str]:
    """Modules of the planner from which a file imports, once each."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("planner."):
            yield str(node.module)


def figures(root: Path) -> dict[str, int]:
    """The figures of `planner/` below a folder."""
    planner = root / "planner"
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(planner.rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    functions = [node for node in nodes if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
    classes = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef) and not node.name.startswith("_"))
    public = [node for node in nodes if isinstance(node, Documented[1:]) and not node.name.startswith("_")]
    edges = {(path, module) for path, tree in trees.items() for module in imports(tree)}
    users = Counter(module for _, module in edges)
    return {
        "entries of planner/": len([path for path in planner.iterdir() if path.name != "__pycache__"]),
        "files": len(texts),
        "lines": sum(len(text.splitlines()) for text in texts.values()),
        "lines of code": sum(code_lines(text) for text in texts.values()),
        "longest file": max(len(text.splitlines()) for text in texts.values()),
        "imports between files": len(edges),
        "files that one other imports": sum(count == 1 for count in users.values()),
        "most parameters": max(parameters(function) for function in functions),
        "functions with more than 12": sum(parameters(function) > 12 for function in functions),
        "class names used twice": sum(count > 1 for count in classes.values()),
        "public names without docstring": sum(ast.get_docstring(node) is None for node in public),
        "aliases of array types": sum(
            text.count(" = NDArray[") for path, text in texts.items() if path.name != "arrays.py"
        ),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures of one tree, or of several side by side."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.house", description=__doc__)
    parser.add_argument("--tree", type=Path, action="append", help="a checkout (default: the present folder)")
    trees = parser.parse_args(arguments).tree or [Path()]
    columns = [figures(tree) for tree in trees]
    for name in columns[0]:
        print(f"{name:<32}" + "".join(f"{column[name]:>9,}" for column in columns))
    return 0


if __name__ == "__main__":
    sys.exit(main())
