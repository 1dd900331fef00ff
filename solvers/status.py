"""How a run ended, and what to do about it."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """How a run ended. Only OK is trusted."""

    OK = 0
    DIVERGED = 1
    NO_CONVERGENCE = 2
    STEP_TOO_SMALL = 3
    TOO_MANY_STEPS = 4
    UNRESOLVED = 5
    COARSE_STEP = 6
    ENERGY_OPEN = 7
    NO_STATIC = 8
    CANNOT_REPRESENT = 9
    FEW_HARMONICS = 10
    UNSTABLE = 11
    ZERO_TENSION = 12
    ROD_NEEDED = 13


REMEDY = {
    Status.OK: "nothing to do",
    Status.DIVERGED: "the state left the finite numbers: take a step below the stability limit, or an adaptive method",
    Status.NO_CONVERGENCE: "Newton did not converge: lower the step or the tolerance, or use the explicit method",
    Status.STEP_TOO_SMALL: "the step fell below its least value: raise the tolerance or soften the stiffest part",
    Status.TOO_MANY_STEPS: "the step budget is spent: raise `max_steps`, the tolerance, or use a cheaper mesh",
    Status.UNRESOLVED: "the mesh is too coarse for the waves or the boundary layer in this scene: raise `segments`",
    Status.COARSE_STEP: "the steps are too coarse for what moves: lower `step` or `tolerance`, or take `explicit`",
    Status.ENERGY_OPEN: "the energy balance does not close: lower `tolerance` or `step`",
    Status.NO_STATIC: "no static start was found: check weight, length and ends, or give the start's shape",
    Status.CANNOT_REPRESENT: "choose a model that can represent the scene (`sweep models`)",
    Status.FEW_HARMONICS: "the series is too short: raise `tolerance` or `harmonics`, or run the time domain",
    Status.UNSTABLE: "such a state would not last: disturb it in the time domain (`perturbation`), or ask for another",
    Status.ZERO_TENSION: "a catenary has no direction without tension: `rod` or `hybrid` have, or `lumped` for EI = 0",
    Status.ROD_NEEDED: "bending matters outside the rods: let `rods` adapt or widen them, `model: rod`, or accept less",
}
