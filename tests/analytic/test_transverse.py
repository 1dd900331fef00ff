"""The transverse line against closed forms: strings, beams, sagging cables, statics, order of accuracy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from solvers import Ask, End, Harmonic, Motion, Scene, Section, Status, Water, Window, solve
from solvers.catenary import catenary_of
from solvers.lines.transverse import TransverseModel
from solvers.scene import PointMass


def held(height: float, kind: str = "pinned", along: tuple[float, float, float] = (1, 0, 0), x: float = 0.0) -> End:
    return End(kind=kind, position=(x, 0, height), **({"direction": along} if kind == "clamped" else {}))


def level(T: float, EA: float, *, kind: str = "pinned", L: float = 10.0, w: float = 0.0, **section) -> Scene:
    """A straight level cable in air at the tension T, without gravity unless w [N/m] is given."""
    cable = Section(**{"length": L, "d": 0.05, "mass": 100.0, "EA": EA, "compression": True, **section})
    if w > 0:
        cable = replace(cable, wet_weight=w)
    ends = {"end_a": held(-20, kind), "end_b": held(-20, kind, x=L * (1 + T / EA))}
    return Scene(cable=(cable,), g=9.81 if w > 0 else 0.0, **ends)


def modes(model: TransverseModel, count: int) -> np.ndarray:
    """Lowest frequencies about the static state [rad/s], with the change of tension that the stretch makes."""
    free = np.setdiff1d(np.arange(model.ndof), model.pack.fixed)
    d, g = model.dense, model.dense.G @ model.rest
    K = d.B + d.W + model.tension(model.rest) * d.G + model.pack.pull * np.outer(g, g)
    square = eigh(K[np.ix_(free, free)], d.M[np.ix_(free, free)], eigvals_only=True)
    return np.sqrt(square[:count])


def order(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize("k", [1, 2, 4])
def test_taut_string(k: int) -> None:
    """Cubic splines: frequencies from above, order 6 for a second-order equation (2p, p = 3), (k h)^6/60480 in all
    (Cottrell, Reali, Bazilevs and Hughes 2006); the closed form is (k pi/L) sqrt(T/(m c)), c = 1 + T/EA."""
    exact = k * math.pi / 10 * math.sqrt(5e4 / 100 / (1 + 5e4 / 1e9))
    errors = [modes(TransverseModel(level(5e4, 1e9), n), k)[-1] / exact - 1 for n in (6 * k, 12 * k)]
    assert min(errors) > 0
    assert order(errors)[0] == pytest.approx(6.0, abs=0.6)
    assert errors[0] < 1e-4


def test_tensioned_beam() -> None:
    """BENCHMARK 9's beam, pinned: 7.68693249, 18.79485658, 35.11617626 rad/s, order 4 (2 (p - 1)), and 1e-5 with 20
    spans, where lumped masses are off by 1.2e-3 to 1.5e-2."""
    exact = np.array([7.68693249, 18.79485658, 35.11617626])
    found = [modes(TransverseModel(level(5e4, 1e12, EI=1e5), n), 3) / exact - 1 for n in (8, 16)]
    assert np.all(np.abs(np.log2(found[0] / found[1]) - 4.0) < 0.5), found
    twenty = modes(TransverseModel(level(5e4, 1e12, EI=1e5), 20), 3)
    np.testing.assert_allclose(twenty, exact, rtol=3e-5)


def test_clamped_beam() -> None:
    """Clamped without tension: (beta L)^2 = 22.3732854, 61.6728229, 120.9033916 times sqrt(EI/m)/L2."""
    found = modes(TransverseModel(level(1e-3, 1e3, kind="clamped", EI=1e5), 24), 3)
    exact = np.array([22.3732854, 61.6728229, 120.9033916]) * math.sqrt(1e5 / 100) / 100
    np.testing.assert_allclose(found, exact, rtol=1e-4)


def test_heavy_vertical_string() -> None:
    """T = Tb + w z, pinned, Tb = w = m = L = 1: 3.78651169, 7.58157534, 11.37477503 rad/s, with EA so large that the
    stretch does not show (T/EA = 1e-9)."""
    EA = 1e9
    cable = Section(length=1.0, d=0.01, mass=1.0, EA=EA, compression=True, wet_weight=1.0)
    one = Scene(cable=(cable,), end_a=held(0), end_b=held(1 + 1.5 / EA))
    found = modes(TransverseModel(one, 30), 3)
    np.testing.assert_allclose(found, [3.78651169, 7.58157534, 11.37477503], rtol=2e-6)


def test_mass_scaling_slows_what_the_mesh_does_not_resolve() -> None:
    """A pinned beam under tension, of 24 spans: motions with four spans per wave and more keep frequency and shape, the
    others have the frequency of a wave of four spans, sqrt((EI k4 + T k2)/m) with k = 2 pi/(4 h); the highest one falls
    to a third."""
    scene = level(5e4, 1e12, EI=1e5)
    plain, slow = TransverseModel(scene, 24), TransverseModel(scene, 24, 4.0)
    k2 = (2 * math.pi / (4.0 * 10 / 24)) ** 2
    highest = math.sqrt((1e5 * k2**2 + 5e4 * k2) / 100)
    before, after = plain.spectrum(), slow.spectrum()
    np.testing.assert_allclose(after, np.minimum(before, highest), rtol=1e-6)
    assert int((before < highest).sum()) == 11  # the twelfth has four spans per wave, and splines are stiff
    assert before[-1] > 3 * highest
    free = np.setdiff1d(np.arange(plain.ndof), plain.pack.fixed)
    K = (plain.dense.B + plain.dense.W + plain.tension(plain.rest) * plain.dense.G)[np.ix_(free, free)]
    _, shapes = eigh(K, plain.dense.M[np.ix_(free, free)])
    more = (slow.dense.M - plain.dense.M)[np.ix_(free, free)] @ shapes[:, before < highest]
    assert np.abs(more).max() < 1e-9 * np.abs(slow.dense.M).max()


def test_mass_scaling_of_a_hanging_line_of_two_sections() -> None:
    """The highest frequency of the two sections' waves is kept, tension that weight makes included; no free motion is
    above it; the bound of the inertia bounds the scaled one."""
    heavy = Section(length=6.0, d=0.05, mass=40.0, EA=1e8, EI=50.0, compression=True, wet_weight=2000.0)
    light = replace(heavy, length=4.0, mass=5.0, EI=1000.0, wet_weight=20.0)
    scene = Scene(cable=(heavy, light), end_a=held(0), end_b=held(10 * (1 + 3e-4)))
    plain, slow = TransverseModel(scene, 20), TransverseModel(scene, 20, 4.0)
    T = slow.tension(slow.rest) + slow.loads.W(np.array([5.75, 6.25, 9.75]))  # the upmost span of each, the lowest
    k2 = (2 * math.pi / (4.0 * 0.5)) ** 2
    waves = np.sqrt((np.array([50.0, 1000.0, 1000.0]) * k2 + T) * k2 / np.array([40.0, 5.0, 5.0]))
    assert waves[0] < 0.5 * waves[1:].max()
    assert slow.resolved(4.0) == pytest.approx(float(waves.max()), rel=1e-12)
    np.testing.assert_allclose(slow.spectrum(), np.minimum(plain.spectrum(), waves.max()), rtol=1e-9)
    bound = np.diag(slow.pack.weight) - slow.dense.M
    assert eigh(bound, eigvals_only=True)[0] > -1e-9 * slow.pack.weight.max()


@pytest.mark.parametrize(("square", "exact"), [(1, 1.040200), (4, 1.151823), (4 * math.pi**2, 2.0), (1000, 2.848264)])
def test_irvine(square: float, exact: float) -> None:
    """First symmetric frequency of a sagging cable over that of the taut string, against Irvine's lambda2: sag/span
    1/80, where the theory's own neglect, the slope squared, is some 2e-3 of the line's chord: 0.5 %."""
    L, T, m = 40.0, 1e4, 10.0
    w = 8 * T / (80 * L)
    Le = L * (1 + (w * L / T) ** 2 / 8)
    EA = square * T * Le / L / (w * L / T) ** 2
    chord = L * (1 + T / EA - (w * L / T) ** 2 / 24)
    cable = Section(length=L, d=0.05, mass=m, EA=EA, compression=True, wet_weight=w)
    model = TransverseModel(Scene(cable=(cable,), end_a=held(-5), end_b=held(-5, x=chord)), 24)
    assert model.tension(model.rest) == pytest.approx(T, rel=3e-3)
    string = math.sqrt(T / m / chord / L)  # taut, of the same mass: angular frequency over pi
    found = modes(model, 4) / math.pi / string
    symmetric = found[np.argmin(np.abs(found - exact))]
    assert symmetric == pytest.approx(exact, rel=5e-3)


@pytest.mark.parametrize("rise", [0.0, 12.0], ids=["level", "slanting"])
def test_static_sag_is_the_catenary(rise: float) -> None:
    """A cable with a sag of 1 % between ends 40 m apart: end forces against the elastic catenary (closed form) to
    2e-3: the slope squared is 1.6e-3 at the ends."""
    cable = Section(length=40.0, d=0.05, mass=20.0, EA=2e6, compression=True, wet_weight=40.0)
    away = math.sqrt((40.0 * 1.0092) ** 2 - rise**2)
    one = Scene(cable=(cable,), end_a=held(-50), end_b=held(-50 + rise, x=away))
    run, found = solve(one, Ask(model="transverse", segments=12)), catenary_of(one)
    assert run.status == Status.OK, run.message
    top = run.signals["end_force"][0, 1]
    assert found is not None
    assert top[0] == pytest.approx(found.H, rel=2e-3)
    assert top[2] == pytest.approx(found.V, rel=2e-3)


def test_static_beam_under_its_weight() -> None:
    """A clamped beam without tension under w: sag w L4/384 EI, end moment's force w L/2, exactly (a quartic, which
    cubics meet at the knots), but for the little tension of its own stretch."""
    one = level(0.0, 1.0, kind="clamped", EI=1e5, w=50.0)
    run = solve(one, Ask(model="transverse", segments=16))
    s = run.signals
    assert s["static_position"][:, 2].min() + 20 == pytest.approx(-50 * 1e4 / (384 * 1e5), rel=1e-6)
    assert s["end_force"][0, :, 2] == pytest.approx([250.0, 250.0], rel=1e-6)


def test_rod_and_mass_as_the_lumped_line_has_them() -> None:
    """A rigid rod with a mass in a clamped beam: the lumped line on 320 segments, extrapolated from 160, has the same
    three lowest frequencies to 1e-4."""
    from solvers.dispatch import call_tangent
    from solvers.lines.lumped import LumpedModel

    rod = (PointMass(s=6.1, mass=150.0, rod=1.5),)
    one = replace(level(5e4, 1e9, kind="clamped", EI=1e5), devices=rod)
    found = []
    for segments in (160, 320):
        m = LumpedModel(one, segments)
        q, zero = m.place(m.straight()), np.zeros(m.ndof)
        free = np.setdiff1d(np.arange(m.ndof), m.pack.fixed)
        parts = []
        for which in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
            J = np.zeros((m.ndof, 2 * m.pack.bw + 1))
            call_tangent(0.0, q, zero, zero, *which, m.pack, J)
            bw, n = m.pack.bw, m.ndof
            full = sum(np.diag(J[max(0, -k) : n - max(0, k), bw + k], k) for k in range(-bw, bw + 1))
            parts.append(full[np.ix_(free, free)])
        across = np.flatnonzero(np.isin(free, m.pack.at[:, None] + 1))
        K, M = (x[np.ix_(across, across)] for x in parts)
        found.append(np.sqrt(eigh(K, M, eigvals_only=True)[:3]))
    exact = (4 * found[1] - found[0]) / 3
    np.testing.assert_allclose(modes(TransverseModel(one, 40), 3), exact, rtol=1e-4)


def smooth(segments: int) -> np.ndarray:
    """Offsets of a clamped beam in water at 11 places over 1.5 s, its end moved by a smooth pulse."""
    motion = Motion(harmonics=(Harmonic(amplitude=(0, 0, 0.02), frequency=2.0),),
                    window=Window(start=0.0, stop=1.0, ramp_up=0.5, ramp_down=0.5, shape="smooth"))  # fmt: skip
    one = level(500.0, 9e6, kind="clamped", L=20.0, EI=11710.0, mass=4.73)
    one = replace(one, water=Water(), end_b=replace(one.end_b, motion=motion))
    one = replace(one, cable=(replace(one.cable[0], Cdn=1.2, Can=1.0, d=0.076),))
    ask = Ask(duration=1.5, segments=segments, interval=0.01, model="transverse", method="dopri5", tolerance=1e-7)
    run = solve(one, ask)
    assert run.status == Status.OK, run.message
    return run.signals["position"][:, :: segments // 10, 2]


def test_order_4_on_a_smooth_pulse() -> None:
    """The bending's order, 2 (p - 1) = 4, shows from 20 spans on: errors against 160 spans fall by 16 (12 accepted)."""
    exact = smooth(160)
    errors = [float(np.linalg.norm(smooth(n) - exact) / np.linalg.norm(exact - exact[0])) for n in (20, 40)]
    assert errors[0] / errors[1] > 12
    assert errors[0] < 2e-2
