"""Continuation of periodic responses: the Duffing oscillator's published peaks and folds, and branches of cables."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from periodic_kit import hose, line, periodic, phases
from scipy.optimize import brentq, minimize_scalar

from solvers import Ask, CannotRepresent, Scene, Status, Window
from solvers.branches import response_curve
from solvers.lines.oscillator import Oscillator, oscillator
from solvers.methods import continuation, harmonic
from solvers.methods.continuation import Branch
from solvers.methods.harmonic import Orbit

REST = np.zeros(1)


def duffing(force: float = 0.18, frequency: float = 1.0) -> Oscillator:
    return oscillator(c=0.05, k3=0.1, force=((force, frequency, 0.0),))


def by_frequency() -> Callable[[float], tuple[Oscillator, float]]:
    pack = duffing()

    def problem(w: float) -> tuple[Oscillator, float]:
        pack.omega[0] = w
        return pack, w

    return problem


def amplitude(orbit: Orbit, h: int = 1) -> float:
    return math.hypot(*orbit.X[0, 2 * h - 1 : 2 * h + 1]) if orbit.harmonics >= h else 0.0


@pytest.fixture(scope="module")
def branches() -> dict[int, Branch]:
    """x'' + 0.05 x' + x + 0.1 x^3 = 0.18 cos(w t) from w = 0.5 to 2, by number of harmonics."""
    return {
        H: continuation.trace(by_frequency(), 0.5, 2.0, REST, harmonics=H, step=0.02, most_step=0.03) for H in (1, 5, 9)
    }


# ------------------------------------------------------------------------------------------------- Duffing


@pytest.mark.parametrize(
    ("harmonics", "peak", "at", "third", "resonance", "there"),
    [
        (1, 2.841625, 1.266634, 0.0, 2.841223, 1.267060),
        (5, 2.830198, 1.268717, 0.046164, 2.829816, 1.269133),
        (9, 2.830198, 1.268717, 0.046164, 2.829816, 1.269133),
    ],
)
def test_peak_and_phase_resonance(
    branches: dict[int, Branch], harmonics: int, peak: float, at: float, third: float, resonance: float, there: float
) -> None:
    """Largest amplitude A1 over the frequency, and where x lags by 90 degrees: scalar solves from the branch's nearest
    response, to half a unit of the last digit given (a whole one for A3); 1e-5 of the peak's frequency, where the
    amplitude is flat."""
    branch, problem = branches[harmonics], by_frequency()
    high = max(branch.points, key=lambda point: amplitude(point.orbit))

    def response(w: float) -> Orbit:
        pack, omega = problem(w)
        found = harmonic.periodic(pack, omega, REST, 1e-6, harmonics, high.orbit)
        assert amplitude(found) > 2.8  # on the upper branch still
        return found

    span = (high.parameter - 5e-4, high.parameter + 5e-4)
    best = minimize_scalar(lambda w: -amplitude(response(w)), bounds=span, method="bounded", options={"xatol": 1e-9})
    assert amplitude(response(best.x)) == pytest.approx(peak, abs=6e-7)
    assert best.x == pytest.approx(at, abs=1e-5)
    assert amplitude(response(best.x), 3) == pytest.approx(third, abs=1e-6)
    w = brentq(lambda w: response(w).X[0, 1], at - 1e-4, there + 2e-4, xtol=1e-12)
    assert w == pytest.approx(there, abs=6e-7)
    assert amplitude(response(w)) == pytest.approx(resonance, abs=6e-7)


def test_arclength_passes_both_folds(branches: dict[int, Branch]) -> None:
    """From w = 0.5 to 2 through two turning points, where dp/ds changes sign; between them w runs back. With 9
    harmonics the folds are those of 5 to 1e-6."""
    for branch in branches.values():
        assert branch.status == Status.OK, branch.message
        assert (branch.parameters[0], branch.parameters[-1]) == (0.5, 2.0)
        upper, lower = (k for k, point in enumerate(branch.points) if point.fold)
        w = np.diff(branch.parameters)
        assert np.all(w[:upper] > 0)
        assert np.all(w[upper:lower] < 0)
        assert np.all(w[lower:] > 0)
        slope = np.array([point.slope for point in branch.points])
        assert np.all(slope[:upper] > 0)
        assert np.all(slope[upper + 1 : lower] < 0)
        assert np.all(slope[lower + 1 :] > 0)
    folds = {H: np.array([point.parameter for point in branch.folds]) for H, branch in branches.items()}
    np.testing.assert_allclose(folds[9], folds[5], atol=1e-6)
    assert np.abs(folds[1] - folds[9]).max() > 1e-4
    # a fold is where w is stationary: neighbours on the arc lie on one side of it
    for branch in branches.values():
        upper, lower = (k for k, point in enumerate(branch.points) if point.fold)
        assert branch.parameters[upper] == branch.parameters[: lower + 1].max()
        assert branch.parameters[lower] == branch.parameters[upper:].min()


def test_a_fold_is_a_multiplier_at_one(branches: dict[int, Branch]) -> None:
    """Enough harmonics make the balance the oscillator itself, whose Floquet multiplier at a fold is +1: to 1e-3, what
    the multipliers' own step control leaves (5e-5 seen). Between the folds one multiplier lies outside the unit circle,
    real and positive; beyond them none does. A single harmonic's folds are not the oscillator's."""
    branch = branches[9]
    upper, lower = (k for k, point in enumerate(branch.points) if point.fold)
    for fold in branch.folds:
        assert fold.stability is not None
        first = fold.stability.multipliers[0]
        assert abs(first - 1) < 1e-3
        assert fold.stability.kind == "fold"
    near = 2  # next to a fold the multiplier is within its error of 1
    assert np.all(branch.stable[: upper - near])
    assert np.all(branch.stable[lower + near :])
    between = branch.points[upper + near : lower - near + 1]
    assert len(between) > 20
    for point in between:
        assert not point.stability.stable
        assert point.stability.kind == "fold"
    assert max(abs(fold.stability.multipliers[0] - 1) for fold in branches[1].folds) > 2e-3


def test_stepping_the_frequency_jumps(branches: dict[int, Branch]) -> None:
    """Natural parameter continuation, the last response as the next start: up it falls off the upper branch past its
    fold, down it climbs past the other one; between the folds the same frequency has two amplitudes (hysteresis)."""
    problem, step = by_frequency(), 0.005
    grid = np.arange(1.0, 1.4 + step / 2, step)
    resonant = np.zeros((1, 11))
    resonant[0, 2] = 2.0  # lags by 90 degrees

    def sweep(frequencies: np.ndarray) -> np.ndarray:
        found, out = None, []
        for w in frequencies:
            pack, omega = problem(float(w))
            found = harmonic.periodic(pack, omega, REST, 1e-3, 5, found)
            if found.status == Status.NO_CONVERGENCE:  # neither from the last nor from rest: from one at its resonance
                found = harmonic.periodic(pack, omega, REST, 1e-3, 5, Orbit(Status.OK, "", w, resonant))
            assert found.status == Status.OK, found.message
            out.append(amplitude(found))
        return np.array(out)

    up, down = sweep(grid), sweep(grid[::-1])[::-1]
    upper, lower = (point.parameter for point in branches[5].folds)
    inside = (grid > lower + step) & (grid < upper - step)
    assert np.all(up[inside] > 1.5 * down[inside])
    outside = (grid < lower - step) | (grid > upper + step)
    np.testing.assert_allclose(up[outside], down[outside], rtol=1e-6)
    fall, climb = grid[np.argmin(np.diff(up))], grid[np.argmin(np.diff(down))]
    assert upper - 2 * step < fall < upper + step
    assert lower - 2 * step < climb < lower + step
    assert np.diff(up).min() < -1.5
    # the arc's points at these frequencies are the sweep's
    arc = [p for p in branches[5].points[: branches[5].points.index(branches[5].folds[0])] if p.parameter > 1]
    read = np.interp(grid[inside], [p.parameter for p in arc], [amplitude(p.orbit) for p in arc])
    np.testing.assert_allclose(read, up[inside], rtol=2e-3)  # linear interpolation


def test_continuation_in_the_force() -> None:
    """At w = 1.25, above the lower fold, the response to a growing force is S-shaped: two folds, the middle unstable.
    Passing them in the force or in the frequency is the same: at the folds' force the frequency has a fold there too.
    """

    def problem(force: float) -> tuple[Oscillator, float]:
        return duffing(force, 1.25), 1.25

    branch = continuation.trace(problem, 0.02, 0.6, REST, harmonics=7, step=0.02, most_step=0.03)
    assert branch.status == Status.OK, branch.message
    assert len(branch.folds) == 2
    jump, back = branch.folds
    assert back.parameter < 0.18 < jump.parameter
    for fold in branch.folds:
        assert abs(fold.stability.multipliers[0] - 1) < 1e-3
        pack = duffing(fold.parameter)

        def by_w(w: float, pack: Oscillator = pack) -> tuple[Oscillator, float]:
            pack.omega[0] = w
            return pack, w

        other = continuation.trace(by_w, 0.5, 2.0, REST, harmonics=7, step=0.02, with_stability=False)
        assert min(abs(p.parameter - 1.25) for p in other.folds) < 1e-5


def test_harmonics_are_added_on_the_way() -> None:
    """Without a number the branch takes what the tolerance needs: near resonance more than at the start."""
    branch = continuation.trace(by_frequency(), 0.8, 1.2, REST, tolerance=1e-5, with_stability=False)
    assert branch.status == Status.OK, branch.message
    used = [point.orbit.harmonics for point in branch.points]
    assert used[-1] > used[0]
    assert branch.points[-1].orbit.tail < 1e-5


# ------------------------------------------------------------------------------------------------- cables


def shaken(frequency: float = 1.2, x: float = 0.1, **section: float) -> Scene:
    scene = hose(x, **section)
    motion = scene.end_b.motion
    assert motion is not None
    term = replace(motion.harmonics[0], frequency=frequency)
    return replace(scene, end_b=replace(scene.end_b, motion=replace(motion, harmonics=(term,))))


FIELDS: dict[str, tuple[Callable[[float], Scene], float, float]] = {
    "frequency": (lambda f: shaken(frequency=f), 0.55, 0.75),
    "amplitude": (lambda x: shaken(x=x), 0.1, 0.2),
    "EA": (lambda EA: shaken(EA=EA), 9e5, 1.1e6),
    "Cdn": (lambda C: shaken(Cdn=C), 1.0, 1.5),
}


@pytest.mark.parametrize("field", FIELDS)
def test_response_curve_of_a_cable(field: str) -> None:
    """Along a field of the scene, at its ends and in between: the responses are those of lines built afresh, to 1e-3
    of displacement and tension's range, twice the estimated error."""
    scene_at, start, stop = FIELDS[field]
    ask = Ask(segments=12, harmonics=7, tolerance=1e-2)
    curve = response_curve(scene_at, start, stop, ask, step=0.1, most_step=0.3)
    assert curve.status == Status.OK, curve.message
    assert (curve.parameter[0], curve.parameter[-1]) == (start, stop)
    assert curve.trusted.all()
    assert curve.stable.all()
    assert not curve.fold.any()
    assert len(curve.parameter) >= 4
    for k in (0, len(curve.parameter) // 2, -1):
        of = line(scene_at(float(curve.parameter[k])), 12)
        found = periodic(of, 1e-2, 7)
        q = found.at(phases(96))[0]
        assert curve.omega[k] == pytest.approx(of.omega, rel=1e-12)
        assert curve.displacement[k] == pytest.approx(np.ptp(q, axis=0).max() / 2, rel=1e-3)
    if field == "amplitude":
        assert np.all(np.diff(curve.displacement) > 0)
        assert np.all(np.diff(np.ptp(curve.tension, axis=1)) > 0)
    if field == "frequency":  # through the first resonance, at 0.66 Hz without drag
        assert 0 < np.argmax(curve.displacement) < len(curve.displacement) - 1


def test_a_scene_without_a_period_has_no_curve() -> None:
    """Refused before anything is built, with the reason."""
    scene = shaken()
    motion = replace(scene.end_b.motion, window=Window(stop=3.0))
    stopped = replace(scene, end_b=replace(scene.end_b, motion=motion))
    with pytest.raises(CannotRepresent, match=r"harmonic: end_b\.motion\.window stops at 3 s"):
        response_curve(lambda _: stopped, 0.0, 1.0, Ask(segments=12))


def test_harmonics_are_added_along_the_branch() -> None:
    """A hardening spring driven harder and harder: the series grows with its estimated error, and the branch ends with
    the response that a fresh start at the end finds."""
    pack = oscillator(c=0.5, k1=1.0, k3=1.0, force=((0.1, 0.9, 0.0),))

    def problem(force: float) -> tuple[Any, float]:
        pack.amplitude[0] = force
        return pack, 0.9

    branch = continuation.trace(problem, 0.05, 3.0, np.zeros(1), tolerance=1e-5, with_stability=False)
    assert branch.status == Status.OK, branch.message
    used = [point.orbit.harmonics for point in branch.points]
    assert used[-1] > used[0]
    end = branch.points[-1].orbit
    problem(3.0)
    fresh = harmonic.periodic(pack, 0.9, np.zeros(1), 1e-9, start=end)
    assert harmonic.padded(fresh.X, end.harmonics) == pytest.approx(end.X, abs=1e-4)
