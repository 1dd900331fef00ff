"""The documentation builds without a warning."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from sweep.cli import app

ROOT = Path(__file__).parents[2]


def test_the_site_builds(tmp_path: Path) -> None:
    for name in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(name, reason="the docs extra is not installed", exc_type=ImportError)
    words = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", str(tmp_path / "trees")]
    words += ["docs", str(tmp_path / "html")]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    pages = {path.stem for path in (tmp_path / "html").rglob("*.html")}
    wanted = {"index", "papers", "cli", "api", "lumped", "hermite", "transverse", "local", "rod", "devices", "harmonic"}
    assert wanted | {"ledger", "metrics", "first_study", "cluster", "add_a_line", "add_a_method", "notebooks"} <= pages
    text = {name: re.sub(r"<[^>]+>", "", (tmp_path / f"html/{name}.html").read_text()) for name in ("cli", "api")}
    names = [command.name or command.callback.__name__ for command in app.registered_commands]
    assert [name for name in names if f"sweep {name}" not in text["cli"]] == []
    assert "axial stiffness" in text["api"]  # fields bring the comments that say what they are
