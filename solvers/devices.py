"""Force laws of the devices that slide across the cable, and their packs' constants.

Paper 003 eqs. (2.2.2) and (2.2.3), corrected: y is the offset from mid-stroke, a the half-span, l0 the
natural length, k and c stiffness and damper constant of each of the two cords.
"""

from __future__ import annotations

import math

from .compile import kernel

LINEAR, SPRINGS, CORDS = 0.0, 1.0, 2.0  # TMD; two-way springs; tension-only cords


@kernel
def law_force(y, ydot, law):
    """F [N], dF/dy [N/m], dF/dydot [N s/m] of a device with constants law = (kind, k, c, l0, a).

    Springs: F = 2 (y/l) (k (l - l0) + c dl/dt), l = sqrt(a2 + y2). Cords: the bracket only while l > l0, and never
    negative.
    """
    kind, k, c, rest, a = law[0], law[1], law[2], law[3], law[4]
    if kind == LINEAR:
        return k * y + c * ydot, k, c
    length = math.sqrt(a * a + y * y)
    s = y / length  # dl/dy
    pull = k * (length - rest) + c * s * ydot
    if kind == CORDS and (length <= rest or pull <= 0.0):
        return 0.0, 0.0, 0.0
    ds = a * a / length**3
    return 2.0 * s * pull, 2.0 * (ds * pull + s * (k * s + c * ds * ydot)), 2.0 * c * s * s


def contact_rates(law, light):
    """Largest |eigenvalue| of a mass on its springs or fully taut cords, without and with their damper [1/s]; `light`
    is the inverse of its mass beside its host [1/kg]."""
    kind, k, c, rest, a = (float(x) for x in law)
    share = 1.0 if kind == LINEAR else 2.0 * (1.0 - (a / rest) ** 2)
    square, half = share * k * light, 0.5 * share * c * light
    return math.sqrt(square), max(math.sqrt(square), half + math.sqrt(max(half * half - square, 0.0)))


@kernel
def law_energy(y, law):
    """Strain energy U [J] of the two cords: k (l - l0)^2, or k y^2/2 of a linear device."""
    kind, k, rest, a = law[0], law[1], law[3], law[4]
    if kind == LINEAR:
        return 0.5 * k * y * y
    stretch = math.sqrt(a * a + y * y) - rest
    if kind == CORDS and stretch <= 0.0:
        return 0.0
    return k * stretch * stretch


@kernel
def law_loss(y, ydot, law):
    """Power lost [W]: F ydot - dU/dt, which also counts elastic energy let go when the damper would push a cord."""
    force = law_force(y, ydot, law)[0]
    kind, k, rest, a = law[0], law[1], law[3], law[4]
    if kind == LINEAR:
        return (force - k * y) * ydot
    length = math.sqrt(a * a + y * y)
    stretch = length - rest
    if kind == CORDS and stretch <= 0.0:
        return 0.0
    return (force - 2.0 * k * stretch * y / length) * ydot


@kernel
def law_gap(y, ydot, law):
    """Changes sign where a cord turns taut or slack [m]; 1 for a law without a kink."""
    if law[0] != CORDS:
        return 1.0
    length = math.sqrt(law[4] ** 2 + y * y)
    stretch = length - law[3]
    pull = stretch + law[2] / law[1] * y / length * ydot
    return pull if not (stretch <= pull) else stretch
