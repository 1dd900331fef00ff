"""Hybrid lines whose rod domains follow the motion: before the run from the static state, then window by window.

A window that ends with a state which needs a rod outside the present domains is run again with larger ones; where only
their padding is touched they grow for the next one, and domains that are no longer wanted shrink at a window's end. The
energy that a change of domains adds or takes is an error of the choice, not of the march: it goes into the estimated
error, not into the ledger's gap. The error of the choice is estimated a posteriori: one Newton step of the full rod
from the hybrid's state.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from . import scene as sc
from .banded import hold
from .dispatch import (
    GRAVITY,
    KINETIC,
    N_ENERGIES,
    STRAIN,
    call_backsolve,
    call_energies,
    call_factorise,
    call_residual,
    call_tangent,
)
from .lines.rod import RodModel, domains
from .lines.rod.params import mesh_of
from .methods import statics
from .methods.march import C_STEPS, LEDGER
from .model import Ask, Status
from .quantities import QUANTITIES

SHARE = 1.0  # of `accuracy`: the share of the load that a catenary may neglect
WINDOWS = 24  # at least, in a run
PER_PERIOD = 8  # windows in the shortest period of the excitation
WORTH = 0.6  # domains shrink when at most this share of their elements is left
NEGLIGIBLE = 1e-5  # share of the load that nobody asks about
ATTEMPTS = 5  # at a window with larger domains, before it is taken as it is
ROUNDS = 8  # of static state and domains


def _model(scene: sc.Scene, segments: int, ask: Ask, rod: Any) -> RodModel:
    return RodModel(scene, segments, rod, ask.rho_space, "hybrid")


def build(scene: sc.Scene, segments: int, ask: Ask | None = None) -> RodModel:
    """A hybrid with the domains asked for, or, before they are known, with rods where the ends demand them."""
    ask = ask or Ask(model="hybrid")
    rod: Any = ask.rods
    if rod is None:
        s, section = mesh_of(scene, segments)
        middle = (s[1:] + s[:-1]) / 2 / s[-1]
        bends = np.array([scene.cable[k].EI > 0 for k in section])
        edge = [(x, end) for x, end in ((middle, scene.end_a), (1 - middle, scene.end_b))]
        rod = np.any([(x < 0.2) & bool(end.direction or end.moment) for x, end in edge], axis=0) & bends
        rod |= np.full(len(middle), RodModel.twisted(scene))
        own = [bool(any(x.curvature) or any(x.moment) or x.coupling) for x in scene.cable]
        rod |= np.array([own[k] for k in section])
    return _model(scene, segments, ask, rod)


def _bends(model: RodModel) -> np.ndarray:
    """(m,) bool: where the cable has bending stiffness and may be a rod."""
    return np.array([model.scene.cable[k].EI > 0 for k in model.section])


class Rest(NamedTuple):
    """A static state and the model that it belongs to."""

    status: Status
    model: RodModel
    q: np.ndarray
    note: str


def at_rest(model: RodModel, ask: Ask) -> Rest:
    """Static state of a hybrid whose domains fit it: a pilot with few rods, or the full rod where that has no state."""
    status, q, note = statics.balance(model.static_pack, model.starts())
    share = SHARE * ask.accuracy
    if status != Status.OK or model.validity(model.observe(*_still(model, q)))[0] != Status.OK:
        full = _model(model.scene, model.asked, ask, _bends(model))
        status, q, note = statics.balance(full.static_pack, full.starts())
        if status != Status.OK:
            return Rest(status, full, q, note)
        model = full
    for k in range(ROUNDS):
        rod = domains.wanted(model, q, share)
        if k >= 3:  # then domains only grow: the rounds end
            rod = domains.tidy(rod | model.rod, np.diff(model.s), domains.share_of_bending(model, q)[1])
        if np.array_equal(rod, model.rod):
            break
        other = _model(model.scene, model.asked, ask, rod)
        guess = domains.carry_over(model, other, q, np.zeros(model.ndof))[0]
        status, q, note = statics.balance(other.static_pack, [guess, *other.starts()])
        if status != Status.OK:
            other = _model(model.scene, model.asked, ask, _bends(model))
            status, q, note = statics.balance(other.static_pack, other.starts())
            return Rest(status, other, q, note)
        model = other
    return Rest(status, model, q, note)


def _still(model: RodModel, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return q[None], np.zeros((1, model.ndof)), np.zeros((1, len(model.pack.fixed))), q


def _accelerations(old: RodModel, new: RodModel, a: np.ndarray) -> np.ndarray:
    out = np.zeros(new.ndof)
    out[new.pack.r[:, None] + np.arange(3)] = a[old.pack.r[:, None] + np.arange(3)]
    return out


def inertial_load(model: RodModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(ndof,) what inertia and drag of the motion (v, a) add to the static equations: those of the linear momentum."""
    moving, still, zero = np.zeros(model.ndof), np.zeros(model.ndof), np.zeros(model.ndof)
    call_residual(0.0, q, v, a, model.pack, moving)
    call_residual(0.0, q, zero, zero, model.pack, still)
    load = np.zeros(model.ndof)
    rows = model.pack.row[:, None] + np.arange(3, 6)
    load[rows] = (moving - still)[rows]
    return load


def changed(
    old: RodModel, new: RodModel, t: float, q: np.ndarray, v: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The state of `old` at time t as one of `new`, in balance: under the inertia and drag that it had, frames, forces
    and moments (and by a little the shape) settle as at rest. Otherwise each kink of a joint would ring."""
    p, w = domains.carry_over(old, new, q, v)
    trial = p.copy()
    load = inertial_load(new, p, w, _accelerations(old, new, a))
    failed, _, _ = statics.newton_relaxation(t, trial, new.pack, load, 40, 1e-8, 0.0, 0.0)
    if failed:
        return p, w
    new.spin_along(trial, w)
    return trial, w


class Estimate(NamedTuple):
    """Estimated relative errors of a hybrid state against the full rod."""

    shape: float  # largest move of a node over the line's largest departure from its chord
    tension: float  # over the largest force
    moment: float  # over the largest moment
    energy: float = 0.0  # booked for changes of domains, over the peak energy

    @property
    def worst(self) -> float:
        return max(self)


NOTHING_LEFT_OUT = Estimate(0.0, 0.0, 0.0)


def worse(one: Estimate, other: Estimate) -> Estimate:
    """The larger of each."""
    return Estimate(*map(max, zip(one, other, strict=True)))


def joint_error(model: RodModel, q: np.ndarray, v: np.ndarray, a: np.ndarray, held: bool = False) -> Estimate:
    """What neglecting bending and the moment-free joints cost: the first Newton step of the full rod from this state,
    with its inertia and drag as they are; `held`: a released end is still held. Where nothing is a rod nobody asks for
    moments, and only shape and tension count."""
    if model.rod.all():
        return NOTHING_LEFT_OUT
    bends = _bends(model)
    if not bends.any():
        return NOTHING_LEFT_OUT
    ratio = domains.share_of_bending(model, q)[0]
    if (ratio[bends & ~model.rod] < NEGLIGIBLE).all():  # and a rod mesh could not resolve more
        return NOTHING_LEFT_OUT
    full = RodModel(model.scene, model.asked, bends, 1.0, model.name)
    x, w = domains.carry_over(model, full, q, v)
    acc = _accelerations(model, full, a)
    pack, zero = full.static_pack if held else full.pack, np.zeros(full.ndof)
    r = np.zeros(full.ndof)
    call_residual(0.0, x, zero, zero, pack, r)
    r += inertial_load(full, x, w, acc)
    J = np.zeros((full.ndof, 2 * pack.bw + 1))
    call_tangent(0.0, x, zero, zero, 1.0, 0.0, 0.0, pack, J)
    hold(J, pack.bw, pack.fixed)
    step = -r
    step[pack.fixed] = 0.0
    if not call_factorise(pack, J):
        return Estimate(np.inf, np.inf, np.inf)
    call_backsolve(pack, J, step)
    shape = full._nodal(x, pack.r)
    line = np.linspace(0, 1, full.nodes)[:, None]
    sag = np.abs(shape - (shape[0] + (shape[-1] - shape[0]) * line)).max()
    sag = max(float(sag), 1e-3 * float(model.s[-1]))
    before, after = full.fields(x[None]), full.fields((x + step)[None])
    before["moment"] = np.nan_to_num(model._nodal(q[None], model.pack.M))  # a catenary's is 0, not that of its curve

    def change(name: str) -> float:
        scale = np.abs(after[name]).max()
        return float(np.abs(after[name] - before[name]).max() / scale) if scale > 0 else 0.0

    moved = float(np.abs(full._nodal(step, pack.r)).max() / sag)
    return Estimate(moved, change("tension"), change("moment") if model.rod.any() else 0.0)


class Followed(NamedTuple):
    """A run in windows."""

    status: Status
    signals: list[dict[str, np.ndarray]]  # of each window
    ledger: np.ndarray  # (nt, 9) over the whole run
    residual: float  # of the energy balance
    counts: np.ndarray  # of all work, windows that were run again included
    steps: int  # that led from the start to the end
    seconds: float  # of all windows, changes of domains and estimates included
    error: Estimate  # the worst on the way
    changes: int  # of domains
    share: float  # mean share of rod
    model: RodModel  # the last one
    done: int  # samples


def _energy(model: RodModel, q: np.ndarray, v: np.ndarray) -> float:
    e = np.zeros(N_ENERGIES)
    call_energies(0.0, q, v, np.zeros(len(q)), model.pack, e)
    return float(e[KINETIC] + e[STRAIN] + e[GRAVITY])


def edges(ask: Ask, omega: float, breaks: tuple[float, ...]) -> np.ndarray:
    """Ends of the windows [s]."""
    count = max(WINDOWS, int(np.ceil(ask.duration * omega / (2 * np.pi) * PER_PERIOD)))
    inner = [x for x in breaks if 0 < x < ask.duration]
    return np.unique(np.concatenate([np.linspace(0, ask.duration, count + 1), inner]))


def follow(
    model: RodModel, ask: Ask, q: np.ndarray, v: np.ndarray, static: np.ndarray, grid: np.ndarray,
    advance: Callable[[RodModel, int, np.ndarray, np.ndarray, np.ndarray, np.ndarray, Any, float], Any], floor: float,
) -> Followed:  # fmt: skip
    """March in windows; `advance(model, max_steps, q, v, pieces, grid, before, first)` marches one: (code, out, ends,
    seconds, work), from (q, v) with the step `first` (0: as it thinks best), or on from the march `before` it."""
    begun, compiling = time.perf_counter(), 0.0
    cut = edges(ask, model.omega, model.breaks)
    ends_at = np.searchsorted(grid, cut[1:] * (1 - 1e-12), side="left")
    ends_at[-1] = len(grid)
    signals: list[dict[str, np.ndarray]] = []
    ledger = np.full((len(grid), len(LEDGER)), np.nan)
    counts, changes, share, error, gap = np.zeros(4, dtype=np.int64), 0, 0.0, NOTHING_LEFT_OUT, 0.0
    open_by, steps = 0.0, 0
    carried, peak, done, booked = np.zeros(len(LEDGER)), floor, 0, 0.0
    zero = held = _energy(model, q, v)  # at the start, and at the present window's
    status, before, a = Status.OK, 0, np.zeros(model.ndof)
    last, first = None, 0.0  # the march to go on from, where nothing has changed; the step that it would take
    for k in range(len(cut) - 1):
        here, after = slice(before, int(ends_at[k])), int(ends_at[k])
        for attempt in range(ATTEMPTS + 1):
            since = time.perf_counter()
            left = max(0, ask.max_steps - int(counts[C_STEPS]))
            code, out, s, spent, work = last = advance(model, left, q, v, cut[k : k + 2], grid[here], last, first)
            counts += out.counts
            compiling += time.perf_counter() - since - spent
            outside = code != 0 or domains.outside(model, s.q[0], SHARE * ask.accuracy)
            if attempt == ATTEMPTS or code == Status.TOO_MANY_STEPS or not outside:
                break
            wish = domains.wanted(model, s.q[0], SHARE * ask.accuracy) if code == 0 else _bends(model)
            rod = domains.tidy(wish | model.rod, np.diff(model.s), domains.share_of_bending(model, q)[1])
            if np.array_equal(rod, model.rod):
                break
            larger, last = _model(model.scene, model.asked, ask, rod), None
            q, v, a = *changed(model, larger, float(cut[k]), q, v, a), _accelerations(model, larger, a)
            model, changes = larger, changes + 1
            now = _energy(model, q, v)
            booked, held = booked + abs(now - held), now
        steps += int(out.counts[C_STEPS])
        n = int(out.at[0])
        rows = out.ledger[:n].copy()
        rows[:, 3:] += carried[3:]
        ledger[before : before + n] = rows
        total = s.ledger[0].copy()
        total[3:] += carried[3:]
        energy = float(total[:3].sum())
        own = s.ledger[0]
        open_by += energy - held - float(own[3] - own[4:8].sum() + own[8])
        gap = max(gap, abs(open_by), float(s.peak[2]))
        peak = max(peak, float(s.peak[0]), abs(energy - zero))
        carried = total
        observed = model.observe(out.q[:n], out.v[:n], out.f[:n], static_like(model, static))
        signals.append(observed)
        done, before = before + n, after
        share += float(model.rod.mean()) * (cut[k + 1] - cut[k]) / ask.duration
        valid = model.validity(observed)
        if code != 0 or n < here.stop - here.start or valid[0] != Status.OK:
            status = Status(code) if code else (valid[0] if valid[0] != Status.OK else Status.DIVERGED)
            break
        q, v, a = s.q[0].copy(), s.v[0].copy(), s.a[0].copy()
        first = float(work.go[0])
        if cut[k + 1] in model.breaks:
            last, first = None, 0.0
        if k % max(1, len(cut) // 8) == 0 or k + 2 == len(cut) or attempt == ATTEMPTS:
            error = worse(error, joint_error(model, q, v, s.a[0]))
        rod = domains.wanted(model, q, SHARE * ask.accuracy)
        grows = bool((rod & ~model.rod).any())
        if grows:
            rod = domains.tidy(rod | model.rod, np.diff(model.s), domains.share_of_bending(model, q)[1])
        if (grows or rod.sum() < WORTH * model.rod.sum()) and k + 2 < len(cut):
            other, last = _model(model.scene, model.asked, ask, rod), None
            q, v, a = *changed(model, other, float(cut[k + 1]), q, v, a), _accelerations(model, other, a)
            model, changes = other, changes + 1
            booked += abs(_energy(model, q, v) - energy)
        held = _energy(model, q, v)
    error = error._replace(energy=booked / peak)
    seconds = time.perf_counter() - begun - compiling
    return Followed(status, signals, ledger, gap / peak, counts, steps, seconds, error, changes, share, model, done)


def joined(windows: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Signals of all windows in one: what depends on time is put end to end."""
    out = dict(windows[0])
    for name in out:
        if name in QUANTITIES and QUANTITIES[name].dims[0] == "time":
            out[name] = np.concatenate([x[name] for x in windows])
    return out


def static_like(model: RodModel, shape: np.ndarray) -> np.ndarray:
    """A state of the model at the static shape (n, 3), for the signals that refer to it."""
    q = np.zeros(model.ndof)
    for i in range(model.nodes):
        q[model.pack.r[i] : model.pack.r[i] + 3] = shape[i]
    return q
