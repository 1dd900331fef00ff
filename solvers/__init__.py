"""Physics of cables with nonlinear energy sinks: scene in, response out. No files, no MPI, no printing.

Numba's disk cache serves a kernel whose callee in another file has changed; so the cache lives in a folder named
by the hash of all solver sources, set here before any kernel is imported.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numba


def _source_hash() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.relative_to(Path(__file__).parent).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


SOURCE_HASH = _source_hash()
_roots = (os.environ.get(name) for name in ("CABLE_SWEEP_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME"))
_root = next((root for root in _roots if root), "~/.cache")
CACHE = str(Path(_root).expanduser() / "cable-sweep" / f"numba-{SOURCE_HASH}")  # where compiled kernels are kept
numba.config.CACHE_DIR = CACHE  # type: ignore[attr-defined]

from .branches import ResponseCurve, response_curve  # noqa: E402
from .catalogue import METHODS, MODELS, impacts, needs, solve, warm_up  # noqa: E402
from .model import Ask, CannotRepresent, Cost, Feature, Response, Status  # noqa: E402
from .quantities import QUANTITIES  # noqa: E402
from .scene import (  # noqa: E402
    BNES,
    TMD,
    CubicNES,
    Current,
    End,
    Harmonic,
    Motion,
    PointMass,
    Scene,
    Seabed,
    Section,
    Start,
    Stochastic,
    Table,
    Turn,
    Water,
    Window,
)

__all__ = [
    "BNES", "CACHE", "METHODS", "MODELS", "QUANTITIES", "SOURCE_HASH", "TMD", "Ask", "CannotRepresent", "Cost",
    "CubicNES", "Current", "End", "Feature", "Harmonic", "Motion", "PointMass", "Response", "ResponseCurve", "Scene",
    "Seabed", "Section", "Start", "Status", "Stochastic", "Table", "Turn",
    "Water", "Window", "impacts", "needs", "response_curve", "solve",
    "warm_up",
]
