"""How sure a metric is: its numerical error and its sensitivity, from a handful of runs; and how chaotic the run is.

Symbols, of one metric: m the run's value, s the standard deviation over the run and its ensemble (runs with tiny
start velocities, every second one with a slightly tighter tolerance as well), d_t and d_h the differences of a run at
a tenth of the tolerance and of one on a mesh r times as fine, each against a baseline made likewise. Both are regular
errors only so far as they exceed what chance gives: two runs of a chaotic response differ by 2 s^2 in the mean square.
So

    b_t^2 = max(0, d_t^2 - 2 s^2)        b_h^2 = max(0, d_h^2 - 2 s^2) (r^2/(r^2 - 1))^2
    sd^2 = s^2 + b_t^2 + b_h^2

with the factor that second order in the mesh gives (Richardson); where a mesh converges more slowly, as on pulses with
jumps of velocity, b_h is too small by up to (r + 1)/r. sd is the standard uncertainty of the *row's* value, which is
one run; the mean of the ensemble is known better. It is NaN, never 0, where one of its parts is not known.

Growth: d(t)^2 = integral of m |v - v'|^2 along the cable, of a run and its twin, which differ at the start alone. The
finite-time Lyapunov exponent is ln(d(t*)/d(0))/t*, up to the time t* at which d reaches SATURATED times the largest
sqrt(integral of m |v|^2), where the twins are as good as strangers, or sinks into the rounding, or the run ends.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from solvers import Response

from .metrics import along

SATURATED = 0.1  # of the largest motion: twins that differ so much have nothing to do with one another any more
ROUNDING = 1e-12  # of the largest motion: nothing is left of the difference
JITTER = 0.01  # share by which the tolerance of every second member is tighter, times its number

NAN = float("nan")


class Parts(NamedTuple):
    """Standard uncertainties of one metric."""

    sensitivity: float
    tolerance: float
    mesh: float

    @property
    def total(self) -> float:
        """NaN where a part is not known."""
        return math.sqrt(self.sensitivity**2 + self.tolerance**2 + self.mesh**2)


def parts(value: float, ensemble: Sequence[float], tighter: float, finer: float, refined: float) -> Parts:
    """What the uncertainty of a metric is made of.

    Parameters
    ----------
    value : of the run
    ensemble : of its perturbed runs; empty for a response that does not depend on its start, such as a settled one
    tighter, finer : of the run at a tenth of the tolerance and on the finer mesh
    refined : how many times as fine that mesh is; 1 where there is none, and no mesh error
    """
    if not np.all(np.isfinite([value, tighter, finer, *ensemble])):
        return Parts(NAN, NAN, NAN)
    s = float(np.std([value, *ensemble], ddof=1)) if len(ensemble) else 0.0
    chance = 2 * s**2
    factor = refined**2 / (refined**2 - 1) if refined > 1 else 0.0
    return Parts(s, math.sqrt(max(0.0, (tighter - value) ** 2 - chance)),
                 factor * math.sqrt(max(0.0, (finer - value) ** 2 - chance)))  # fmt: skip


def deviations(
    values: Mapping[str, float],
    ensemble: Sequence[Mapping[str, float]],
    tighter: Mapping[str, float],
    finer: Mapping[str, float],
    refined: float,
) -> dict[str, float]:
    """``<metric>_sd`` of every metric of a row; see :func:`parts`."""
    return {
        f"{name}_sd": parts(value, [row[name] for row in ensemble], tighter[name], finer[name], refined).total
        for name, value in values.items()
    }


class Growth(NamedTuple):
    """How the difference of twins grew."""

    rate: float  # [1/s]
    saturated: bool
    time: float  # until which it was taken, from the first time on [s]


def growth(t: np.ndarray, gap: np.ndarray, size: float) -> Growth:
    """Finite-time Lyapunov exponent of twins.

    Parameters
    ----------
    t : (nt,) [s]
    gap : (nt,) their distance, of any unit
    size : largest size of the motion, of the same unit

    Returns
    -------
    Growth, with rate NaN where the twins begin apart by less than rounding or more than saturation
    """
    if len(t) < 2 or not (size > 0 and np.all(np.isfinite(gap))):
        return Growth(NAN, False, 0.0)
    high, low = gap >= SATURATED * size, gap <= ROUNDING * size
    over = np.flatnonzero(high | low)
    last = int(over[0]) if over.size else len(t) - 1
    if last == 0:
        return Growth(NAN, bool(high[0]), 0.0)
    span = float(t[last] - t[0])
    end = max(float(gap[last]), ROUNDING * size)
    return Growth(math.log(end / float(gap[0])) / span, bool(high[last]), span)


def twin_growth(run: Response, twin: Response) -> Growth:
    """Growth of the difference between a run and its twin on the same mesh, in the kinetic norm."""
    ours, theirs = (response.signals["velocity"] for response in (run, twin))
    if ours.shape != theirs.shape:
        return Growth(NAN, False, 0.0)
    mass, rigid = run.signals["span_mass"], run.signals["rigid"] > 0.5
    size = math.sqrt(float(along(ours, mass, rigid).max(initial=0.0)))
    return growth(run.t, np.sqrt(np.maximum(along(ours - theirs, mass, rigid), 0.0)), size)


def chaos(found: Sequence[Growth]) -> dict[str, float]:
    """The row's ``chaos``, its uncertainty and ``chaos_saturated``, from several twins.

    The uncertainty is the standard error of the mean over the twins; NaN of a single one.
    """
    rates = np.array([one.rate for one in found if math.isfinite(one.rate)])
    error = float(rates.std(ddof=1)) / math.sqrt(len(rates)) if len(rates) > 1 else NAN
    return {
        "chaos": float(rates.mean()) if len(rates) else NAN,
        "chaos_sd": error,
        "chaos_saturated": float(np.mean([one.saturated for one in found])) if len(found) else NAN,
    }
