"""The documentation builds without a warning."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

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
    commands = (tmp_path / "html" / "cli.html").read_text(encoding="utf-8")
    assert all(f"sweep {name}" in commands for name in ("run", "check", "submit", "pareto", "chart", "stability"))
    api = (tmp_path / "html" / "api.html").read_text(encoding="utf-8")
    assert "axial stiffness" in api  # fields bring the comments that say what they are
