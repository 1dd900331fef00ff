"""What impacts leave in the fastest modes: how much of it a step loses, and the ledger of a study's line."""

from __future__ import annotations

import numpy as np
import pytest

from solvers import BNES, Ask, End, Harmonic, Motion, Scene, Section, Water, Window, solve
from solvers.brink import amplification
from solvers.catalogue import RING, ring_of
from solvers.dispatch import DEVICE, N_ENERGIES, WATER, call_energies, call_losses
from solvers.lines import transverse
from solvers.methods import explicit

UP = (0.0, 0.0, 1.0)
SINK = BNES(s=6.0, mass=4.0, EA=1e6, BA=40.0, length=0.5, phi0=3.562, rod="cords", drag=0.01)
CABLE = Scene(
    cable=(Section(length=10.0, d=0.08, mass=6.0, EA=5e6, EI=5000.0, BA=500.0, BI=20.0, Cdn=1.2),), water=Water(),
    devices=(SINK,), end_a=End(kind="clamped", position=(0, 0, -20), direction=UP),
    end_b=End(kind="clamped", position=(0, 0, -9.999), direction=UP, motion=Motion(
        harmonics=(Harmonic(amplitude=(0.02, 0, 0), frequency=2.0),), window=Window(stop=0.5))),
)  # fmt: skip


@pytest.mark.parametrize(("name", "table"), [("dopri5", explicit.DOPRI5), ("tsit5", explicit.TSIT5)])
def test_ring_loss_is_that_of_the_stability_function(name, table):
    """|R(iz)|2 = 1 - loss z6 + O(z8): at z = 0.05 the next term is some 1e-2 of it, rounding some 1e-6."""
    z = 0.1
    lost = (1 - float(amplification(name, np.array(1j * z))) ** 2) / z**6
    assert lost == pytest.approx(explicit.ring_loss(table), rel=0.08, abs=2e-7)


def test_a_pair_that_loses_less_may_step_further():
    """And at its own limit no step gains or loses more of the fastest mode than `dopri5` loses at its."""
    assert ring_of("dopri5") == RING
    assert 1.3 < ring_of("tsit5") / RING < 1.6
    ours, theirs = (abs(1 - amplification(name, np.array(1j * ring_of(name))) ** 2) for name in ("tsit5", "dopri5"))
    assert ours / ring_of("tsit5") < theirs / RING


def test_fewer_steps_and_a_closed_ledger():
    ask = Ask(duration=1.0, model="transverse", segments=24)
    one, two = (solve(CABLE, ask.__class__(**{**vars(ask), "method": name})) for name in ("dopri5", "tsit5"))
    assert one.trusted
    assert two.trusted
    assert two.cost.steps < 0.85 * one.cost.steps
    assert two.energy_residual < 5e-4  # half of what is trusted


def test_losses_are_those_of_the_energies():
    """The shortcut gives the same powers, bit for bit."""
    model = transverse.build(CABLE, 12)
    chance = np.random.default_rng(1)
    q = model.rest + 0.01 * chance.standard_normal(model.ndof)
    v, a = chance.standard_normal(model.ndof), np.zeros(model.ndof)
    whole, part = np.zeros(N_ENERGIES), np.zeros(N_ENERGIES)
    call_energies(0.0, q, v, a, model.pack, whole)
    call_losses(0.0, q, v, a, model.pack, part)
    assert part[WATER:].tolist() == whole[WATER:].tolist()
    assert whole[WATER] > 0
    assert whole[DEVICE] != 0
