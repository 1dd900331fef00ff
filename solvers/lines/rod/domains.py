"""Where a cable must be a rod and where a catenary will do, and what the choice costs in accuracy.

Paper 001 asks that the transition come "at (or before) the earliest appearance of curvature and torsion as determined
by an acceptably small threshold" and leaves the threshold open. Here it is the share of the load that bending and
torsion would carry, estimated locally with the bending length lambda = sqrt(EI/T), and the moment left out:

    (lambda kappa)^2 = EI kappa^2/T     bending against tension in a curve of curvature kappa
    Mt^2/(4 EI T)                       torsion against tension: 1 is where a long straight rod coils (Greenhill)

    EI kappa/max |M|                    the moment that a catenary leaves out, against the largest of the line

An element becomes a rod above `share`, and a catenary again below a quarter of it (hysteresis). A moment dies out as
exp(-s/lambda): rod domains reach ln(1/share) lambda beyond an end that holds a direction, and `PAD` lambda beyond what
needs them, so that joints stay out of boundary layers. Small gaps between domains are closed.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from .model import RodModel, carried, upright
from .params import matrix, quaternion

PAD = 3.0  # bending lengths between what needs a rod and the joint
BACK = 0.25  # of the threshold: below it a rod turns back into a catenary
MOST = 0.75  # share of rod above which the whole line is one
LEAST_ELEMENTS = 4  # of a domain


def share_of_bending(model: RodModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per element (m,): the largest of the three ratios above, and lambda [m]; inf where there is no tension."""
    fields = model.fields(q[None])
    T = model.element_tension(q[None])[0]
    EI = np.array([model.scene.cable[k].EI for k in model.section])
    kappa, torque = fields["curvature"][0], np.abs(fields["torque"][0])
    kappa, torque = np.maximum(kappa[1:], kappa[:-1]), np.maximum(torque[1:], torque[:-1])
    taut = T > 1e-9 * model.force_scale
    safe = np.where(taut, T, 1.0)
    largest = np.abs(fields["moment"]).max()
    left_out = EI * kappa / largest if largest > 0 else np.zeros(model.segments)
    bending, torsion = EI * kappa**2 / safe, torque**2 / (4 * np.maximum(EI, 1e-300) * safe)
    length = np.where(taut, np.sqrt(EI / safe), model.scene.length)
    return np.where(taut, np.maximum(np.maximum(bending, torsion), left_out), np.inf), length


def outside(model: RodModel, q: np.ndarray, share: float) -> bool:
    """Whether the state q asks for a rod where there is none, padding aside."""
    if model.twisted(model.scene):
        return not bool(model.rod.all())
    bends = np.array([model.scene.cable[k].EI > 0 for k in model.section])
    return bool(((share_of_bending(model, q)[0] > share) & bends & ~model.rod).any())


def wanted(model: RodModel, q: np.ndarray, share: float) -> np.ndarray:
    """(m,) bool: where the state q asks for a rod, given where it is one now."""
    if model.twisted(model.scene):
        return np.ones(model.segments, dtype=bool)
    ratio, length = share_of_bending(model, q)
    middle, l = (model.s[1:] + model.s[:-1]) / 2, np.diff(model.s)
    seeds = ratio > np.where(model.rod, BACK * share, share)
    rod = seeds.copy()
    for e in np.flatnonzero(seeds):
        rod |= np.abs(middle - middle[e]) <= PAD * length[e] + l[e]
    lengths = np.concatenate([[0.0], np.cumsum(l / length)])  # in bending lengths from end A
    near, far = (lengths[1:] + lengths[:-1]) / 2, lengths[-1] - (lengths[1:] + lengths[:-1]) / 2
    for end, distance in ((model.scene.end_a, near), (model.scene.end_b, far)):
        if end.direction is not None or end.moment is not None:
            rod |= distance <= math.log(1 / share) + PAD
            rod[np.argmin(distance)] = True
    S = [model.scene.cable[k] for k in model.section]
    rod |= np.array([bool(any(x.moment) or any(x.curvature) or x.coupling) for x in S])
    rod &= np.array([x.EI > 0 for x in S])
    return tidy(rod, l, length) & np.array([x.EI > 0 for x in S])


def tidy(rod: np.ndarray, l: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Domains of at least LEAST_ELEMENTS, gaps of at least 2 PAD lambda, all rod above MOST."""
    rod = rod.copy()
    for value in (False, True):
        edges = np.flatnonzero(np.diff(np.concatenate([[-1], rod.astype(int), [-1]])) != 0)
        for a, b in pairwise(edges.tolist()):
            if rod[a] != value:
                continue
            if not value and (b - a < LEAST_ELEMENTS or l[a:b].sum() < 2 * PAD * length[a:b].mean()):
                rod[a:b] = True
            if value and b - a < LEAST_ELEMENTS:
                rod[max(0, a - 2) : b + 2] = True
    return np.ones_like(rod) if l[rod].sum() > MOST * l.sum() else rod


def carry_over(old: RodModel, new: RodModel, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The state of `old` as one of `new`, on the same nodes: new rods take their frames from the centre line, without
    twist; forces of new catenaries lie along it; moments start as those of the curve."""
    if np.array_equal(old.rod, new.rod):
        return q.copy(), v.copy()
    a, b = old.pack, new.pack
    p, w = np.zeros(new.ndof), np.zeros(new.ndof)

    def copy(mine: np.ndarray, its: np.ndarray, count: int) -> None:
        both = np.flatnonzero((mine >= 0) & (its >= 0))
        into, of = mine[both][:, None] + np.arange(count), its[both][:, None] + np.arange(count)
        p[into], w[into] = q[of], v[of]

    copy(b.r, a.r, 3)
    copy(b.N, a.N, 3)
    shape = q[a.r[:, None] + np.arange(3)]
    t = new.tangents(shape)
    known = a.p >= 0
    for i in np.flatnonzero(new.flexible & ((b.p < 0) != (a.p < 0) | (b.hinge != 0))):
        N = p[b.N[i] : b.N[i] + 3]
        p[b.N[i] : b.N[i] + 3] = max(float(N @ t[i]), 1e-3 * new.force_scale) * t[i]
    copy(b.p, a.p, 4)
    _continue_frames(known, new, p, t)
    new.spin_along(p, w)
    copy(b.p, a.p, 4)
    copy(b.M, a.M, 3)
    _curve_moments(old, new, p, shape)
    for i in np.flatnonzero((b.p >= 0) & (b.hinge != 0)):
        if 0 < i < new.nodes - 1:
            p[b.M[i] : b.M[i] + 3] = 0.0
    return p, w


def _continue_frames(known: np.ndarray, new: RodModel, q: np.ndarray, t: np.ndarray) -> None:
    """New frames carry on from those known beside them, so that no twist appears where a domain grows; a new domain
    starts upright."""
    b, known = new.pack.p, known.copy()
    inside = b >= 0
    for first in np.flatnonzero(inside & ~np.concatenate([[False], inside[:-1]])):
        stop = first + int(np.argmin(np.concatenate([inside[first:], [False]])))
        if not known[first:stop].any():
            q[b[first] : b[first] + 4] = quaternion(upright(t[first]))
            known[first] = True
    for order in (range(1, new.nodes), range(new.nodes - 2, -1, -1)):
        for i in order:
            j = i - order.step
            if known[i] or not known[j] or b[i] < 0 or b[j] < 0:
                continue
            before = q[b[j] : b[j] + 4]
            p = quaternion(carried(matrix(before), t[i]))
            q[b[i] : b[i] + 4] = p if p @ before >= 0 else -p
            known[i] = True


def _curve_moments(old: RodModel, new: RodModel, q: np.ndarray, shape: np.ndarray) -> None:
    """Moments EI t x dt/ds of new rod nodes."""
    chord = np.diff(shape, axis=0)
    t = chord / np.linalg.norm(chord, axis=1)[:, None]
    for i in np.flatnonzero((new.pack.p >= 0) & (old.pack.p < 0)):
        if 0 < i < new.nodes - 1:
            EI = new.scene.cable[new.section[i]].EI
            dl = (new.pack.l[i - 1] + new.pack.l[i]) / 2
            q[new.pack.M[i] : new.pack.M[i] + 3] = EI * np.cross(t[i - 1], t[i]) / dl
