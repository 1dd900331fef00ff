"""The documentation site: `make docs`, or `sphinx-build -W docs docs/_build/html`."""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

project = "cable-sweep"
author = "the cable-sweep authors"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "claims"]
html_theme = "furo"
html_title = "cable-sweep"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False

ELSEWHERE = {  # files of the repository that the site shows as pages of its own
    r"(?:\.\./)?benchmarks/README\.md": "benchmarks.md",
    r"(?:\.\./)?slurm/README\.md": "slurm.md",
    r"\.\./docs/papers\.md": "papers.md",
}


def write_cli_page() -> None:
    """cli.md from the signatures of the commands, as `sweep --help` has them."""
    import typer
    from typer.cli import get_docs_for_click

    from sweep.cli import app

    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="sweep")
    text = get_docs_for_click(obj=command, ctx=context, name="sweep", title="Command line")
    (HERE / "cli.md").write_text(text, encoding="utf-8")


def own_pages(app: object, name: str, source: list[str]) -> None:
    """Links between files of the repository become links between pages."""
    for pattern, page in ELSEWHERE.items():
        source[0] = re.sub(rf"\]\({pattern}\)", f"]({page})", source[0])


def fields(obj: object) -> list[str]:
    """A list of a record's own fields, with the comments beside them in the source: meaning and unit."""
    found = []
    for line in inspect.getsource(obj).splitlines():  # type: ignore[arg-type]
        field = re.match(r"    (\w+): ([^#]+?)(?:\s*=\s*([^#]+?))?\s*#\s*(.+)$", line)
        if field and not field[1].startswith("_"):
            found.append(f"* ``{field[1]}``: {field[4]}")
    return found


def plain(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Docstrings are prose with formulas like |x| or a * b: outside of literals their marks stand for themselves."""
    if what == "class":
        lines += ["", *fields(obj), ""]
    for i, line in enumerate(lines):
        parts = re.split(r"(``[^`]*``|^\* )", line)
        for j in range(0, len(parts), 2):
            parts[j] = re.sub(r"[|]|(?<!\w)\*(?!\w)|_(?=\W|$)", r"\\\g<0>", parts[j])
        lines[i] = "".join(parts)


def setup(app: object) -> None:
    app.connect("source-read", own_pages)  # type: ignore[attr-defined]
    app.connect("autodoc-process-docstring", plain, priority=400)  # type: ignore[attr-defined]


write_cli_page()
