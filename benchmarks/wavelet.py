"""The Morlet transform against direct quadrature and PyWavelets (extra `dev`) on a chirp, and its cost.

    python benchmarks/wavelet.py
"""

from __future__ import annotations

import math
import time

import numpy as np
import pywt

from sweep.signals import CENTRE, RIDGE, morlet

DT, STOP = 1e-3, 8.0
F = np.array([0.6, 1.0, 1.7, 3.0, 5.0, 9.0])


def chirp(s: np.ndarray) -> np.ndarray:
    """1 to 9 Hz within 8 s, not 0 at its ends."""
    return np.cos(2 * np.pi * (1.0 * s + 0.5 * s**2) + 0.3) * (1 + 0.2 * s)


def psi(tau: np.ndarray) -> np.ndarray:
    """Eq. (3.5) of paper 003."""
    return np.pi**-0.25 * (np.exp(1j * CENTRE * tau) - math.exp(-(CENTRE**2) / 2)) * np.exp(-(tau**2) / 2)


def quadrature(f: float, t: float) -> complex:
    """The transform as it is printed, by Gauss and Legendre on 2000 panels of 6 points."""
    node, weight = np.polynomial.legendre.leggauss(6)
    edge = np.linspace(0, STOP, 2001)
    half = np.diff(edge)[:, None] / 2
    s, w = ((edge[1:] + edge[:-1])[:, None] / 2 + half * node).ravel(), (half * weight).ravel()
    omega = 2 * np.pi * f
    return math.sqrt(omega / CENTRE) * complex(np.sum(w * chirp(s) * np.conj(psi((s - t) * omega / CENTRE))))


def main() -> None:
    t = np.arange(round(STOP / DT) + 1) * DT
    found = morlet(chirp(t), DT, F)
    at = range(0, len(t), 50)
    exact = np.array([[quadrature(f, t[i]) for i in at] for f in F])
    gap = np.abs(found[:, at] - exact).max() / np.abs(exact).max()
    print(f"direct quadrature, at all times, ends included: {gap:.1e}")
    plain = chirp(t) * np.sin(np.pi / 2 * np.clip(np.minimum(t, STOP - t) / 0.5, 0, 1)) ** 2
    scales = (2 * np.round(8 * CENTRE / (2 * np.pi * F) / DT) + 1) / 16
    ours = morlet(plain, DT, CENTRE / (2 * np.pi * scales * DT))
    name = f"cmor2.0-{CENTRE / (2 * np.pi):.15f}"
    theirs = RIDGE * math.sqrt(DT) * pywt.cwt(plain, scales, name, DT, method="fft", precision=18)[0]
    print(f"PyWavelets, the chirp faded in and out: {np.abs(ours - theirs).max() / np.abs(ours).max():.1e}")
    lines = np.geomspace(0.6, 50, 120)
    start = time.process_time()
    morlet(chirp(t), DT, lines)
    mine = time.process_time() - start
    start = time.process_time()
    pywt.cwt(chirp(t), CENTRE / (2 * np.pi * lines) / DT, name, DT, method="fft", precision=18)
    theirs_too = time.process_time() - start
    print(f"120 frequencies of 8001 samples: {mine:.2f} s, PyWavelets {theirs_too:.2f} s of processor time")


if __name__ == "__main__":
    main()
