"""The notebooks: stripped of outputs in the repository, and each runs from its first cell to its last."""

from __future__ import annotations

import ast
import asyncio
import os
from pathlib import Path

import nbformat
import pytest
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "notebooks"
NAMES = [
    "01_quickstart",
    "02_redundancy_map",
    "03_constant_speed",
    "04_wing",
    "05_fibre_two_robots",
    "06_your_own_cell",
    "07_compare_strategies",
    "08_from_assumed_to_measured",
]
PATIENCE = 300  # seconds for a cell: kernels may have to be compiled first


def read(name: str) -> nbformat.NotebookNode:
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def test_these_are_all() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.ipynb")) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_is_stripped_and_valid(name: str) -> None:
    notebook = read(name)
    nbformat.validate(notebook)
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert notebook.metadata.kernelspec.name == "python3" and set(notebook.metadata.language_info) == {"name"}
    for k, cell in enumerate(notebook.cells, 1):
        assert cell.id == f"cell-{k}" and not cell.metadata
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None


@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_teaches_and_leaves_the_work_to_the_package(name: str) -> None:
    cells = read(name).cells
    assert cells[0].source.startswith("# ") and cells[-1].source.startswith("## Try\n\n1. ")
    assert sum(cell.cell_type == "markdown" for cell in cells) >= 6
    for cell in cells:
        if cell.cell_type == "code":
            made = [type(node).__name__ for node in ast.walk(ast.parse(cell.source))]
            assert not {"FunctionDef", "ClassDef", "While"} & set(made), cell.source
            assert len(cell.source.splitlines()) <= 20, cell.source


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the repository's own sources, with nothing of the user's settings; it draws something, and writes no file."""
    before = sorted(FOLDER.iterdir())
    for variable in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "MPLCONFIGDIR", "TMPDIR"):
        (tmp_path / variable).mkdir()
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]))
    notebook = read(name)
    kernel = AsyncKernelManager(kernel_name="python3", transport="ipc", ip=str(tmp_path / "kernel"))
    resources = {"metadata": {"path": str(FOLDER)}}
    try:
        NotebookClient(notebook, km=kernel, timeout=PATIENCE, resources=resources).execute()
    finally:  # a kernel that was handed over is left running
        asyncio.run(kernel.shutdown_kernel(now=True))
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2
    assert not [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert sorted(FOLDER.iterdir()) == before
