"""Transforms against direct quadrature and an independent library; spectra and modes against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import pywt

from sweep.signals import (
    CENTRE,
    RIDGE,
    bell,
    cone,
    density,
    end_weights,
    modal_energies,
    modes,
    morlet,
    share_above,
)

DT = 1e-3  # the studies' own output interval
F = np.array([0.6, 1.0, 1.7, 3.0, 5.0, 9.0])


def chirp(s):
    """1 to 9 Hz within 8 s, not 0 at its ends."""
    return np.cos(2 * np.pi * (1.0 * s + 0.5 * s**2) + 0.3) * (1 + 0.2 * s)


def psi(tau):
    bell_of_time = np.exp(-(tau**2) / 2)
    return np.pi**-0.25 * (np.exp(1j * CENTRE * tau) - math.exp(-(CENTRE**2) / 2)) * bell_of_time


def quadrature(x, stop, f, t):
    """The integral as it is printed, by Gauss and Legendre on 2000 panels of 6 points."""
    node, weight = np.polynomial.legendre.leggauss(6)
    edge = np.linspace(0, stop, 2001)
    half = np.diff(edge)[:, None] / 2
    s = ((edge[1:] + edge[:-1])[:, None] / 2 + half * node).ravel()
    w = (half * weight).ravel()
    omega = 2 * np.pi * f
    return math.sqrt(omega / CENTRE) * np.sum(w * x(s) * np.conj(psi((s - t) * omega / CENTRE)))


def test_morlet_agrees_with_direct_quadrature_on_a_chirp():
    """To 1e-6 of the largest modulus, everywhere: in the cone of influence and at the very ends too.

    The FFT is exact but for aliases (exp(-CENTRE^2/2 (f_s/f - 1)^2)) and the end weights, of order 8 in dt: 5e-10.
    """
    t = np.arange(8001) * DT
    found = morlet(chirp(t), DT, F)
    at = [0, 1, 7, 40, 500, 2500, 4000, 6100, 7900, 7999, 8000]
    expected = np.array([[quadrature(chirp, 8.0, f, t[i]) for i in at] for f in F])
    assert np.abs(found[:, at] - expected).max() < 1e-6 * np.abs(found).max()


def test_morlet_agrees_with_pywavelets_on_a_chirp():
    """`cmor2.0-C` is exp(-tau^2/2) exp(2 pi i C tau)/sqrt(2 pi): ours is RIDGE times it at C = CENTRE/2 pi.

    PyWavelets takes means of the wavelet over samples, from a table between -8 and 8: right to (omega dt)^2/24 = 2e-4
    at 9 Hz where 16 scales are an odd number of samples, else shifted by a fraction of one. Phases are compared too.
    It has no end weights, and is off by dt x/2 at the ends of a record: here the chirp fades in and out within 0.5 s.
    """
    t = np.arange(8001) * DT
    x = chirp(t) * np.sin(np.pi / 2 * np.clip(np.minimum(t, 8 - t) / 0.5, 0, 1)) ** 2
    scales = (2 * np.round(8 * CENTRE / (2 * np.pi * F) / DT) + 1) / 16
    found = morlet(x, DT, CENTRE / (2 * np.pi * scales * DT))
    theirs, _ = pywt.cwt(x, scales, f"cmor2.0-{CENTRE / (2 * np.pi):.15f}", DT, method="fft", precision=18)
    assert np.abs(found - theirs * RIDGE * math.sqrt(DT)).max() < 1e-3 * np.abs(found).max()


def test_the_record_does_not_bite_its_tail():
    """A click at the end leaves nothing at the beginning, at frequencies of some periods a record too."""
    x = np.zeros(1000)
    x[-40:-20] = 1.0
    found = np.abs(morlet(x, 0.01, np.array([0.6, 2.0])))
    assert found[:, 0].max() < 1e-6 * found.max()  # nine seconds are 5.7 scales at 0.6 Hz: exp(-16)


def test_ridge_and_norm():
    t = np.arange(0, 20, 0.01)
    found = np.abs(morlet(0.7 * np.cos(2 * np.pi * 3.0 * t + 0.4), 0.01, np.array([1.5, 3.0, 6.0])))
    ridge = 0.35 * math.sqrt(CENTRE / (2 * np.pi * 3.0)) * RIDGE
    # the bell is cut at 10 s / scale = 31 standard deviations: only rounding and exp(-CENTRE^2/2) remain
    assert found[1, 1000] == pytest.approx(ridge, rel=1e-7)
    assert found[0, 1000] < 1e-3 * ridge  # omega/2 looks at 2 omega_c: exp(-36/2)
    assert found[2, 1000] < 0.02 * ridge  # 2 omega looks at omega_c/2: exp(-9/2)/sqrt(2) = 0.008
    tau = np.linspace(-9, 9, 4001)
    assert np.sum(np.abs(psi(tau)) ** 2) * (tau[1] - tau[0]) == pytest.approx(1.0, abs=1e-7)
    assert abs(bell(np.zeros(1))[0]) < 1e-20  # admissible: no mean
    assert bell(np.array([CENTRE]))[0] == pytest.approx(RIDGE)
    assert cone(np.array([3.0]))[0] == pytest.approx(math.sqrt(2) * CENTRE / (6 * np.pi))


def test_end_weights_integrate_polynomials():
    w = np.ones(40)
    w[:8], w[-8:] = end_weights(), end_weights()[::-1]
    s = np.arange(40.0)
    for k in range(8):
        assert np.sum(w * (s / 39) ** k) / 39 == pytest.approx(1 / (k + 1), rel=1e-11)


def test_bad_input():
    with pytest.raises(ValueError, match="too few"):
        morlet(np.ones(5), 0.1, F)
    for wrong in ([0.0], [6.0]):
        with pytest.raises(ValueError, match="5 Hz"):
            morlet(np.ones(50), 0.1, np.array(wrong))


def test_density_of_a_sine_and_of_noise():
    t = np.arange(4000) / 200
    f, p = density(np.stack([0.3 * np.sin(2 * np.pi * 12.5 * t), 5 + 0 * t], axis=1), 1 / 200)
    assert f[int(p[:, 0].argmax())] == pytest.approx(12.5)
    assert p[:, 0].sum() * (f[1] - f[0]) == pytest.approx(0.045, rel=1e-3)  # the window's leakage sums to A^2/2
    assert p[:, 1].max() < 1e-20
    noise = np.random.default_rng(0).standard_normal(200_000)
    f, p = density(noise, 0.01, pieces=400)
    assert p[1:-1].mean() == pytest.approx(0.02, rel=0.02)  # 1/50 Hz; 400 pieces of 500 bins: 0.3 % of scatter


def string(n=40):
    """Unit string and masses: omega_j = 2 n sin(j pi/2n)."""
    h = 1 / n
    K = (2 * np.eye(n - 1) - np.eye(n - 1, k=1) - np.eye(n - 1, k=-1)) / h
    return K, h * np.eye(n - 1)


def test_modes_of_a_string():
    found = modes(*string())
    assert found.omega == pytest.approx(80 * np.sin(np.arange(1, 40) * np.pi / 80))
    assert found.shapes.T @ string()[1] @ found.shapes == pytest.approx(np.eye(39), abs=1e-12)
    with pytest.raises(ValueError, match="not symmetric"):
        modes(np.triu(string()[0]), string()[1])


def test_modal_energies_add_up():
    """Parseval, for any motion; and one mode alone has one energy."""
    K, M = string()
    M = M + 0.01 * K  # a mass matrix that couples
    found = modes(K, M)
    u, v = np.random.default_rng(1).standard_normal((2, 7, 39))
    energy = modal_energies(found, u, v)
    whole = 0.5 * (np.einsum("ti,ij,tj->t", v, M, v) + np.einsum("ti,ij,tj->t", u, K, u))
    assert energy.sum(axis=1) == pytest.approx(whole, rel=1e-12)
    alone = modal_energies(found, 0.2 * found.shapes[:, 4][None], np.zeros((1, 39)))[0]
    assert alone[4] == pytest.approx(0.02 * found.omega[4] ** 2)
    assert np.delete(alone, 4).max() < 1e-20
    cut = (found.frequency[4] + found.frequency[5]) / 2
    assert share_above(found.frequency, energy, cut) == pytest.approx(energy[:, 5:].sum(axis=1) / whole)
    assert math.isnan(share_above(found.frequency, np.zeros((1, 39)), cut)[0])
