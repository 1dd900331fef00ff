"""The verbs of the contract. A method calls them; a line gives them bodies; the pack's type picks the body.

A verb called in a kernel is resolved by numba at compile time: one ``overload`` per verb looks up (verb, class of
the pack). Unlike a function passed as an argument this is disk-cached, so a second process starts in milliseconds.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core import types
from numba.extending import overload

from .banded import factor, substitute
from .compile import NO_COUNTING

BODIES: dict[tuple[str, type], Callable[..., None]] = {}


def drive(t, pack, q, v, a):
    """Write position, velocity and acceleration of the prescribed dofs at time t [s]."""


def residual(t, q, v, a, pack, r):
    """F(t, q, q', q'') in all rows [N]; at a prescribed dof r is the external force that it takes."""


def tangent(t, q, v, a, cq, cv, ca, pack, J):
    """cq dF/dq + cv dF/dv + ca dF/da in band storage J[i, bw + j - i]; J is overwritten."""


def accelerate(t, q, v, a, pack, r):
    """Solve F = 0 for a at the free dofs (a is given at the prescribed ones); r as in ``residual`` there."""


def energies(t, q, v, a, pack, e):
    """Energies and powers, indices below: e[KINETIC], e[STRAIN], e[GRAVITY] [J], e[WATER:] lost powers [W]."""


def losses(t, q, v, a, pack, e):
    """The lost powers e[WATER:] of ``energies`` alone; the other entries mean nothing. Default: ``energies``."""


def gaps(t, q, v, pack, g):
    """Functions that change sign at a kink (cord taut, contact, slack); steps may land on their zeros."""


def factorise(pack, J):
    """Factor a tangent in place; False where it is singular. Default: banded LU without row exchanges."""


def backsolve(pack, J, x):
    """Solve with the factors of ``factorise``, x in place."""


def heft(t, q, e, pack, r):
    """r = dF/da e, the inertia of a velocity error. Default: ``pack.weight`` e."""


def constrained(pack):
    """Whether the line has constraints, so that its acceleration alone cannot be solved for. Default: no."""


_ALL = (drive, residual, tangent, accelerate, energies, losses, gaps, factorise, backsolve, heft, constrained)
VERBS: dict[str, Callable[..., Any]] = {f.__name__: f for f in _ALL}

KINETIC, STRAIN, GRAVITY, WATER, CABLE, DEVICE, SEABED, ROTATION, N_ENERGIES = range(9)


def provides(pack: type, **bodies: Callable[..., None]) -> None:
    """Register the bodies of a line's verbs. Raises TypeError for a wrong name, arguments, place or a duplicate."""
    for name, body in bodies.items():
        if name not in VERBS:
            raise TypeError(f"no verb is called {name}; verbs are {', '.join(VERBS)}")
        wanted, given = inspect.signature(VERBS[name]), inspect.signature(body)
        if list(wanted.parameters) != list(given.parameters):
            raise TypeError(f"{name} takes {wanted}, {body.__name__} takes {given}")
        if not body.__module__.startswith("solvers."):
            raise TypeError(
                f"{name}: bodies must live under solvers/, or numba's cache would serve old physics"
            )
        if (name, pack) in BODIES:
            raise TypeError(f"{pack.__name__} already has a body for {name}")
        BODIES[name, pack] = body


def has(pack: type, name: str) -> bool:
    """Whether a line supplies a verb."""
    return (name, pack) in BODIES


def _body(name: str, pack: types.Type) -> Callable[..., None] | None:
    if not isinstance(pack, types.BaseNamedTuple):
        return None
    return BODIES.get((name, pack.instance_class))  # type: ignore[attr-defined]


@overload(drive, jit_options=NO_COUNTING)
def _drive(t, pack, q, v, a):
    return _body("drive", pack)


@overload(residual, jit_options=NO_COUNTING)
def _residual(t, q, v, a, pack, r):
    return _body("residual", pack)


@overload(tangent, jit_options=NO_COUNTING)
def _tangent(t, q, v, a, cq, cv, ca, pack, J):
    return _body("tangent", pack)


@overload(accelerate, jit_options=NO_COUNTING)
def _accelerate(t, q, v, a, pack, r):
    return _body("accelerate", pack)


@overload(energies, jit_options=NO_COUNTING)
def _energies(t, q, v, a, pack, e):
    return _body("energies", pack)


@overload(losses, jit_options=NO_COUNTING)
def _losses(t, q, v, a, pack, e):
    return _body("losses", pack) or _body("energies", pack)


@overload(gaps, jit_options=NO_COUNTING)
def _gaps(t, q, v, pack, g):
    return _body("gaps", pack)


def _banded_factorise(pack, J):
    return factor(J, pack.bw)


def _banded_backsolve(pack, J, x):
    substitute(J, pack.bw, x)


def _weighted(t, q, e, pack, r):
    for i in range(len(r)):
        r[i] = pack.weight[i] * e[i]


def _unconstrained(pack):
    return False


@overload(constrained, jit_options=NO_COUNTING)
def _constrained(pack):
    return _body("constrained", pack) or _unconstrained


@overload(factorise, jit_options=NO_COUNTING)
def _factorise(pack, J):
    return _body("factorise", pack) or _banded_factorise


@overload(backsolve, jit_options=NO_COUNTING)
def _backsolve(pack, J, x):
    return _body("backsolve", pack) or _banded_backsolve


@overload(heft, jit_options=NO_COUNTING)
def _heft(t, q, e, pack, r):
    return _body("heft", pack) or _weighted


# Entry points for Python callers: statics at start-up, tests, notebooks.


@njit(cache=True)
def call_drive(t, pack, q, v, a):
    drive(t, pack, q, v, a)


@njit(cache=True)
def call_residual(t, q, v, a, pack, r):
    residual(t, q, v, a, pack, r)


@njit(cache=True)
def call_tangent(t, q, v, a, cq, cv, ca, pack, J):
    tangent(t, q, v, a, cq, cv, ca, pack, J)


@njit(cache=True)
def call_accelerate(t, q, v, a, pack, r):
    accelerate(t, q, v, a, pack, r)


@njit(cache=True)
def call_energies(t, q, v, a, pack, e):
    energies(t, q, v, a, pack, e)


@njit(cache=True)
def call_losses(t, q, v, a, pack, e):
    losses(t, q, v, a, pack, e)


@njit(cache=True)
def call_gaps(t, q, v, pack, g):
    gaps(t, q, v, pack, g)


@njit(cache=True)
def call_factorise(pack, J):
    return factorise(pack, J)


@njit(cache=True)
def call_backsolve(pack, J, x):
    backsolve(pack, J, x)
