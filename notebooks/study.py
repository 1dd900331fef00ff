"""The study that the notebooks read, and how they show a figure.

    python notebooks/study.py [DIR]       make the small study (some seconds once the kernels are compiled)
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
SMALL = HERE.parent / "out" / "notebooks"
FIGURES: list[Any] = []  # what a notebook has shown


def folder() -> Path:
    """The results folder that `CABLE_SWEEP_STUDY` names, or the small study's, made where it is not there yet."""
    given = os.environ.get("CABLE_SWEEP_STUDY")
    if given:
        return Path(given)
    if not (SMALL / "results.nc").is_file():
        make(SMALL)
    return SMALL


def make(directory: Path) -> None:
    """Run notebooks/study.yaml into a folder."""
    words = [sys.executable, "-m", "sweep", "run", str(HERE / "study.yaml"), "--out", str(directory)]
    subprocess.run(words, check=True, cwd=HERE.parent)


def show(figure: Any) -> Any:
    """A figure, or the figure of axes, as a cell's value; remembered."""
    figure = getattr(figure, "figure", figure)
    FIGURES.append(figure)
    return figure


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else SMALL)
