"""What a study leaves to pilots (mesh, tolerance, line and method) settled once for all its points.

Pilots of single points would cost more than the points. The first design and those with every variable at its least
and at its greatest are piloted; the finest mesh and the tightest tolerance count for all. The points beside them are
still compared with a coarser run, which is cheap.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import yaml

from solvers import MODELS, Ask, Response, impacts, pilot, solve

from .config import Study, parse_study
from .space import extremes, make_point
from .store import write_whole

FILE = "mesh.json"


def open_to_pilots(study: Study) -> bool:
    """Whether the study asks for an accuracy and leaves the mesh open."""
    return study.ask.segments is None and not impacts(study.scene) and "ask.segments" not in _bound(study)


def _bound(study: Study) -> set[str]:
    return {path for key, variable in study.variables.items() for path in variable.paths(key)}


def found_by_pilots(study: Study) -> dict[str, Any]:
    """Fields of the ask that pilots settle, and `because`: a sentence for each pilot."""
    runs: dict[str, Response] = {}
    for label, values in extremes(study).items():
        point = make_point(study, 0, 0, values)
        runs[label] = solve(point.scene, point.ask)
    lines = {run.model for run in runs.values()}
    if len(lines) > 1 and study.ask.model == "auto":  # one line for all: the one that can do most
        model = max(lines, key=lambda name: (MODELS[name].features.value.bit_count(), name))
        return found_by_pilots(replace(study, ask=replace(study.ask, model=model)))
    methods = {run.method for run in runs.values()}
    if len(methods) > 1 and study.ask.duration > 0 and study.ask.method == "auto" and "harmonic" not in methods:
        dearest = max(runs.values(), key=pilot.operations)
        return found_by_pilots(replace(study, ask=replace(study.ask, method=dearest.method)))
    found: dict[str, Any] = {"segments": max(run.segments for run in runs.values()), "model": lines.pop()}
    tolerances = [run.tolerance for run in runs.values() if math.isfinite(run.tolerance)]
    if len(methods) == 1 and "harmonic" not in methods:  # harmonic balance keeps its way back to the time domain
        found["method"] = methods.pop()
        if tolerances and study.ask.duration > 0:
            found["tolerance"] = min(tolerances)
            if all(run.trusted and not run.chaotic for run in runs.values()):
                found["checked_tolerance"] = found["tolerance"]
    found["because"] = {label: f"{run.status.name}: {run.reason}" for label, run in runs.items()}
    return found


def mesh_error(study: Study, run: Response) -> float | None:
    """Estimated relative error of the waveform that a mesh given by the user leaves in the first design, from a run on
    half of it; None where nothing is given, or nothing can tell: impacts, and what did not come to its end.

    Order 2, which is what jumps of velocity leave of any line. Infinite where the two have little in common.

    Parameters
    ----------
    run : the first design's
    """
    if study.ask.segments is None or impacts(study.scene) or "ask.segments" in _bound(study) or len(run.t) < 2:
        return None
    point = make_point(study, 0, 0, extremes(study)["first"])
    asked = replace(point.ask, model=run.model, method=run.method, segments=max(run.segments // 2, 2))
    found = pilot.gap(solve(point.scene, asked), run)
    if run.status not in pilot.ENDED or not math.isfinite(found):
        return None
    return found / 3 if found < pilot.CHAOTIC else math.inf


def about_mesh(study: Study, run: Response) -> str:
    """What `check` says of a given mesh whose waveform is not as accurate as `accuracy` asks; "" where it is."""
    error = mesh_error(study, run)
    if error is None or error <= study.ask.accuracy:
        return ""
    size = f"some {error:.2g}" if math.isfinite(error) else f"above {pilot.CHAOTIC / 3:g}"
    return (
        f"{run.segments} segments as asked: beside half of them the waveform's error is {size}, above `accuracy` "
        f"{study.ask.accuracy:g}; integrals over the run converge faster. Without `segments` pilots find the mesh"
    )


def resolve(study: Study, directory: str | Path | None = None) -> tuple[Study, dict[str, str]]:
    """The study with its mesh settled, and why; kept in `directory`, so that it is settled once."""
    if not open_to_pilots(study):
        return study, {}
    token = hashlib.sha256(study.text.encode()).hexdigest()
    path = None if directory is None else Path(directory) / FILE
    known: dict[str, Any] = {}
    if path is not None and path.is_file():
        known = json.loads(path.read_text(encoding="utf-8"))
    if known.get("study") != token:
        known = {"study": token, "ask": found_by_pilots(study)}
        if path is not None:
            text = json.dumps(known, indent=1)
            write_whole(path, lambda place: place.write_text(text, encoding="utf-8"))
    ask = dict(known["ask"])
    because = ask.pop("because")
    tree = yaml.safe_load(study.text)
    tree["ask"] = {**tree["ask"], **ask}
    settled = parse_study(tree)
    return replace(settled, ask=Ask(**{**asdict(study.ask), **ask})), because
