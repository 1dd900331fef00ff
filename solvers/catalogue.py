"""Lines x methods: who can do what, what a scene needs, the cheapest choice, and `solve`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from . import adaptive, pilot, settled
from . import scene as sc
from .catenary import catenary_of
from .dispatch import GRAVITY, N_ENERGIES, STRAIN, call_energies, call_residual, has
from .geometry import basis_of
from .lines import hermite, local, lumped, rod, transverse
from .methods import esdirk, explicit, floquet, harmonic, implicit, nystrom, statics
from .methods.march import C_EVALUATIONS, C_FACTORS, C_REJECTED, C_STEPS, LEDGER, make_ends, make_output
from .model import REMEDY, Ask, CannotRepresent, Cost, Feature, Response, Status

ENERGY_TOLERANCE = 1e-3  # a ledger that closes better than this is closed
LEAST_STEP = 1e-12  # [s]
FLOOR_SPEED = 1e-4  # velocity errors below this speed never matter [m/s]
REACH = 3.2  # largest step times |eigenvalue| of the explicit 5(4) pair, whose limit on the real axis is 3.31
RING = 0.35  # largest step of `dopri5` times the highest transverse frequency where devices ring it
TAUT = 0.5  # largest step times device frequency while a cord is taut: six steps in the shortest impact
SWING = 1.6  # largest step of `srkn4` times the highest frequency: energy to 2e-4; critical damping is stable to 2.04
SWING_REACH = 2.9  # and times an overdamped |eigenvalue|: stable at all dampings (tests/verification/test_nystrom.py)
SWING_TAUT = 1.0  # and times the largest |eigenvalue| of a device while its cord is taut, damper included
UNGUIDED = 60  # segments where no excitation sets a wave length
FIRST = 20  # most segments of the first pilot
EQUALS = ("hermite", "transverse")  # lines that pilots try beside the lumped one
LOOSE, STABLE = 100.0, 10.0  # times its default: the first tolerance that pilots try, that of an explicit method
SURE, SURER = 0.5, 0.2  # of the accuracy asked: what an error in time may be that a coarser step, tolerance tells
FEWER = 0.8  # of a run's steps: with more, a coarser one does not tell its error
CAPPED = 1.5  # times the steps that the longest one makes: a run of no more has not been controlled by its error


class Line(NamedTuple):
    """An entry of the table of lines."""

    build: Callable[..., Any]
    features: Feature
    meaning: str
    constrained: bool = False  # rod family: constraints want an implicit time method
    order: float = 2.0  # in the segment's length, where the response is smooth
    price: float = 1.0  # of an evaluation at one node, beside the lumped line's
    marched: tuple[str, ...] = ("dopri5", "trbdf2", "esdirk4")  # what pilots try, the first where they cannot tell
    measured: str = "tension's range"  # what the error of its range is relative to
    reads: tuple[str, ...] = ()  # fields of the Ask that this line alone understands; `build` then takes the Ask

    def made(self, scene: sc.Scene, segments: int, ask: Ask) -> Any:
        """The model of a scene on a mesh, as asked."""
        return self.build(scene, segments, ask) if self.reads else self.build(scene, segments)


class Method(NamedTuple):
    """An entry of the table of methods."""

    verbs: tuple[str, ...]
    adaptive: bool
    tolerance: float  # default, of an adaptive method
    meaning: str
    order: float = 4.0  # in the step, where the response is smooth
    own_step: bool = False  # of a fixed step: whether the mesh gives it where none is asked for


F = Feature
MODELS: dict[str, Line] = {
    "lumped": Line(
        lumped.build,
        F.BENDING | F.SEABED | F.DRAG | F.CURRENT | F.SLACK | F.DEVICE | F.FREE_DEVICE | F.ROD | F.MOTION | F.TRANSIENT
        | F.PERIODIC | F.LARGE_MOTION | F.SPATIAL | F.DAMPING,
        "lumped masses joined by springs, planar or spatial, with devices (paper 003)",
    ),
    "hermite": Line(
        hermite.build,
        F.BENDING | F.SEABED | F.DRAG | F.CURRENT | F.SLACK | F.MOTION | F.TRANSIENT | F.PERIODIC | F.LARGE_MOTION
        | F.DAMPING,
        "cubic elements with position and slope at every node, planar, without devices",
        order=4.0, price=4.0, marched=("esdirk4", "dopri5"),
    ),
    "local": Line(
        local.build,
        F.BENDING | F.DRAG | F.CURRENT | F.SLACK | F.MOTION | F.TRANSIENT | F.PERIODIC | F.DAMPING,
        "small motion about the static shape in local coordinates (papers 000, 002)",
    ),
    "transverse": Line(
        transverse.build,
        F.BENDING | F.DRAG | F.CURRENT | F.SLACK | F.DEVICE | F.ROD | F.MOTION | F.TRANSIENT | F.DAMPING,
        "small motion across a nearly straight cable, cubic splines, with devices",
        order=4.0, marched=("dopri5",), measured="transverse response", reads=("mass_scaling",),
    ),
    "rod": Line(
        rod.build_rod,
        F.BENDING | F.SEABED | F.DRAG | F.CURRENT | F.MOTION | F.TRANSIENT | F.PERIODIC | F.LARGE_MOTION | F.SPATIAL
        | F.TORSION | F.ROTATION,
        "rod with bending and torsion, order 12 in s (paper 001)", True, reads=("rho_space",),
    ),
    "catenary": Line(
        rod.build_catenary,
        F.BENDING | F.SEABED | F.DRAG | F.CURRENT | F.MOTION | F.TRANSIENT | F.PERIODIC | F.LARGE_MOTION | F.SPATIAL
        | F.SLACK,
        "catenary without bending, order 6 in s; needs tension everywhere (paper 001)", True, reads=("rho_space",),
    ),
    "hybrid": Line(
        adaptive.build,
        F.BENDING | F.SEABED | F.DRAG | F.CURRENT | F.MOTION | F.TRANSIENT | F.PERIODIC | F.LARGE_MOTION | F.SPATIAL
        | F.TORSION | F.ROTATION | F.SLACK,
        "rod where bending and torsion matter, catenary elsewhere, moment-free joints (paper 001)", True,
        reads=("rho_space", "rods"),
    ),
}  # fmt: skip
_MARCH = ("drive", "residual", "energies", "gaps")
_IMPLICIT = ("drive", "residual", "energies")
METHODS: dict[str, Method] = {
    "dopri5": Method(
        (*_MARCH, "accelerate"), True, 1e-4, "explicit Runge-Kutta 5(4), error control in the energy norm"
    ),
    "tsit5": Method(
        (*_MARCH, "accelerate"), True, 1e-4, "explicit Runge-Kutta 5(4) that loses less of fast ringing: impacts"
    ),
    "rk4": Method((*_MARCH, "accelerate"), False, 0.0, "explicit Runge-Kutta, order 4, fixed step"),
    "rk2": Method((*_MARCH, "accelerate"), False, 0.0, "explicit Runge-Kutta (Heun), order 2, fixed step", 2.0),
    "srkn4": Method(
        (*_MARCH, "accelerate"), False, 0.0,
        "symplectic Runge-Kutta-Nystrom, order 4, the mesh's longest good step: keeps what impacts ring", own_step=True,
    ),
    "genalpha": Method((*_IMPLICIT, "tangent"), False, 0.0, "generalised-alpha, order 2, fixed step, Newton", 2.0),
    "trbdf2": Method(
        (*_IMPLICIT, "tangent"), True, 1e-5, "TR-BDF2, order 2, implicit, error control in the energy norm", 2.0
    ),
    "esdirk4": Method(
        (*_IMPLICIT, "tangent"), True, 3e-5, "ESDIRK 4(3), implicit, error control in the energy norm: smooth motion"
    ),
    "harmonic": Method(
        ("drive", "residual", "tangent", "energies"), True, 5e-4,
        "harmonic balance: the settled response to periodic motion and its stability (papers 000, 002)",
    ),
}
ALIASES = {"explicit": "dopri5", "implicit": "trbdf2"}
MARCHES = tuple(name for name in METHODS if name != "harmonic")


def needs(scene: sc.Scene, ask: Ask | None = None) -> Feature:
    """What a scene asks of a line: derived from its fields, never declared."""
    found = Feature.NONE
    if any(s.EI > 0 for s in scene.cable):
        found |= F.BENDING
    if any(not s.carries_compression for s in scene.cable):
        found |= F.SLACK
    if scene.seabed:
        found |= F.SEABED
    if scene.water and any(s.Cdn > 0 or s.Cdt > 0 for s in scene.cable):
        found |= F.DRAG
    if scene.water and scene.water.current:
        found |= F.CURRENT
    if any(s.BA > 0 or s.BI > 0 for s in scene.cable):
        found |= F.DAMPING
    ends = (scene.end_a, scene.end_b)
    if any(end.twist != 0.0 for end in ends) or any(s.coupling or s.curvature[2] for s in scene.cable):
        found |= F.TORSION
    if any(end.moment or (end.kind == "free" and end.direction) for end in ends) or any(
        any(s.curvature[:2]) or any(s.moment) or s.EI2 not in (None, s.EI) for s in scene.cable
    ):
        found |= F.ROTATION
    for device in scene.devices:
        found |= F.FREE_DEVICE if device.kind == "bnes_free" else F.DEVICE
        if device.rod_length > 0:
            found |= F.ROD
    if any(end.motion for end in (scene.end_a, scene.end_b)):
        found |= F.MOTION
    if len(basis_of(scene)) == 3:
        found |= F.SPATIAL
    if ask is not None and ask.duration > 0:
        found |= F.TRANSIENT
    return found


def bending_matters(scene: sc.Scene, segments: int) -> bool:
    """False where bending cannot show at this resolution: no clamp or rod makes a boundary layer, and everywhere
    EI/(T l^2) is below 1e-3, T being the horizontal force of the elastic catenary and l a segment."""
    clamped = any(end.kind == "clamped" for end in (scene.end_a, scene.end_b))
    if clamped or any(device.rod_length > 0 for device in scene.devices) or not any(s.EI > 0 for s in scene.cable):
        return any(s.EI > 0 for s in scene.cable)
    found = catenary_of(scene)
    if found is None:
        return True
    return max(s.EI for s in scene.cable) / (found.H * (scene.length / segments) ** 2) > 1e-3


def without_bending(scene: sc.Scene) -> sc.Scene:
    """The scene with EI = 0; what carried compression still does."""
    flat: dict[str, Any] = {
        "EI": 0.0, "BI": 0.0, "EI2": None, "GJ": None, "coupling": 0.0, "curvature": (0.0, 0.0, 0.0)}
    cable = tuple(replace(s, compression=s.carries_compression, **flat) for s in scene.cable)
    return replace(scene, cable=cable)


class Choice(NamedTuple):
    """What will run, why, and its estimated relative error."""

    model: str
    method: str
    segments: int
    reason: str
    error: float
    adaptive: bool = False  # a hybrid whose domains follow the motion


def estimate(scene: sc.Scene, segments: int, line: str = "lumped") -> float:
    """Estimated relative error of the transverse response: (k h)^2/12 of the excitation's shortest wave on a lumped
    mesh, (k h)^4/120 on Hermite elements (measured: six times their dispersion), 1.5 spans^-2 on splines (measured on
    (3.4), whose jumps of velocity leave order 2); NaN where no harmonic motion says what the shortest wave is."""
    if line == "hermite":
        elements = hermite.build(scene, segments)
        nodes = elements.guards(elements.place(elements.straight))[2]
        return math.nan if math.isinf(nodes) else (2 * math.pi / nodes) ** 4 / 120
    model = lumped.build(scene, segments)
    nodes = model.guards(model.place(model.straight()))[2]
    if line == "transverse":
        return math.nan if math.isinf(nodes) else 1.5 / nodes**2
    return math.nan if math.isinf(nodes) else (2 * math.pi / nodes) ** 2 / 12


def cheapest(scene: sc.Scene, ask: Ask) -> Choice:
    """The cheapest line, method and mesh whose estimated error meets ``ask.accuracy``.

    Raises
    ------
    CannotRepresent
        When the named model lacks a feature of the scene, or a name is unknown.
    """
    model, because = representing(scene, ask) if ask.model == "auto" else (ask.model, "")
    if model not in MODELS:
        raise CannotRepresent(f"no model is called {model!r}; there are {', '.join(MODELS)}")
    method = ALIASES.get(ask.method, ask.method)
    if method not in METHODS and method != "auto":
        raise CannotRepresent(
            f"no method is called {ask.method!r}; there are {', '.join([*METHODS, *ALIASES])}"
        )
    missing = needs(scene, ask) & ~MODELS[model].features
    if missing:
        able = [name for name, line in MODELS.items() if not needs(scene, ask) & ~line.features]
        raise CannotRepresent(
            f"{model} cannot represent {missing.name}; models that can: {', '.join(able) or 'none'}"
        )
    if ask.mass_scaling is not None and "mass_scaling" not in MODELS[model].reads:
        able = [name for name, line in MODELS.items() if "mass_scaling" in line.reads]
        raise CannotRepresent(f"mass_scaling: {model} cannot be slowed; models that can: {', '.join(able)}")
    segments, why = ask.segments, "mesh as asked"
    if segments is None:
        segments = 20 if estimate(scene, 20, model) > 0 else UNGUIDED
        while segments < 640 and estimate(scene, segments, model) > ask.accuracy:
            segments = round(segments * 1.26)
        error = estimate(scene, segments, model)
        why = f"{segments} segments for an estimated error of {error:.2g}"
        if math.isnan(error):
            why = f"{segments} segments: nothing in the scene says how fine they must be"
    if method == "auto":
        method, how = marching(scene, ask, segments, model)
        if can_settle(scene, ask) and not MODELS[model].constrained and F.PERIODIC in MODELS[model].features:
            method, how = "harmonic", "the motion is periodic: its settled response, without the way there"
        why = f"{how}; {why}"
    if ask.mass_scaling is not None:
        why = f"{why}; motions of fewer than {ask.mass_scaling:g} spans per wave everywhere slowed"
    why = f"{because}; {why}" if because else why
    if method == "harmonic":
        reason = settled.why_not(scene, ask.harmonics)
        if MODELS[model].constrained:
            reason = f"{model}: its constraint forces are no displacements that a period could be balanced in"
        elif F.PERIODIC not in MODELS[model].features:
            reason = f"{model}: its tangent leaves out the change of the mean tension, which a balance needs"
        if ask.step is not None:
            reason = "step: a settled response is not marched"
        if reason:
            raise CannotRepresent(f"harmonic: {reason}; methods that can: {', '.join(MARCHES)}")
    if method == "esdirk4" and MODELS[model].constrained:
        raise CannotRepresent(f"esdirk4: {model} has constraints, which it was not made for; take trbdf2 or genalpha")
    if MODELS[model].constrained and ask.rho_space < 1 and ask.duration > 0:
        raise CannotRepresent(
            f"{model}: rho_space = {ask.rho_space:g} damps along s at rest alone; in motion what travels towards end A "
            "would grow by 1/rho_space an element: take rho_space 1, and `rho` to damp in time"
        )
    if not (METHODS[method].adaptive or METHODS[method].own_step) and ask.step is None and ask.duration > 0:
        raise CannotRepresent(f"{method} needs a `step`")
    return Choice(model, method, segments, why, estimate(scene, segments, model))


def representing(scene: sc.Scene, ask: Ask) -> tuple[str, str]:
    """The line for a scene, and why where it is not the lumped one: the least that has what the scene needs.

    Rotations want a rod; so does a clamp whose boundary layer lumped segments would miss. In motion `hybrid` then
    decides by bending and torsion against tension where, before and during the run.
    """
    wanted = needs(scene, ask)
    resting = ask.duration <= 0 and ask.rods is None and not wanted & ~MODELS["rod"].features
    family = "rod" if resting else "hybrid"  # at rest the search for domains costs more than they save
    if wanted & ~MODELS["lumped"].features and not wanted & ~MODELS[family].features:
        return family, f"{family}: rotations matter"
    length = scene.length / (ask.segments or UNGUIDED)
    thin = [x for x in rod.bending_layers(scene) if 0 < x < length]
    if thin and not wanted & ~MODELS[family].features:
        return family, f"{family}: bending decays over {min(thin):.3g} m at a clamp, less than a segment"
    return "lumped", ""


def marching(scene: sc.Scene, ask: Ask, segments: int, model: str = "lumped") -> tuple[str, str]:
    """The time method for a scene, and why."""
    if ask.step is not None:
        return "genalpha", "a fixed step was asked"
    if MODELS[model].constrained:
        return "trbdf2", "implicit: a line with constraints"
    stiff = any(s.BI > 0 for s in scene.cable)  # whose damping would set the step
    if impacts(scene) and F.LARGE_MOTION not in MODELS[model].features and not stiff:
        return "srkn4", "explicit, without loss: impacts ring, and no wave along the line is faster than they"
    if scene.devices or segments <= 160:
        return "dopri5", "explicit: impacts, or a mesh so small that its axial step is cheap"
    return "trbdf2", "implicit: no devices and a fine mesh, whose axial step would be dear"


def can_settle(scene: sc.Scene, ask: Ask) -> bool:
    """Whether `auto` takes harmonic balance: a run of at least one period of a periodic motion whose ramps, if it has
    any, are over before the output begins; no seabed, on which its convergence is erratic."""
    if ask.duration <= 0 or ask.step is not None or scene.seabed or settled.why_not(scene, ask.harmonics):
        return False
    return settled.ramped(scene) <= ask.output_from and settled.period(scene)[0] <= ask.duration * (1 + 1e-9)


def static_state(model: Any) -> tuple[Status, np.ndarray, str]:
    """Equilibrium of a model from the first of its starts that leads there."""
    result = (Status.NO_STATIC, np.zeros(model.ndof), "")
    if has(type(model.pack), "constrained"):
        return statics.balance(model.static_pack, model.starts())
    for q in model.starts():
        result = statics.equilibrium(model.softened(q), q, model.reach, model.static_tolerance)
        if result[0] == Status.OK:
            break
    model.settle(result[1])
    return result


def solve(scene: sc.Scene, ask: Ask) -> Response:
    """Run a scene: model and method chosen or as asked; without `segments`, pilots choose mesh and tolerance too.

    Where `auto` chose harmonic balance and its answer cannot be trusted, the time domain runs instead; where it chose
    `srkn4` and that diverged or left the ledger open, `tsit5` does; `reason` tells.

    Raises
    ------
    CannotRepresent
        Before the run, for a choice that cannot represent the scene. Whatever goes wrong in the run is a Status.
    """
    choice = cheapest(scene, ask)
    going = run if ask.segments or impacts(scene) else piloted
    response = going(scene, ask, choice)
    if choice.method == "harmonic" and ask.method == "auto" and not response.trusted:
        method, how = marching(scene, ask, choice.segments, choice.model)
        reason = f"{how}; harmonic balance gave {response.status.name}: {response.message}"
        choice = choice._replace(method=method, reason=reason)
        response = going(scene, ask, choice)
    if choice.method == "srkn4" and ask.method == "auto" and response.status in (Status.DIVERGED, Status.ENERGY_OPEN):
        reason = f"explicit, with error control; srkn4 gave {response.status.name}: {response.message}"
        response = going(scene, ask, choice._replace(method="tsit5", reason=reason))
    return response


def impacts(scene: sc.Scene) -> bool:
    """Whether devices strike: waveforms then decorrelate within some 0.3 s, and no pilot could say how wrong they are;
    the mesh is chosen by the nodes in the shortest wave."""
    return any(device.kind in ("bnes", "bnes_free") for device in scene.devices)


def ways(scene: sc.Scene, ask: Ask, choice: Choice) -> list[pilot.Way]:
    """The lines and methods among which pilots choose: the ones named, or all that can do what `choice` can."""
    lines = [choice.model]
    if ask.model == "auto" and choice.model == "lumped" and choice.method != "harmonic":
        lines += [name for name in EQUALS if not needs(scene, ask) & ~MODELS[name].features]
    found = []
    for model in lines:
        line, given = MODELS[model], 0.0
        if F.LARGE_MOTION not in line.features and model != choice.model:
            given = range_of(scene, model) if ask.duration > 0 else math.inf  # at rest there is no motion to be small
            if not given <= 0.5 * ask.accuracy:
                continue
        free = ask.method == "auto" and ask.step is None and choice.method != "harmonic"
        names = [name for name in line.marched if can_march(model, name)] if free else [choice.method]
        for name in names if ask.duration > 0 else names[:1]:
            method = METHODS[name]
            if ask.duration <= 0:
                knob, tune = math.nan, False
            elif method.own_step and ask.step is None:
                knob, tune = 1.0, False  # share of the mesh's step
            elif method.adaptive:
                loose = (STABLE if name in RUNGE_KUTTA else LOOSE) * method.tolerance
                knob, tune = (ask.tolerance, False) if ask.tolerance else (loose, True)
            else:
                knob, tune = float(ask.step or 0.0), False
            found.append(pilot.Way(
                model, name, line.order, line.price, knob, 10.0 if method.adaptive else 2.0, tune, given, method.order,
                least_steps=pilot.free if name not in RUNGE_KUTTA else partial(least_steps, scene, ask, model),
            ))  # fmt: skip
    return found


def range_of(scene: sc.Scene, model: str) -> float:
    """Estimated relative error of a small-motion line in the scene's motion; infinite where it cannot be built."""
    try:
        return float(MODELS[model].build(scene, FIRST).range_error())
    except CannotRepresent:
        return math.inf


def can_march(model: str, method: str) -> bool:
    """Whether a time method can march a line: constraints want `trbdf2` or `genalpha`."""
    return method in ("trbdf2", "genalpha") or not MODELS[model].constrained


def least_steps(scene: sc.Scene, ask: Ask, model: str, segments: int) -> float:
    """Steps that the stability of an explicit method asks for over the run."""
    built = MODELS[model].made(scene, segments, ask)
    return ask.duration * built.fastest(built.starts()[-1])["decay"] / REACH


def piloted(scene: sc.Scene, ask: Ask, choice: Choice) -> Response:
    """Run a scene on the mesh and at the tolerance that pilots find for `ask.accuracy`, by their cheapest way."""

    def attempt(way: pilot.Way, segments: int, knob: float) -> Response:
        asked = replace(ask, segments=segments)
        if math.isfinite(knob):
            method = METHODS[way.method]
            if method.own_step and ask.step is None:
                step = attempt(way, segments, 1.0).step * knob if knob < 1 else math.nan
                asked = replace(asked, step=step if step > 0 else None)
            else:
                asked = replace(asked, tolerance=knob) if method.adaptive else replace(asked, step=knob)
        plan = choice._replace(model=way.model, method=way.method, segments=segments, error=math.nan)
        return run(scene, asked, plan, False)

    first = min(FIRST, max(pilot.LEAST, choice.segments // 2))
    found = pilot.refine(attempt, ways(scene, ask, choice), ask.accuracy, first)
    response = found.response
    if found.chaotic:
        asked = choice._replace(model=found.way.model, method=found.way.method)
        response = run(scene, replace(ask, segments=choice.segments), asked, False)
        note = "chaotic: waveforms do not converge, only statistics mean something"
        message = f"{note}; {response.message}".rstrip("; ")
        return replace(response, message=message, estimated_error=math.nan, chaotic=True)
    error = max(found.error, response.estimated_error)  # the second is what kinematics, joints and series leave out
    because = "".join(f"{why}; " for why in (representing(scene, ask)[1] if ask.model == "auto" else "",) if why)
    share = found.work / max(1.0, pilot.work(found.way, response))
    reason = (
        f"{because}{found.way.model} by {found.way.method} on {found.segments} segments for an estimated error of "
        f"{found.error:.2g} ({found.late:.1g} in time), by {found.runs} pilots of {share:.1f} times its work"
    )
    response = replace(response, reason=reason, estimated_error=error)
    if response.status == Status.OK and error > ask.accuracy:
        status = Status.COARSE_STEP if found.late > ask.accuracy else Status.UNRESOLVED
        why = f"estimated error {error:.2g}, above `accuracy` {ask.accuracy:g}"
        response = replace(response, status=status, message=f"{why}; {REMEDY[status]}")
    return response


def run(scene: sc.Scene, ask: Ask, choice: Choice, check: bool = True) -> Response:
    """Run a scene by the model, method and mesh chosen; `check` the error in time (pilots compare runs themselves)."""
    family = MODELS[choice.model].constrained  # its catenaries leave bending out by themselves, its rods keep it
    if needs(scene) & F.BENDING and not family and not bending_matters(scene, choice.segments):
        scene = without_bending(scene)
        choice = choice._replace(reason=f"{choice.reason}; bending left out: it cannot show at this resolution")
    periodic = choice.method == "harmonic" and ask.duration > 0
    line = MODELS[choice.model]
    model = line.made(settled.steady(scene) if periodic else scene, choice.segments, ask)
    missing = [v for v in METHODS[choice.method].verbs if not has(type(model.pack), v)]
    if missing:
        raise CannotRepresent(
            f"{choice.method} needs the verbs {', '.join(missing)}, which {choice.model} lacks"
        )
    small = model.range_error() if ask.duration > 0 else 0.0
    _in_range(choice.model, small, "that of the ends", ask)
    choice = choice._replace(error=float(np.fmax(choice.error, small or math.nan)))
    common: dict[str, Any] = {
        "model": choice.model, "method": choice.method, "segments": choice.segments, "reason": choice.reason,
        "estimated_error": choice.error, "tolerance": tolerance_of(choice.method, ask),
    }  # fmt: skip
    choice = choice._replace(adaptive=choice.model == "hybrid" and ask.rods is None)
    if scene.start.kind == "given":
        status, note = Status.OK, "given"
        q, v = model.given()
        static = q
    else:
        if periodic:
            settled.at_home(model)
        if choice.adaptive:
            status, model, static, note = adaptive.at_rest(model, ask)
        else:
            status, static, note = static_state(model)
        q, v = static.copy(), np.zeros_like(static)
    if status != Status.OK:
        return Response(status=status, message=f"{note}; {REMEDY[status]}", **common)
    _in_range(choice.model, model.drift_error(static), "the drift in the current", ask)
    # small-motion lines swing about a state that they take as it is
    asked = F.LARGE_MOTION in line.features and scene.start.kind != "given" and not periodic and not ask.perturbation
    falls = leaving(model, static) if asked else ""
    joints = adaptive.NOTHING_LEFT_OUT
    if line.constrained and scene.start.kind != "given":
        joints = adaptive.joint_error(model, static, np.zeros(model.ndof), np.zeros(model.ndof), held=True)
    if periodic:
        return settle(model, ask, static, common)
    if ask.perturbation > 0:
        shake = ask.perturbation * np.random.default_rng(ask.seed).standard_normal(len(v))
        if line.constrained:  # of the nodes; frames and forces follow
            moved = model.pack.r[:, None] + np.arange(3)
            v[moved] += shake[moved]
            model.spin_along(q, v)
        else:
            v += shake

    response = march(model, ask, choice, static, q, v, common, joints)
    if falls and response.status == Status.OK:
        return replace(response, status=Status.UNSTABLE, message=f"{falls}; {REMEDY[Status.UNSTABLE]}")
    if not check:
        return response
    own = own_step(model, ask, model.fastest(static)) if METHODS[choice.method].own_step else 0.0
    steps = response.cost.steps
    controlled = steps * longest_step(model, ask, choice.method) > CAPPED * ask.duration
    small = response.tolerance * steps <= SURE * ask.accuracy  # the sum of the local errors
    trials = trials_of(ask, choice.method, model.n_gaps, own, controlled and small)
    return checked(response, ask, lambda other: march(model, other, choice, static, q, v, dict(common), joints), trials)


def leaving(model: Any, static: np.ndarray) -> str:
    """In words, that a static state is unstable; empty where it is not."""
    fastest, n = model.fastest(static), max(model.segments, 1)
    lowest = max(fastest["tension"] * math.pi / (2 * n), fastest["bending"] * (math.pi / (2 * n)) ** 2)
    rate = statics.growth(model.static_pack, static, lowest or 1e-3 * fastest["axial"] * math.pi / (2 * n))
    return f"unstable equilibrium: a small disturbance grows e-fold in {1 / rate:.3g} s" if rate > 0 else ""


def trials_of(ask: Ask, name: str, n_gaps: int, own: float = 0.0, small: bool = True) -> list[tuple[Ask, float]]:
    """Runs that tell the error in time of a run, each with the share of `accuracy` up to which its word is enough.

    None where that error is known to be small: at a step up to the mesh's `own`; at a tolerance up to the default of
    an explicit method with error control, whose steps are those of stability, and of an implicit one where local errors
    were controlled and add up to a `small` sum. After impacts only statistics are promised. The last run is finer. One
    before it is coarser and cheap, but cannot see what takes finer steps to be seen; up to `checked_tolerance` pilots
    have seen to that.
    """
    most = 10 * ask.max_steps
    if METHODS[name].adaptive:
        used, explicit = tolerance_of(name, ask), name in RUNGE_KUTTA
        known = explicit or (small and n_gaps == 0)
        if known and used <= METHODS[name].tolerance * (1 + 1e-9):
            return []
        finer = (replace(ask, tolerance=used / 10, max_steps=most), SURE)
        if n_gaps > 0 or explicit or 10 * used >= 1:
            return [finer]
        vouched = used <= (ask.checked_tolerance or 0.0) * (1 + 1e-9)
        return [(replace(ask, tolerance=10 * used), 1.0 if vouched else SURER), finer]
    if ask.step is None or ask.step <= own:
        return []
    finer = (replace(ask, step=ask.step / 2, max_steps=most), SURE)
    if n_gaps > 0:  # a longer step may miss the same impacts
        return [finer]
    return [(replace(ask, step=2 * ask.step), SURE), finer]


def motionless(run: Response) -> bool:
    """Whether nodes move by rounding alone (a straight rod that is twisted); a start that is damped away has moved."""
    away = np.abs(run.signals["position"] - run.signals["static_position"]).max()
    path = np.abs(run.signals["velocity"]).max() * (run.t[-1] - run.t[0])
    return bool(max(away, path) <= pilot.STILL * np.abs(run.signals["position"]).max())


def apart(one: Response, other: Response) -> float:
    """Relative root mean square difference of the displacement over all nodes and times; inf where a run stopped."""
    if len(one.t) != len(other.t) or one.signals["position"].shape != other.signals["position"].shape:
        return math.inf
    x, y = (run.signals["position"] - run.signals["static_position"] for run in (one, other))
    size = float(np.sqrt((y**2).mean()))
    gap = float(np.sqrt(((x - y) ** 2).mean()))
    return gap / size if size > 0 else (0.0 if gap == 0 else math.inf)


def checked(
    response: Response, ask: Ask, again: Callable[[Ask], Response], trials: list[tuple[Ask, float]]
) -> Response:
    """A run with its error in time measured, where nothing else says whether its step or tolerance was fine enough.

    Against a coarser run, whose error is taken to be as many times as large as the square of the steps that it saves
    says (no more is left of any order where a force has a kink); where that fails, saves too few, or is too far off to
    tell, one at half the step, or a tenth of the tolerance, decides: a quarter of its error is left at most. Seconds
    are in `cost.checking`.
    """
    if response.status != Status.OK or len(response.t) < 2 or not trials or motionless(response):
        return response
    begun, error = time.perf_counter(), math.inf
    for asked, enough in trials:
        other, share = again(asked), 4 / 3
        if asked is not trials[-1][0]:
            saved = other.cost.steps / response.cost.steps
            if not saved <= FEWER:
                continue
            share = saved**2 / (1 - saved**2)
        found = apart(other, response) * share
        error = found if math.isfinite(found) else error
        if error <= enough * ask.accuracy:
            break
    cost = response.cost._replace(checking=time.perf_counter() - begun)
    response = replace(response, cost=cost)
    if math.isfinite(error):
        response = replace(response, estimated_error=float(np.nanmax([response.estimated_error, error])))
    if error <= ask.accuracy:
        return response
    why = f"a finer run has another waveform: estimated error {error:.2g}; `accuracy` is {ask.accuracy:g}"
    if math.isinf(error):
        why = "neither a coarser nor a finer run came to its end, so that nothing tells the error"
    return replace(response, status=Status.COARSE_STEP, message=f"{why}; {REMEDY[Status.COARSE_STEP]}")


def tolerance_of(name: str, ask: Ask) -> float:
    """The tolerance that a method uses; NaN of a fixed step."""
    method = METHODS.get(name)
    if method is None or not method.adaptive:
        return math.nan
    return ask.tolerance or method.tolerance


def _in_range(model: str, error: float, what: str, ask: Ask) -> None:
    """Raises CannotRepresent where a small-motion line would have to move too far."""
    if not error <= ask.accuracy:
        raise CannotRepresent(_too_far(model, error, what, ask))


def _too_far(model: str, error: float, what: str, ask: Ask) -> str:
    able = ", ".join(name for name, line in MODELS.items() if F.LARGE_MOTION in line.features)
    return (
        f"{model} is for small motion: {what} makes an estimated error of {error:.2g} of the "
        f"{MODELS[model].measured}, above `accuracy` {ask.accuracy:g}; models that can: {able}"
    )


def output_grid(ask: Ask) -> np.ndarray:
    """Times of the output [s]."""
    grid = np.arange(int(ask.duration / ask.interval + 1e-9) + 1) * ask.interval
    return np.minimum(grid[grid >= ask.output_from * (1 - 1e-12)], ask.duration)  # the product may round above it


_COMPILED: set[tuple[type, tuple[float, ...]]] = set()  # kinds of line that harmonic balance has served in this process


def settle(model: Any, ask: Ask, static: np.ndarray, common: dict[str, Any]) -> Response:
    """The settled response to periodic motion, by harmonic balance, shown on the output grid."""
    pack, omega = model.pack, 2 * math.pi / settled.period(model.scene)[0]
    tolerance = tolerance_of("harmonic", ask)
    if (kind := (type(pack), pack.axes)) not in _COMPILED:  # seconds are those of the method, compilation excluded
        _COMPILED.add(kind)
        settle(model, ask, static, dict(common))
    begun = time.perf_counter()
    orbit = settled.respond(pack, omega, static, tolerance, ask.harmonics)
    work = orbit.work
    if orbit.status not in (Status.OK, Status.FEW_HARMONICS):
        cost = Cost(work.iterations, 0, work.evaluations, work.factorisations, time.perf_counter() - begun)
        q, v, force = settled.states(pack, orbit, harmonic.series(1, 64).phase)
        slack = "the line is slack in the last iterate; " if model.slack(model.observe(q, v, force, static)) else ""
        message = f"{orbit.message}; {slack}run the time domain (`method: explicit`)"
        return Response(status=orbit.status, message=message, cost=cost, **common)
    known = floquet.stability(pack, orbit)
    t = output_grid(ask)
    shown = settled.show(pack, orbit, t, 0.5 * float(pack.weight.sum()) * FLOOR_SPEED**2)
    cost = Cost(work.iterations, 0, work.evaluations, work.factorisations, time.perf_counter() - begun)
    guard, note, nodes = model.guards(static)
    status, message = verdict(shown.residual, guard, note)
    signals = model.observe(shown.q, shown.v, shown.force, static)
    valid, why = model.validity(signals)
    if valid != Status.OK:
        status, message = valid, why
    if status == Status.OK and not known.stable:
        status = Status.UNSTABLE
        message = f"Floquet multiplier of size {known.largest:.4g} ({known.kind})"
    if orbit.status != Status.OK:
        status, message = orbit.status, orbit.message
        if model.slack(signals):
            message = f"the line goes slack, where harmonics fall off as 1/h^2 only: {message}"
    if status != Status.OK:
        message = f"{message}; {REMEDY[status]}" if message else REMEDY[status]
    zero = _static_energy(model, static)
    signals |= {what: shown.ledger[:, k] - zero.get(what, 0.0) for k, what in enumerate(LEDGER)}
    common["estimated_error"] = float(np.nanmax([common["estimated_error"], orbit.tail]))
    return Response(
        status=status, message=message, t=t, signals=signals, energy_residual=shown.residual, nodes_per_wave=nodes,
        cost=cost, harmonics=orbit.harmonics, multiplier=known.largest, **common,
    )  # fmt: skip


RUNGE_KUTTA = {"dopri5": explicit.DOPRI5, "tsit5": explicit.TSIT5, "rk4": explicit.RK4, "rk2": explicit.RK2}


class Limits(NamedTuple):
    """Steps and tolerances of a march."""

    first: float  # first step, or the fixed one [s]
    tolerance: float  # 0 for a fixed step
    most: float  # largest and smallest step [s]
    least: float
    taut: np.ndarray  # (n_gaps,) largest step while each cord is taut [s]
    floor: float  # kinetic energy of a speed that does not matter [J]


def limits_of(model: Any, ask: Ask, name: str, fastest: dict[str, float]) -> Limits:
    """First, largest and smallest step and tolerance of a method on a model."""
    method, floor = METHODS[name], 0.5 * float(model.pack.weight.sum()) * FLOOR_SPEED**2
    taut = np.full(model.n_gaps, math.inf)
    if method.own_step or (method.adaptive and name in RUNGE_KUTTA):
        damped = method.own_step  # without error control a damper must be resolved too
        known = fastest["struck" if damped and "struck" in fastest else "device"]
        rates = model.impacts(damped) if hasattr(model, "impacts") else np.full(model.n_gaps, known)
        np.divide(SWING_TAUT if damped else TAUT, rates, out=taut, where=rates > 0)
    if method.own_step:
        own = own_step(model, ask, fastest)
        step = ask.step or own
        return Limits(step, 0.0, 1.0, 0.0, taut * min(1.0, step / own), floor)
    if not method.adaptive:
        return Limits(float(ask.step or 0.0), 0.0, 1.0, 0.0, taut, floor)
    tolerance = tolerance_of(name, ask)
    most = longest_step(model, ask, name)
    quick = max(fastest["axial"], fastest["bending"], fastest["tension"])
    first = 1 / quick if quick > 0 else most
    if name in RUNGE_KUTTA:
        stable = REACH / fastest["decay"] if fastest["decay"] > 0 else math.inf
        if model.n_gaps > 0:  # impacts ring in the highest transverse modes, which a long step would damp
            ringing = max(fastest["bending"], fastest["tension"])
            most = min(most, ring_of(name) / ringing if ringing > 0 else most)
        return Limits(min(first, most), tolerance, min(most, stable), LEAST_STEP, taut, floor)
    return Limits(min(first, 1e-3 * most), tolerance, most, LEAST_STEP, taut, floor)


def longest_step(model: Any, ask: Ask, name: str) -> float:
    """A twentieth of the shortest period of the motion, a fiftieth of the run [s]; with error control at another
    tolerance than the default as much more or less as that lets steps be, so that a finer run is one everywhere."""
    usual = min(ask.duration / 50, 2 * math.pi / model.omega / 20 if model.omega > 0 else math.inf)
    method = METHODS[name]
    looser = tolerance_of(name, ask) / method.tolerance if method.adaptive else 1.0
    return float(usual * looser ** (1 / (1 + method.order)))


def own_step(model: Any, ask: Ask, fastest: dict[str, float]) -> float:
    """The step of `srkn4` on a mesh [s]: the fastest mode keeps its energy to 2e-4, and the damping that `decay` counts
    is stable (of lumped masses and Hermite elements BA, not BI; drag nowhere)."""
    rates = {SWING: max(fastest["axial"], fastest["bending"], fastest["tension"]), SWING_REACH: fastest["decay"]}
    return min([longest_step(model, ask, "srkn4"), *(share / rate for share, rate in rates.items() if rate > 0)])


def ring_of(name: str) -> float:
    """Largest step times the highest transverse frequency where devices ring it: as much of the ringing is lost in a
    second, to leading order with the step's fifth power, as by `dopri5` at RING. (`tsit5` gains from 0.48 on: at its
    limit, 0.51, some 2e-7 of the energy a step, a fifth of what `dopri5` loses at its own.)"""
    table = RUNGE_KUTTA[name]
    if table.order != 5:
        return RING
    return float(RING * (explicit.ring_loss(explicit.DOPRI5) / explicit.ring_loss(table)) ** 0.2)


class March(NamedTuple):
    """A march from a state over some pieces of time."""

    code: Status
    out: Any  # methods.march.Output
    ends: Any  # methods.march.Ends; row 0 is the last state
    seconds: float
    work: Any = None  # methods.implicit.Work, from which a march of the same model may go on


def marched(
    model: Any, ask: Ask, name: str, limits: Limits, q: np.ndarray, v: np.ndarray, pieces: np.ndarray, grid: np.ndarray,
    before: March | None = None,
) -> March:  # fmt: skip
    """March a model by the method `name` from (q, v) over `pieces`, with output on `grid`; or, by an implicit method,
    on from where its march `before` came to its end."""
    pack = model.pack
    out = make_output(grid, model.ndof, len(pack.fixed))
    if before is None:
        s, newton = make_ends(model.ndof), implicit.make_work(model.ndof, pack.bw)
        s.q[0], s.v[0] = q, v
    else:
        s, newton = before.ends, before.work

    def go(pieces: np.ndarray) -> int:
        if name == "srkn4":
            stages = nystrom.make_work(model.ndof, model.n_gaps)
            more = (nystrom.TABLE, limits.first, limits.taut, ask.max_steps)
            return int(nystrom.march(pack, s, out, stages, pieces, *more))
        if name in RUNGE_KUTTA:
            table = RUNGE_KUTTA[name]
            work = explicit.make_work(table, model.ndof, model.n_gaps)
            return int(explicit.march(pack, s, out, work, pieces, table, *limits, ask.max_steps))
        steps = (limits.first, limits.tolerance, limits.most, limits.least, limits.floor)
        if name == "esdirk4":
            implicit_stages = esdirk.make_work(model.ndof, pack.bw)
            return int(esdirk.march(pack, s, out, implicit_stages, esdirk.TABLE, pieces, *steps, ask.max_steps))
        if name == "trbdf2":
            return int(implicit.tr_bdf2(pack, s, out, newton, pieces, *steps, ask.max_steps))
        first, floor = limits.first, limits.floor
        return int(implicit.generalised_alpha(pack, s, out, newton, pieces, first, ask.rho, floor, ask.max_steps))

    if before is None:
        go(pieces[:1])  # compiles, or loads from the disk cache, and marches nothing: seconds are those of the march
        newton.go[:] = 0.0
    begun = time.perf_counter()
    code = Status(go(pieces))
    return March(code, out, s, time.perf_counter() - begun, newton)


def _cost(counts: np.ndarray, seconds: float) -> Cost:
    steps, rejected, evaluations, factors = (
        int(counts[k]) for k in (C_STEPS, C_REJECTED, C_EVALUATIONS, C_FACTORS)
    )
    return Cost(steps, rejected, evaluations, factors, seconds)


def march(
    model: Any, ask: Ask, choice: Choice, static: np.ndarray, q: np.ndarray, v: np.ndarray, common: dict[str, Any],
    joints: adaptive.Estimate = adaptive.NOTHING_LEFT_OUT,
) -> Response:  # fmt: skip
    """From the start to a Response; `joints` is what the static state's catenary domains leave out."""
    pack, name = model.pack, choice.method
    if ask.duration <= 0:
        return _at_rest(model, static, common, ask, joints)
    fastest = model.fastest(static)
    limits = limits_of(model, ask, name, fastest)
    if not METHODS[name].adaptive:
        common["step"] = limits.first
    grid = output_grid(ask)
    pieces = np.array([0.0, *(x for x in model.breaks if 0 < x < ask.duration), ask.duration])
    guard, note, nodes = model.guards(static)
    matters = max(model.omega, fastest["device"])
    if choice.adaptive:
        rest = model._nodal(static, pack.r)

        def one(
            model: Any, left: int, q: np.ndarray, v: np.ndarray, pieces: np.ndarray, grid: np.ndarray,
            before: March | None, first: float,
        ) -> March:  # fmt: skip
            if left == 0:
                pieces = pieces[:1]  # nothing more may be done
            own = limits._replace(first=first) if first > 0 else limits
            asked = replace(ask, max_steps=max(left, 1))
            done = marched(model, asked, name, own, q, v, pieces, grid, before)
            return done._replace(code=Status.TOO_MANY_STEPS) if left == 0 else done

        run = adaptive.follow(model, ask, q, v, rest, grid, one, limits.floor)
        code, done, residual, ledger = run.status, run.done, run.residual, run.ledger
        cost, steps = _cost(run.counts, run.seconds), run.steps
        signals = adaptive.joined(run.signals)
        lost = code == Status.ZERO_TENSION
        when = f"at t = {grid[done - 1]:.6g} s" if done else f"before t = {grid[0]:.6g} s"
        valid, why = (code, f"a catenary domain lost its tension {when}") if lost else (Status.OK, "")
        joints = adaptive.worse(joints, run.error)
        common["reason"] = f"{common['reason']}; {run.share:.0%} rod on average, {run.changes} changes of domains"
        zero = _static_energy(model, static)
    else:
        code, out, s, seconds, _ = marched(model, ask, name, limits, q, v, pieces, grid)
        cost, done, ledger = _cost(out.counts, seconds), int(out.at[0]), out.ledger
        steps = cost.steps
        residual = float(s.peak[2]) / max(float(s.peak[0]), float(s.peak[1]), limits.floor)
        signals = model.observe(out.q[:done], out.v[:done], out.f[:done], static)
        valid, why = model.validity(signals)
        if valid == Status.OK and hasattr(model, "run_error"):
            strayed = model.run_error(grid[:done], signals)
            common["estimated_error"] = float(np.fmax(common["estimated_error"], strayed))
            if not strayed <= ask.accuracy and residual <= ENERGY_TOLERANCE:  # else it is the march that strays
                valid, why = Status.CANNOT_REPRESENT, _too_far(choice.model, strayed, "the run", ask)
        zero = _static_energy(model, static)
        if MODELS[choice.model].constrained and code != Status.OK:
            valid, why = model.stopped(s.q[0])
        elif MODELS[choice.model].constrained:
            joints = adaptive.worse(joints, adaptive.joint_error(model, s.q[0], s.v[0], s.a[0]))
    per_period = 2 * math.pi * steps / (matters * ask.duration) if matters > 0 else math.inf
    if code == Status.OK and done == len(grid):
        status, message = verdict(residual, guard, note)
        if MODELS[choice.model].constrained and status in (Status.OK, Status.ENERGY_OPEN):
            tight, why = model.resolved(signals, message)  # a run may bend more than its start, and its ledger open
            status, message = (tight, why) if tight != Status.OK else (status, message)
    else:
        status = Status.DIVERGED if code == Status.OK else code
        message = f"stopped at t = {grid[done - 1]:.6g} s" if done else f"stopped before t = {grid[0]:.6g} s"
        message = f"{message}; {note}" if guard != Status.OK else message
    if status == Status.OK and ask.mass_scaling is not None:
        status, slow = model.scaling_harm(out.v)
        message = slow or message
    if status != Status.OK:
        message = f"{message}; {REMEDY[status]}" if message else REMEDY[status]
    if valid != Status.OK:
        status, message = valid, f"{why}; {REMEDY[valid]}"
    elif status == Status.OK:
        status, message = _enough_rod(joints, ask, message)
        message = f"{message}; {REMEDY[status]}" if status != Status.OK else message
    common["estimated_error"] = float(np.nanmax([common["estimated_error"], joints.worst]))
    signals |= {what: ledger[:done, k] - zero.get(what, 0.0) for k, what in enumerate(LEDGER)}
    return Response(
        status=status, message=message, t=grid[:done], signals=signals, energy_residual=residual, nodes_per_wave=nodes,
        steps_per_period=per_period, cost=cost, **common,
    )  # fmt: skip


def _enough_rod(joints: adaptive.Estimate, ask: Ask, message: str) -> tuple[Status, str]:
    """ROD_NEEDED where the catenary domains cost more than the accuracy asked."""
    if joints.worst <= ask.accuracy:
        return Status.OK, message
    parts = ", ".join(f"{x:.2g} of the {what}" for what, x in joints._asdict().items())
    why = f"bending left out in catenary domains: estimated error {parts}; `accuracy` is {ask.accuracy:g}"
    return Status.ROD_NEEDED, why


def verdict(residual: float, guard: Status, note: str) -> tuple[Status, str]:
    """Status and sentence of a run that came to its end: ledger, then mesh."""
    if not residual <= ENERGY_TOLERANCE:
        return Status.ENERGY_OPEN, f"energy residual {residual:.2e} of the peak energy"
    if guard != Status.OK:
        return guard, note
    return Status.OK, note


def _static_energy(model: Any, static: np.ndarray) -> dict[str, float]:
    e, zero = np.zeros(N_ENERGIES), np.zeros(len(static))
    call_energies(0.0, static, zero, zero, model.pack, e)
    return {"strain": float(e[STRAIN]), "gravity": float(e[GRAVITY])}


def _still(model: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return q[None], np.zeros((1, model.ndof)), np.zeros((1, len(model.pack.fixed))), q


def _at_rest(
    model: Any, static: np.ndarray, common: dict[str, Any], ask: Ask, joints: adaptive.Estimate
) -> Response:
    """The static state alone, as a Response with one sample."""
    guard, note, nodes = model.guards(static)
    if guard == Status.OK:
        guard, why = model.validity({"tension": model.observe(*_still(model, static))["tension"]})
        guard, note = (guard, why) if guard != Status.OK else _enough_rod(joints, ask, note)
    common["estimated_error"] = float(np.nanmax([common["estimated_error"], joints.worst]))
    zero, r = np.zeros(len(static)), np.zeros(len(static))
    call_residual(0.0, static, zero, zero, model.pack, r)
    nothing = dict.fromkeys(LEDGER, np.zeros(1))  # at rest nothing moves, and nothing is lost
    signals = nothing | model.observe(static[None], zero[None], r[model.pack.fixed][None], static)
    message = f"{note}; {REMEDY[guard]}" if guard != Status.OK else note
    return Response(
        status=guard, message=message, t=np.zeros(1), signals=signals, energy_residual=0.0, nodes_per_wave=nodes,
        **common,
    )  # fmt: skip


def warm_up() -> None:
    """Compile, or load from the disk cache, the kernels that a planar study needs."""
    cable = sc.Section(length=10.0, d=0.1, mass=10.0, EA=1e6, EI=1e3, BA=10.0)
    scene = sc.Scene(
        cable=(cable,), water=sc.Water(), end_a=sc.End(kind="clamped", position=(0, 0, -10.01), direction=(0, 0, 1)),
        end_b=sc.End(kind="clamped", position=(0, 0, 0), direction=(0, 0, 1), motion=sc.Motion(
            harmonics=(sc.Harmonic(amplitude=(0.01, 0, 0), frequency=1.0),))),
        devices=(sc.BNES(s=5.0, mass=1.0, EA=1e5, rod="cords"),),
    )  # fmt: skip
    solve(scene, Ask(duration=0.01, segments=12, method="dopri5"))
