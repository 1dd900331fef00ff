"""The claims report: every reference exists, no cell is empty, the page is what its data say."""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


def load(path: str) -> ModuleType:
    name = "of_" + path.replace("/", "_").removesuffix(".py")
    spec = importlib.util.spec_from_file_location(name, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def report() -> ModuleType:
    return load("docs/papers.py")


@pytest.fixture(scope="module")
def numbers() -> ModuleType:
    return load("benchmarks/papers.py")


def test_the_page_is_what_its_data_say(report: ModuleType) -> None:
    text, mistakes = report.page(report.kept())
    assert mistakes == []
    assert report.REPORT.read_text(encoding="utf-8") == text, "python docs/papers.py makes it anew"


def test_no_cell_is_empty(report: ModuleType) -> None:
    rows = [line for line in report.REPORT.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    tables = [re.split(r"(?<!\\)\|", line)[1:-1] for line in rows if not set(line) <= set("|-: ")]
    assert sum(len(cells) == 8 for cells in tables) > 150  # one row for each item of four papers, and the heads
    assert [cells for cells in tables if not all(cell.strip() for cell in cells)] == []


def test_all_that_is_wrong_is_said_at_once(report: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "answers.md").write_text("# Answers\n")
    (tmp_path / "009.yaml").write_text("""
title: A paper
about: nothing
sections:
  - title: one
    records:
      - {item: eq. (1), says: x, code: ["solvers/devices.py:no_such_law"], corrected: x, tests: ["tests/none.py::test"],
         theirs: x, ours: "{nothing.here:.1f}", verdict: perhaps, why: ""}
      - {item: eq. (2), says: x, code: "none: it is not there", corrected: x, theirs: x, ours: 3.5 kN, verdict: refuted,
         why: x}
      - {item: eq. (3), says: x, code: "none: it is not there", corrected: x, tests: "none: it is not there", theirs: x,
         ours: "3.5 kN by (3.4) (`test_of_nothing`)", verdict: refuted, why: x}
""")
    monkeypatch.setattr(report, "CLAIMS", tmp_path)
    said = "\n".join(report.page({})[1])
    for words in ("has no no_such_law", "no file tests/none.py", "no number nothing.here",
                  "'perhaps' is not one of", "empty why", "eq. (2): no tests",
                  "eq. (2), ours: no command or test beside 3.5", "no test is called test_of_nothing"):  # fmt: skip
        assert words in said


# closed forms and short sums, no chaotic run: the same to the seven digits that are kept
QUICK = ("scene_numbers", "curvature", "force_laws", "damping_law", "oc3")


@pytest.mark.parametrize("name", QUICK)
def test_a_number_is_what_its_command_computes(report: ModuleType, numbers: ModuleType, name: str) -> None:
    stored = report.kept()[name]["values"]
    found = numbers.GROUPS[name].make()
    assert found.keys() == stored.keys()
    for key, value in found.items():
        assert stored[key] == pytest.approx(value, rel=2e-6, abs=1e-12), key


def test_modes_are_those_of_a_clamped_beam(numbers: ModuleType) -> None:
    """Roots of the clamped tensioned beam's equation; Hermite elements are exact to (k h)^4/720, 1e-8 at mode 6."""
    scene = numbers.study("bnes_optimum").scene
    cable, L, T = scene.cable[0], scene.length, 500.0
    arc = np.linspace(0, L, 401)
    f, shapes = numbers.modes(tuple(arc))
    mass = cable.mass + scene.density * math.pi / 4 * cable.d**2
    t = T / (2 * cable.EI)
    for k in range(6):
        def equation(frequency: float) -> float:
            root = math.sqrt(t * t + mass * (2 * math.pi * frequency) ** 2 / cable.EI)
            a, b = math.sqrt(t + root) * L, math.sqrt(root - t) * L
            return 2 * a * b * (1 / math.cosh(a) - math.cos(b)) + (a * a - b * b) * math.tanh(a) * math.sin(b)

        step = 1e-6 * f[k]
        slope = (equation(f[k] + step) - equation(f[k] - step)) / (2 * step)
        assert abs(equation(f[k]) / slope) < 1e-6 * f[k]
    gram = shapes[:6] @ shapes[:6].T * (arc[1] - arc[0])  # ends are zero: a trapezoid, exact to spectral order
    assert np.abs(gram - np.eye(6)).max() < 1e-4
