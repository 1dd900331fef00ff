"""Banded LU without pivoting: J[i, bw + j - i], factored in place. Cacheable, and as fast as LAPACK at these widths."""

from __future__ import annotations

from .compile import kernel


@kernel
def factor(J, bw):
    """J -> L U in place. False when a pivot vanishes or is not a number."""
    n = len(J)
    for k in range(n):
        pivot = J[k, bw]
        if not (abs(pivot) > 1e-300):
            return False
        inverse = 1.0 / pivot
        last = min(k + bw, n - 1)
        width = last - k
        for i in range(k + 1, last + 1):
            shift = k - i
            f = J[i, bw + shift] * inverse
            if f != 0.0:
                J[i, bw + shift] = f
                for m in range(1, width + 1):
                    J[i, bw + shift + m] -= f * J[k, bw + m]
    return True


@kernel
def substitute(J, bw, x):
    """Solve L U x = x in place."""
    n = len(J)
    for i in range(n):
        s = x[i]
        for j in range(max(0, i - bw), i):
            s -= J[i, bw + j - i] * x[j]
        x[i] = s
    for i in range(n - 1, -1, -1):
        s = x[i]
        for j in range(i + 1, min(i + bw, n - 1) + 1):
            s -= J[i, bw + j - i] * x[j]
        x[i] = s / J[i, bw]


@kernel
def hold(J, bw, fixed):
    """Turn the rows and columns of prescribed dofs into identity."""
    n = len(J)
    for k in range(len(fixed)):
        i = fixed[k]
        for m in range(2 * bw + 1):
            J[i, m] = 0.0
        for j in range(max(0, i - bw), min(n - 1, i + bw) + 1):
            J[j, bw + i - j] = 0.0
        J[i, bw] = 1.0
