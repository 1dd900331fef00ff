"""What the verification tests share: an oscillator marched by any method, and where the references are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solvers.lines.oscillator import Oscillator
from solvers.methods import explicit, implicit, nystrom
from solvers.methods.march import C_EVALUATIONS, C_STEPS, make_ends, make_output
from solvers.model import Status

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
TABLES = {"dopri5": explicit.DOPRI5, "tsit5": explicit.TSIT5, "rk4": explicit.RK4, "rk2": explicit.RK2}
FLOOR = 1e-12  # J: errors of an oscillator are relative from the start


class Run(NamedTuple):
    """An oscillator's march."""

    status: Status
    t: np.ndarray  # (nt,)
    q: np.ndarray  # (nt, ndof)
    v: np.ndarray  # (nt, ndof)
    ledger: np.ndarray  # (nt, 9)
    gap: float  # energy residual, as `catalogue` defines it
    steps: int
    evaluations: int


def march_oscillator(
    pack: Oscillator,
    q: list[float],
    v: list[float],
    grid: np.ndarray,
    method: str,
    *,
    step: float = 0.0,
    tol: float = 0.0,
    rho: float = 1.0,
    pieces: tuple[float, ...] = (),
    h_most: float = math.inf,
    max_steps: int = 2_000_000,
) -> Run:
    """March from (q, v) over `grid`; `step` fixed, or `tol` adaptive; `pieces` are breaks inside."""
    ndof = len(pack.weight)
    out, s = make_output(np.asarray(grid, dtype=float), ndof, 0), make_ends(ndof)
    s.q[0], s.v[0] = q, v
    n_gaps = len(pack.dev_mass)
    cuts = np.array([grid[0], *pieces, grid[-1]], dtype=float)
    first, most = (step, 1.0) if step else (1e-3, min(h_most, float(grid[-1] - grid[0])))
    limits: tuple[Any, ...] = (float(first), float(tol), float(most), 1e-13, FLOOR, max_steps)
    if method in TABLES:
        work = explicit.make_work(TABLES[method], ndof, n_gaps)
        taut = np.full(n_gaps, math.inf)
        code = explicit.march(pack, s, out, work, cuts, TABLES[method], *limits[:4], taut, *limits[4:])
    elif method == "srkn4":
        taut = np.full(n_gaps, math.inf)
        work = nystrom.make_work(ndof, n_gaps)
        code = nystrom.march(pack, s, out, work, cuts, nystrom.TABLE, float(step), taut, max_steps)
    elif method == "trbdf2":
        code = implicit.tr_bdf2(pack, s, out, implicit.make_work(ndof, pack.bw), cuts, *limits)
    else:
        newton = implicit.make_work(ndof, pack.bw)
        code = implicit.generalised_alpha(pack, s, out, newton, cuts, float(step), rho, FLOOR, max_steps)
    done = int(out.at[0])
    gap = float(s.peak[2]) / max(float(s.peak[0]), float(s.peak[1]), 1e-300)
    return Run(
        Status(code), out.t[:done], out.q[:done], out.v[:done], out.ledger[:done], gap,
        int(out.counts[C_STEPS]), int(out.counts[C_EVALUATIONS]),
    )  # fmt: skip
