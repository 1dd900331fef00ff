"""The direction of imports, and who may print: what keeps the house in order."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted([*(ROOT / "solvers").rglob("*.py"), *(ROOT / "sweep").rglob("*.py")])
LAYERS = [  # a file imports from layers above its own line or from its own line, never from below
    "point fields mistakes mend fatigue signals",
    "config",
    "metrics space pareto",
    "uncertainty",
    "evaluate child",
    "plan supervise dataset",
    "store",
    "locks distribute resolve",
    "report",
    "run series flows sensitivity labels histories signal_plots across across_plot audit peers",
    "plot chart chart_plot stability stability_plot optimise",
    "submit",
    "cli",
    "__main__",
]
RANK = {name: i for i, layer in enumerate(LAYERS) for name in layer.split()}


def module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Absolute names of all modules and names that a file imports, wherever in the file."""
    package = module(path) if path.name == "__init__.py" else module(path).rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - (node.level - 1)] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            found |= {stem} | {f"{stem}.{alias.name}" for alias in node.names}
    return found


def inside(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


IMPORTS = {module(path): imports(path) for path in FILES}


def offenders(who: str, whom: str, but: tuple[str, ...] = ()) -> list[str]:
    return [
        f"{name} imports {found}"
        for name, all_found in IMPORTS.items()
        for found in all_found
        if inside(name, who) and inside(found, whom) and not any(inside(name, one) for one in but)
    ]


@pytest.mark.parametrize(
    ("who", "whom"),
    [
        ("solvers", "sweep"),
        ("solvers", "yaml"),
        ("solvers.lines", "solvers.methods"),
        ("solvers.lines", "solvers.catalogue"),
        ("solvers.methods", "solvers.lines"),
        ("solvers.methods", "solvers.catalogue"),
        ("sweep.plot", "solvers"),
        ("sweep.histories", "solvers"),
        ("sweep.labels", "solvers"),
        ("sweep.signals", "solvers"),
        ("sweep.signal_plots", "solvers"),
    ],
)
def test_who_does_not_know_whom(who, whom):
    assert offenders(who, whom) == []


def test_lines_do_not_know_one_another():
    rooms = {name.split(".")[2] for name in IMPORTS if name.startswith("solvers.lines.")}
    wrong = [
        o for a in rooms for b in rooms - {a} for o in offenders(f"solvers.lines.{a}", f"solvers.lines.{b}")
    ]
    assert wrong == []


def test_mpi_is_in_one_file():
    assert offenders("sweep", "mpi4py", but=("sweep.distribute",)) == []
    assert offenders("solvers", "mpi4py") == []


def test_the_study_layer_has_one_direction():
    wrong = []
    for name, found in IMPORTS.items():
        if inside(name, "sweep") and name != "sweep":
            mine = RANK[name.split(".")[1]]
            known = {part.split(".")[1] for part in found if part.startswith("sweep.")} & RANK.keys()
            wrong += [f"{name} imports {other}" for other in known if RANK[other] > mine]
    assert wrong == []


def test_every_file_of_the_study_layer_has_a_place():
    assert {path.stem for path in (ROOT / "sweep").glob("*.py")} - RANK.keys() == {"__init__"}


@pytest.mark.parametrize("path", FILES, ids=module)
def test_nobody_prints_but_the_commands(path):
    if module(path) in ("sweep.cli", "sweep.__main__"):
        return
    calls = [node.func for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    names = {call.id for call in calls if isinstance(call, ast.Name)}
    assert not names & {"print", "breakpoint", "input"}


def test_a_worker_does_not_load_what_only_results_need():
    heavy = "{'matplotlib', 'typer', 'mpi4py', 'pymoo', 'xarray', 'pandas', 'scipy.stats'}"
    code = f"import sweep.child, sys; print(sorted(sys.modules.keys() & {heavy}))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"
