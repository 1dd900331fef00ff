"""The four notebooks run headless on the small study, and every axis says what it is, and its unit."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9]*.py"))
FIGURES = {"1_pareto": 3, "2_one_design": 9, "3_speed_against_accuracy": 1, "4_robustness": 4}

# the last cell of each: labels of all axes that were shown, colour bars included
LABELS = """
import json, study
found = []
for figure in study.FIGURES:
    panels = [ax for ax in figure.axes if ax.axison and (ax.lines or ax.collections or ax.patches)]
    found.append([[ax.get_xlabel(), ax.get_ylabel(), getattr(figure, "_supxlabel", None) is not None] for ax in panels])
print("LABELS " + json.dumps(found))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small study, run once for all four."""
    directory = tmp_path_factory.mktemp("study")
    subprocess.run([sys.executable, str(ROOT / "notebooks" / "study.py"), str(directory)], check=True, timeout=900)
    return directory


def executed(path: Path, folder: Path) -> Any:
    """The notebook made of a .py, after a run in a kernel of its own."""
    jupytext = pytest.importorskip("jupytext", reason="the notebooks extra is not installed")
    nbclient = pytest.importorskip("nbclient", reason="the notebooks extra is not installed")
    pytest.importorskip("ipykernel", reason="the notebooks extra is not installed")
    import nbformat

    notebook = jupytext.read(path)
    notebook.cells.append(nbformat.v4.new_code_cell(LABELS))
    client = nbclient.NotebookClient(
        notebook, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(path.parent)}}
    )
    before = {name: os.environ.get(name) for name in ("CABLE_SWEEP_STUDY", "PYTHONPATH")}
    os.environ |= {"CABLE_SWEEP_STUDY": str(folder), "PYTHONPATH": str(ROOT)}
    try:
        return client.execute()
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def printed(notebook: Any) -> str:
    return "".join(
        output.get("text", "") for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs
    )


def test_there_are_four() -> None:
    assert [path.stem for path in NOTEBOOKS] == list(FIGURES)


# libraries of the kernel warn about one another's versions; nothing of ours warns
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_headless_and_labels_its_axes(path: Path, folder: Path) -> None:
    import json

    notebook = executed(path, folder)
    text = printed(notebook)
    figures = json.loads(text.rpartition("LABELS ")[2].splitlines()[0])
    assert len(figures) == FIGURES[path.stem]
    for figure in figures:
        labels = [label for panel in figure for label in panel[:2]]
        assert any(labels), "a figure without any label"
        for label in filter(None, labels):
            assert re.search(r"\[[^\]]+\]|\(s\)|\(m\)", label), f"no unit in {label!r}"


def test_outputs_are_not_committed() -> None:
    """Plain text only: pairs are made by jupytext."""
    done = subprocess.run(["git", "ls-files", "notebooks"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert not [name for name in done.stdout.split() if name.endswith(".ipynb")]
