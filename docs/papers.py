"""Make docs/papers.md: every equation, algorithm step, table, figure and claim of four papers beside this code.

    python docs/papers.py                  compute the quick numbers, check every reference, write docs/papers.md
    python docs/papers.py --dear [NAME]    also the dear numbers (all, or these), kept in docs/papers_numbers.json
    python docs/papers.py --check          compute and write nothing: is docs/papers.md what its data say?
    python docs/papers.py --run            also run every test that the report names

The records are in docs/claims/*.yaml, one for each item. A record whose code or test does not exist, whose cell is
empty, that uses a number that nobody computed, or that has one of its own without the command or test behind it, is a
mistake; all mistakes are said at once, and nothing is written.
The numbers are those of benchmarks/papers.py; each kept group says its command, date, commit and solver version.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import importlib.util
import json
import re
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
CLAIMS = ROOT / "docs" / "claims"
NUMBERS = ROOT / "docs" / "papers_numbers.json"
REPORT = ROOT / "docs" / "papers.md"
VERDICTS = ("reproduced", "refuted", "not decidable")
TEXTS = ("item", "says", "corrected", "theirs", "ours", "why")


# --------------------------------------------------------------------------- records


@dataclass(frozen=True)
class Record:
    """One item of a paper beside this code."""

    item: str  # equation, step, table, figure or claim
    says: str  # what the paper has there, in our words
    code: tuple[str, ...]  # file:symbol, or one "none: reason"
    corrected: str  # what was wrong or missing there, or why nothing was
    tests: tuple[str, ...]  # path::test, or one "none: reason"
    theirs: str
    ours: str  # with {group.name:format} where numbers come in
    verdict: str
    why: str


@dataclass(frozen=True)
class Section:
    """The items of one part of a paper."""

    title: str
    records: tuple[Record, ...]


@dataclass(frozen=True)
class Paper:
    """One paper: its title, how it is cited, what was there to read."""

    name: str
    title: str
    about: str
    sections: tuple[Section, ...]


def _listed(value: Any) -> tuple[str, ...]:
    return tuple(value) if isinstance(value, list) else (str(value),)


def load(path: Path, mistakes: list[str]) -> Paper:
    """A paper's records; what is missing or unknown in them goes to `mistakes`."""
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    sections = []
    for part in tree["sections"]:
        records = []
        for row in part["records"]:
            where = f"{path.name}, {row.get('item', '?')}"
            wanted = {*TEXTS, "code", "tests", "verdict"}
            if missing := wanted - row.keys():
                mistakes.append(f"{where}: no {', '.join(sorted(missing))}")
            if unknown := row.keys() - wanted:
                mistakes.append(f"{where}: unknown {', '.join(sorted(unknown))}")
            empty = [name for name in wanted & row.keys() if not row[name] or not str(row[name]).strip()]
            if empty:
                mistakes.append(f"{where}: empty {', '.join(sorted(empty))}")
            if row.get("verdict") not in VERDICTS:
                mistakes.append(f"{where}: the verdict {row.get('verdict')!r} is not one of {', '.join(VERDICTS)}")
            texts = {name: " ".join(str(row.get(name, "")).split()) for name in TEXTS}
            code, tests = _listed(row.get("code", "")), _listed(row.get("tests", ""))
            records.append(Record(code=code, tests=tests, verdict=str(row.get("verdict")), **texts))
        sections.append(Section(part["title"], tuple(records)))
    return Paper(path.stem, tree["title"], " ".join(tree["about"].split()), tuple(sections))


def papers(mistakes: list[str]) -> list[Paper]:
    paths = sorted(CLAIMS.glob("*.yaml"), key=lambda path: (path.stem != "003", path.stem))  # the longest first
    return [load(path, mistakes) for path in paths]


# --------------------------------------------------------------------------- references


@cache
def symbols(path: Path) -> dict[str, int]:
    """Names that a Python file defines, `Class.method` included, with their lines."""
    found: dict[str, int] = {}

    def visit(nodes: list[ast.stmt], prefix: str) -> None:
        for node in nodes:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.setdefault(prefix + node.name, node.lineno)
                if isinstance(node, ast.ClassDef):
                    visit(node.body, f"{prefix}{node.name}.")
            elif isinstance(node, ast.Assign):
                names = [name for target in node.targets for name in getattr(target, "elts", [target])]
                found.update({prefix + name.id: node.lineno for name in names if isinstance(name, ast.Name)})
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                found.setdefault(prefix + node.target.id, node.lineno)

    visit(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return found


def refers(reference: str, separator: str) -> str:
    """Why `file<separator>symbol` does not exist; empty where it does."""
    name, _, symbol = reference.partition(separator)
    path = ROOT / name
    if not path.is_file():
        return f"there is no file {name}"
    if symbol and path.suffix == ".py" and symbol not in symbols(path):
        return f"{name} has no {symbol}"
    if symbol and path.suffix != ".py" and symbol not in path.read_text(encoding="utf-8"):
        return f"{name} does not contain {symbol}"
    return ""


def reasoned(references: tuple[str, ...]) -> bool:
    """A single `none: reason`."""
    return len(references) == 1 and re.fullmatch(r"none: .{8,}", references[0]) is not None


def typed(text: str) -> str:
    """Why a measured number in a cell cannot be run again; empty where it can, or where there is none.

    It can where it is of a group, or where a command or the test that holds it stands beside it in backquotes.
    """
    for name in re.findall(r"`(test_\w+)`", text):
        if not any(name in symbols(path) for path in (ROOT / "tests").rglob("test_*.py")):
            return f"no test is called {name}"
    for name in re.findall(r"`python (\S+\.py)[^`]*`", text):
        if not (ROOT / name).is_file():
            return f"there is no file {name}"
    bare = re.sub(r"\(\d+(\.\d+)*\)", "", text)  # numbers of equations
    number = re.search(r"\d\.\d|\de[-+]?\d|\d\s?%|\d degrees", bare)
    return f"no command or test beside {number[0]}" if number and "{" not in text and "`" not in text else ""


def check(paper: Paper) -> list[str]:
    """What is wrong with a paper's references."""
    found = []
    for section in paper.sections:
        for record in section.records:
            for kind, references, separator in (("code", record.code, ":"), ("tests", record.tests, "::")):
                if reasoned(references):
                    continue
                for reference in references:
                    if wrong := refers(reference, separator):
                        found.append(f"{paper.name}, {record.item}, {kind}: {wrong}")
            if wrong := typed(record.ours):
                found.append(f"{paper.name}, {record.item}, ours: {wrong}")
    return found


# --------------------------------------------------------------------------- numbers


def benchmark() -> Any:
    """benchmarks/papers.py as a module."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    spec = importlib.util.spec_from_file_location("papers_benchmark", ROOT / "benchmarks" / "papers.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def kept() -> dict[str, Any]:
    return json.loads(NUMBERS.read_text(encoding="utf-8")) if NUMBERS.is_file() else {}


def _commit() -> str:
    words = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def compute(names: list[str]) -> None:
    """Compute groups of numbers and keep each as soon as it is there."""
    module = benchmark()
    from solvers import SOURCE_HASH

    for name in names:
        begun = time.perf_counter()
        values = module.GROUPS[name].make()
        found = kept()
        found[name] = {
            "command": f"python benchmarks/papers.py {name}",
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "commit": _commit(),
            "solver": SOURCE_HASH,
            "seconds": round(time.perf_counter() - begun, 1),
            "dear": module.GROUPS[name].dear,
            "values": {key: float(f"{value:.7g}") for key, value in values.items()},
        }
        NUMBERS.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        print(f"{name}: {len(values)} numbers, {found[name]['seconds']} s", file=sys.stderr, flush=True)


class Numbers:
    """`{group.name}` in a record's text; a name that nobody computed is a mistake, not a blank."""

    def __init__(self, groups: dict[str, Any]) -> None:
        self.groups = groups
        self.used: set[str] = set()  # in the whole page
        self.here: dict[str, None] = {}  # since `sources` was asked last, in order

    def sources(self) -> str:
        """The groups of the numbers filled in since this was asked last, as the last table names them; or nothing."""
        names, self.here = list(self.here), {}
        return f"numbers: {', '.join(f'`{name}`' for name in names)}" if names else ""

    def fill(self, text: str, where: str, mistakes: list[str]) -> str:
        """`{group.name:format}`; `{group.name±:format}` is the mean and the standard deviation of one run."""

        def number(match: re.Match[str]) -> str:
            name, key, spread, form = match.groups()
            values = self.groups.get(name, {}).get("values", {})
            if key not in values or (spread and f"{key}_sd" not in values):
                mistakes.append(f"{where}: no number {name}.{key}")
                return "?"
            self.used.add(name)
            self.here[name] = None
            percent = form.endswith("p")  # in percent, without the sign
            form, unit = (form[:-1] + "f", 100.0) if percent else (form, 1.0)
            shown = f"{values[key] * unit:{form}}"
            return f"{shown} ± {values[f'{key}_sd'] * unit:{form}}" if spread else shown

        return re.sub(r"\{(\w+)\.([\w.]+)(±?):([^{}]*)\}", number, text)


# --------------------------------------------------------------------------- the page


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _references(references: tuple[str, ...], separator: str) -> str:
    """Files, each with its symbols under it; or the reason why there are none."""
    if reasoned(references):
        return _cell(references[0].removeprefix("none: "))
    files: dict[str, list[str]] = {}
    for reference in references:
        name, _, symbol = reference.partition(separator)
        files.setdefault(name, []).extend([symbol] if symbol else [])
    return "<br>".join("<br>".join(f"`{word}`" for word in (name, *inside)) for name, inside in files.items())


def tally(every: list[Paper]) -> str:
    rows = []
    for paper in every:
        verdicts = [record.verdict for section in paper.sections for record in section.records]
        counts = " | ".join(str(verdicts.count(name)) for name in VERDICTS)
        rows.append(f"| [{paper.title}](#{anchor(paper.title)}) | {len(verdicts)} | {counts} |")
    head = f"| paper | items | {' | '.join(VERDICTS)} |\n|---|---|---|---|---|"
    return "\n".join([head, *rows])


def anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def render(every: list[Paper], numbers: Numbers, mistakes: list[str]) -> str:
    """The page's text."""
    head = (CLAIMS / "answers.md").read_text(encoding="utf-8").rstrip()
    answers = []
    for paragraph in head.split("\n\n"):
        text = numbers.fill(paragraph, "answers.md", mistakes).replace("<!-- tally -->", tally(every))
        answers.append(f"{text} ({sources})" if (sources := numbers.sources()) else text)
    parts = ["\n\n".join(answers)]
    columns = ("item", "the paper", "code", "corrected", "test", "theirs", "ours", "verdict and why")
    for paper in every:
        parts += [f"\n## {paper.title}\n", paper.about]
        for section in paper.sections:
            parts.append(f"\n### {section.title}\n")
            parts.append(f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|")
            for record in section.records:
                where = f"{paper.name}, {record.item}"
                filled = {
                    name: numbers.fill(getattr(record, name), where, mistakes)
                    for name in ("says", "corrected", "theirs", "ours", "why")
                }
                if sources := numbers.sources():
                    filled["ours"] += f"; {sources}"
                cells = (
                    record.item, filled["says"], _references(record.code, ":"), filled["corrected"],
                    _references(record.tests, "::"), filled["theirs"], filled["ours"],
                    f"**{record.verdict}**: {filled['why']}",
                )  # fmt: skip
                raw = (2, 4)
                parts.append("| " + " | ".join(c if i in raw else _cell(c) for i, c in enumerate(cells)) + " |")
    parts.append("\n## Where the numbers come from\n")
    parts.append(
        "The solver is the hash of `solvers/` with which a group was computed; `python -c 'import solvers; "
        "print(solvers.SOURCE_HASH)'` prints that of the code at hand. A group of another hash has not been computed "
        "by this code, but for those that `pytest tests/unit/test_papers.py` computes anew each time.\n"
    )
    parts.append("| group | command | kept on | commit | solver | seconds |\n|---|---|---|---|---|---|")
    for name in sorted(numbers.used):
        group = numbers.groups[name]
        parts.append(
            f"| {name}{' (dear)' if group['dear'] else ''} | `{group['command']}` | {group['date']} "
            f"| {group['commit']} | {group['solver']} | {group['seconds']} |"
        )
    return "\n".join(parts) + "\n"


def page(groups: dict[str, Any]) -> tuple[str, list[str]]:
    """The report's text and all that is wrong with its data."""
    mistakes: list[str] = []
    every = papers(mistakes)
    for paper in every:
        mistakes += check(paper)
    text = render(every, Numbers(groups), mistakes)
    return text, mistakes


def named_tests() -> list[str]:
    """Every test that the report names, once."""
    every = papers([])
    found = {
        test for paper in every for section in paper.sections for record in section.records
        if not reasoned(record.tests) for test in record.tests
    }  # fmt: skip
    return sorted(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dear", nargs="*", metavar="NAME", help="compute dear numbers anew: all, or these")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 where the page is not current")
    parser.add_argument("--run", action="store_true", help="run the tests that the report names")
    options = parser.parse_args()
    if not options.check:
        groups = benchmark().GROUPS
        quick = [name for name, entry in groups.items() if not entry.dear]
        dear = [] if options.dear is None else options.dear or [n for n, entry in groups.items() if entry.dear]
        if unknown := set(dear) - groups.keys():
            parser.error(f"no group {', '.join(sorted(unknown))}; there are {', '.join(groups)}")
        compute(dear if options.dear else quick + dear)
    text, mistakes = page(kept())
    if mistakes:
        print("\n".join(mistakes) + f"\n{len(mistakes)} mistakes; nothing written", file=sys.stderr)
        return 2
    current = REPORT.is_file() and REPORT.read_text(encoding="utf-8") == text
    if options.check:
        print(f"{REPORT.name} is {'current' if current else 'not what its data say: python docs/papers.py'}")
    elif not current:
        REPORT.write_text(text, encoding="utf-8")
        print(f"wrote {REPORT}")
    if options.run:
        return subprocess.run([sys.executable, "-m", "pytest", "-q", *named_tests()], cwd=ROOT, check=False).returncode
    return 0 if current or not options.check else 1


if __name__ == "__main__":
    sys.exit(main())
