"""What the tests of every line's tangent share: band storage made dense, and central differences of the residual."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.dispatch import call_residual, call_tangent


def dense(J: np.ndarray, bw: int) -> np.ndarray:
    """Band storage J[i, bw + j - i] as a full matrix."""
    n = len(J)
    full = np.zeros((n, n))
    for i in range(n):
        for j in range(max(0, i - bw), min(n, i + bw + 1)):
            full[i, j] = J[i, bw + j - i]
    return full


def check_tangent(
    pack: Any, q: np.ndarray, v: np.ndarray, a: np.ndarray, steps: tuple[float, float, float], limit: float
) -> None:
    """Each entry of dF/dq, dF/dv, dF/da within `limit` of its row's largest, against differences of the given steps."""
    n = len(q)
    for k, (which, x, step) in enumerate(zip("qva", (q, v, a), steps, strict=True)):
        J = np.full((n, 2 * pack.bw + 1), np.nan)
        call_tangent(0.0, q, v, a, *(float(m == k) for m in range(3)), pack, J)
        if hasattr(pack, "clear"):  # a line may leave alone what its factors never read
            column = np.arange(n)[:, None] + np.arange(2 * pack.bw + 1) - pack.bw
            J[(column < pack.clear[:, :1]) | (column > pack.clear[:, 1:])] = 0.0
        analytic, numeric = dense(J, pack.bw), np.zeros((n, n))
        up, down = np.zeros(n), np.zeros(n)
        for j in range(n):
            keep = x[j]
            x[j] = keep + step
            call_residual(0.0, q, v, a, pack, up)
            x[j] = keep - step
            call_residual(0.0, q, v, a, pack, down)
            x[j] = keep
            numeric[:, j] = (up - down) / (2 * step)
        scale = np.abs(analytic).max(axis=1, keepdims=True)
        scale[scale == 0] = np.abs(analytic).max()
        worst = np.abs(analytic - numeric) / scale
        i, j = np.unravel_index(worst.argmax(), worst.shape)
        assert worst[i, j] < limit, f"d/d{which} row {i} column {j}: {analytic[i, j]} {numeric[i, j]}"
