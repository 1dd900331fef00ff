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


@kernel
def factor_pivoting(J, bw, first, low, high, order, end, size, least):
    """J -> L U in place with row exchanges, for saddle-point systems whose rows cannot be ordered to be stable without.

    Parameters
    ----------
    first, low, high : (n,) int
        First column with an entry in each row; last row with an entry in each column, not decreasing; last column with
        an entry in each row.
    order, end, size : (n,)
        Filled: exchanges, last column of each row of U, and (scratch) the inverse of each row's largest entry.
        bw must hold the fill: at least low - column plus high - row.
    least : float
        Pivots below it, as shares of the largest entry of their rows, count as zero.
    """
    n = len(J)
    for i in range(n):
        end[i] = high[i]
        largest = 0.0
        for m in range(bw + first[i] - i, bw + high[i] - i + 1):
            if not (abs(J[i, m]) <= largest):
                largest = abs(J[i, m])
        if not (0.0 < largest < 1e300):
            return False
        size[i] = 1.0 / largest
    for k in range(n):
        p, best = k, -1.0
        for i in range(k, low[k] + 1):
            x = abs(J[i, bw + k - i]) * size[i]
            if x > best:
                p, best = i, x
        if not (best > least):
            return False
        order[k] = p
        if p != k:
            for j in range(k, max(end[k], end[p]) + 1):
                J[k, bw + j - k], J[p, bw + j - p] = J[p, bw + j - p], J[k, bw + j - k]
            end[k], end[p] = end[p], end[k]
            size[k], size[p] = size[p], size[k]
        inverse = 1.0 / J[k, bw]
        width = end[k] - k
        for i in range(k + 1, low[k] + 1):
            at = bw + k - i
            f = J[i, at] * inverse
            if f != 0.0:
                J[i, at] = f
                for m in range(1, width + 1):
                    J[i, at + m] -= f * J[k, bw + m]
                if end[i] < end[k]:
                    end[i] = end[k]
    return True


@kernel
def substitute_pivoting(J, bw, low, order, end, x):
    """Solve with the factors of `factor_pivoting`, in place."""
    n = len(J)
    for k in range(n):
        p = order[k]
        if p != k:
            x[k], x[p] = x[p], x[k]
        s = x[k]
        if s != 0.0:
            for i in range(k + 1, low[k] + 1):
                x[i] -= J[i, bw + k - i] * s
    for i in range(n - 1, -1, -1):
        s = x[i]
        for j in range(i + 1, end[i] + 1):
            s -= J[i, bw + j - i] * x[j]
        x[i] = s / J[i, bw]
