"""Signal analysis on plain arrays: Morlet transform, power spectra, modes and their energies. Knows no solver.

Wavelet (paper 003, eqs. 3.5 and 3.6, the second corrected to a wavelet): with the centre omega_c

    psi(tau) = pi^-1/4 (exp(i omega_c tau) - exp(-omega_c^2/2)) exp(-tau^2/2)
    X(omega, t) = sqrt(omega/omega_c) int x(s) conj(psi((s - t) omega/omega_c)) ds

so that X has the unit of x times s^1/2, |X| = A/2 sqrt(omega_c/omega) RIDGE on the ridge of A cos(omega t), and psi has
norm 1 (but for exp(-omega_c^2/2) = 1.5e-8 at omega_c = 6). The scale is a = omega_c/omega.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

CENTRE = 6.0  # omega_c of the Morlet wavelet: about six oscillations under its bell
RIDGE = math.pi**-0.25 * math.sqrt(2 * math.pi)  # largest value of the Fourier transform of psi
ORDER = 8  # of the end weights: the truncated integral is right to dt^8
TAIL = 8.0  # scales from a wavelet's centre at which it is nothing: exp(-32)


# --------------------------------------------------------------------------- wavelets


def bell(w: np.ndarray, centre: float = CENTRE) -> np.ndarray:
    """Fourier transform of psi at the angular frequencies w of its own time."""
    return RIDGE * (np.exp(-0.5 * (w - centre) ** 2) - np.exp(-0.5 * (centre**2 + w**2)))


def end_weights(order: int = ORDER) -> np.ndarray:
    """(order,) weights of the first samples that make a sum dt x_j an integral from the first sample on (Gregory).

    The sum's error by Euler and Maclaurin, -zeta(-k) for j^k, is fitted on the first samples.
    """
    from scipy.special import bernoulli

    powers = np.arange(order)
    wanted = np.concatenate(([-0.5], (bernoulli(order) / np.maximum(np.arange(order + 1), 1))[2:]))
    return 1.0 + np.linalg.solve(np.vander(powers.astype(float), order, increasing=True).T, wanted)


def morlet(x: np.ndarray, dt: float, frequency: np.ndarray, centre: float = CENTRE) -> np.ndarray:
    """X(omega, t) of the module's head, by FFT; x counts as 0 outside the record.

    The convolution is circular on a record padded with zeros so far that no wavelet reaches round it; the record's ends
    carry Gregory weights, because a plain sum over a record that does not begin and end with 0 is off by dt x/2 there.

    Parameters
    ----------
    x : (nt,) samples, dt [s] apart; at least 16
    frequency : (nf,) [Hz], above 0 and at most half of the sampling rate

    Returns
    -------
    (nf, nt) complex, unit of x times s^1/2

    Raises
    ------
    ValueError
        For fewer samples, or frequencies that they do not have.
    """
    from scipy.fft import fft, fftfreq, ifft, next_fast_len

    x, frequency = np.asarray(x, dtype=float), np.atleast_1d(np.asarray(frequency, dtype=float))
    if len(x) < 2 * ORDER:
        raise ValueError(f"{len(x)} samples are too few for frequencies")
    if not (np.all(frequency > 0) and np.all(frequency <= 0.5 / dt * (1 + 1e-12))):
        raise ValueError(f"frequencies must lie above 0 and up to half of the sampling rate, {0.5 / dt:.4g} Hz")
    weight = np.ones(len(x))
    weight[:ORDER] = end_weights()
    weight[-ORDER:] = weight[ORDER - 1 :: -1]
    reach = TAIL * centre / (2 * math.pi * float(frequency.min()))
    n = next_fast_len(len(x) + math.ceil(reach / dt))
    spectrum, omega = fft(x * weight, n), 2 * np.pi * fftfreq(n, dt)
    found = np.empty((len(frequency), len(x)), dtype=complex)
    for i, f in enumerate(frequency):
        scale = centre / (2 * math.pi * f)
        found[i] = ifft(spectrum * math.sqrt(scale) * bell(scale * omega, centre))[: len(x)]
    return found


def cone(frequency: np.ndarray, centre: float = CENTRE) -> np.ndarray:
    """How far from the record's ends they weigh in [s]: sqrt(2) scales, where a step's trace has fallen by 1/e in
    amplitude (Torrence and Compo, 1998)."""
    return math.sqrt(2) * centre / (2 * math.pi * np.asarray(frequency, dtype=float))


# --------------------------------------------------------------------------- spectra


def density(x: np.ndarray, dt: float, pieces: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """One-sided power spectral density by Welch: Hann windows over halves of each other, each piece without its mean.

    Parameters
    ----------
    x : (nt,) or (nt, m) samples, dt [s] apart
    pieces : into how many lengths of the window the record is cut

    Returns
    -------
    (nf,) frequency [Hz]; (nf,) or (nf, m) density, unit of x squared per Hz: its integral is the variance
    """
    from scipy.signal import welch

    size = max(16, 2 * len(x) // (pieces + 1))
    return welch(x, 1 / dt, nperseg=min(size, len(x)), axis=0)


# --------------------------------------------------------------------------- modes


class Modes(NamedTuple):
    """Free vibrations of K u + M u'' = 0, shapes @ shapes of norm 1 in M."""

    omega: np.ndarray  # (m,) rising [rad/s]; 0 for a mode without stiffness
    shapes: np.ndarray  # (n, m) [kg^-1/2]
    mass: np.ndarray  # (n, n) M [kg]

    @property
    def frequency(self) -> np.ndarray:
        """(m,) [Hz]"""
        return self.omega / (2 * np.pi)


def modes(K: np.ndarray, M: np.ndarray) -> Modes:
    """All modes of a symmetric stiffness and mass matrix; ValueError where they are not symmetric to 1e-6."""
    from scipy.linalg import eigh

    for name, A in (("stiffness", K), ("mass", M)):
        if np.abs(A - A.T).max() > 1e-6 * np.abs(A).max():
            raise ValueError(f"the {name} matrix is not symmetric: the line has no normal modes")
    square, shapes = eigh((K + K.T) / 2, (M + M.T) / 2)
    return Modes(np.sqrt(np.maximum(square, 0.0)), shapes, M)


def modal_energies(found: Modes, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Kinetic and potential energy of each mode, 1/2 (eta'^2 + omega^2 eta^2) with eta = shape M u.

    Their sum is 1/2 v M v + 1/2 u K u (Parseval), because the shapes span all that the line can do.

    Parameters
    ----------
    u, v : (nt, n) displacement [m] and velocity [m/s] of the free dofs

    Returns
    -------
    (nt, m) [J]
    """
    project = found.mass @ found.shapes
    return 0.5 * ((v @ project) ** 2 + (found.omega * (u @ project)) ** 2)


def share_above(frequency: np.ndarray, energy: np.ndarray, cut: float) -> np.ndarray:
    """(nt,) share of the modal energies (nt, m) in modes above a frequency [Hz]; NaN where there is none at all."""
    total = energy.sum(axis=-1)
    return np.divide(
        energy[..., frequency > cut].sum(axis=-1), total, out=np.full(total.shape, np.nan), where=total > 0
    )
