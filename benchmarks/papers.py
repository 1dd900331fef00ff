"""The numbers of docs/papers.md: what the four papers' claims come to on this code.

    python benchmarks/papers.py [NAME ...]      compute and print these numbers (all quick ones by default)
    python benchmarks/papers.py --list          what there is, and which are dear
    python docs/papers.py --dear [NAME ...]     the same, kept in docs/papers_numbers.json, and the report made anew

Each function below is one group of numbers, named as in the report; it takes no arguments and returns a dictionary of
floats. Where cords strike they are ensembles of at most `MEMBERS` runs from initial velocities that differ by
1e-6 m/s: `x` is the mean and `x_sd` the standard deviation of one run. Dear groups take some minutes each.
"""

# ruff: noqa: E402 (threads are set before numpy is imported)

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solvers import TMD, Ask, CubicNES, Response, Scene, Status, solve
from solvers.devices import CORDS, SPRINGS, law_energy, law_force
from sweep.config import load_study
from sweep.evaluate import run_trusted
from sweep.metrics import Summary, compute, summarise, transverse
from sweep.space import baseline_scene, design_scene

ROOT = Path(__file__).parents[1]
CONFIGS = ROOT / "configs"
MEMBERS = 8
PERTURBATION = 1e-6  # m/s, of the initial velocities
BASELINES = ("uniform", "locked", "rod_locked", "plain")
KEPT = ("t_settle", "energy_share_device", "stroke", "jumps", "peak_tension_top")
Values = dict[str, float]


class Group(NamedTuple):
    """A named group of numbers."""

    make: Callable[[], Values]
    dear: bool


GROUPS: dict[str, Group] = {}


def group(dear: bool = False) -> Callable[[Callable[[], Values]], Callable[[], Values]]:
    """Enter the decorated function into GROUPS under its own name."""

    def enter(function: Callable[[], Values]) -> Callable[[], Values]:
        GROUPS[function.__name__] = Group(function, dear)
        return function

    return enter


# --------------------------------------------------------------------------- scenes of paper 003


@cache
def study(name: str) -> Any:
    return load_study(CONFIGS / f"{name}.yaml")


def at_points(scene: Scene) -> Scene:
    """The same devices without their rods."""
    return replace(scene, devices=tuple(replace(device, rod=None) for device in scene.devices))


def tuned(scene: Scene, frequency: float, damping: float) -> Scene:
    """Linear dampers of the same masses at the same points, all of one frequency [Hz] and damping ratio."""
    omega = 2 * math.pi * frequency
    return replace(
        scene,
        devices=tuple(
            TMD(s=d.s, mass=d.mass, k=d.mass * omega**2, c=2 * damping * d.mass * omega) for d in scene.devices
        ),
    )


def sinks() -> dict[str, Scene]:
    """Every device arrangement that is compared, on the clean cable under the pulse (3.4)."""
    rods = study("bnes_optimum").scene
    cubic = study("nes_plain").scene
    springs = replace(rods, devices=tuple(replace(d, law="springs") for d in rods.devices))
    bare = baseline_scene(rods, "plain")
    masses = {"locked": baseline_scene(rods, "locked"), "rod_locked": baseline_scene(rods, "rod_locked")}
    same_cords = tuple(
        CubicNES(s=d.s, mass=d.mass, EA=d.EA, BA=d.BA, length=d.length, rod=1.0) for d in rods.devices
    )
    return masses | {
        "uniform": baseline_scene(rods, "uniform"),
        "plain": bare,
        "bnes_rods": rods,
        "bnes_points": at_points(rods),
        "springs_rods": springs,
        "cubic_rods": cubic,
        "cubic_points": at_points(cubic),
        "cubic_stiff_rods": replace(rods, devices=same_cords),
    }


# --------------------------------------------------------------------------- running


def settings() -> Any:
    return replace(study("bnes_optimum").settings, repeats=0, objectives=())


def ask_of(model: str, segments: int, **more: Any) -> Ask:
    return replace(study("bnes_optimum").ask, model=model, segments=segments, accuracy=0.9, **more)


def run(scene: Scene, ask: Ask) -> Response:
    """One run; one whose energy stays open at a tenth of the tolerance is tried at 1e-6."""
    found = run_trusted(scene, ask).response
    if found.status == Status.ENERGY_OPEN:
        found = run_trusted(scene, replace(ask, tolerance=1e-6)).response
    return found


def members(scene: Scene, ask: Ask, n: int) -> Iterable[Response]:
    for seed in range(1, n + 1):
        yield run(scene, replace(ask, perturbation=PERTURBATION, seed=seed))


def summary_of(response: Response, scene: Scene) -> Summary | None:
    return summarise(response, scene, settings(), study("bnes_optimum").scene.cable)


def statistics(prefix: str, rows: list[Values]) -> Values:
    """Mean and standard deviation of each number over the runs in which it is finite."""
    found: Values = {f"{prefix}_n": float(len(rows))}
    for name in rows[0] if rows else ():
        values = np.array([row[name] for row in rows])
        good = values[np.isfinite(values)]
        found[f"{prefix}_{name}"] = float(good.mean()) if good.size else math.inf
        found[f"{prefix}_{name}_sd"] = float(good.std(ddof=1)) if good.size > 1 else 0.0
    return found


def count(scene: Scene, most: int) -> int:
    """Members of an ensemble: all where cords strike, two where a smooth law hardly spreads, one of what is linear."""
    if any(device.kind == "bnes" and device.law == "cords" for device in scene.devices):
        return most
    return 2 if any(device.kind in ("bnes", "nes") for device in scene.devices) else 1


def compared(model: str, segments: int, names: Iterable[str], scenes: dict[str, Scene], n: int = MEMBERS) -> Values:
    """Metrics of arrangements against the four baselines, and the share of high modes, on one line and mesh."""
    ask = ask_of(model, segments)
    window = (0.5, 5.0)
    bases = {name: summary_of(run(scenes[name], ask), scenes[name]) for name in BASELINES}
    found: Values = {}
    for name in names:
        scene = scenes[name]
        many = count(scene, n)
        runs = members(scene, ask, many) if many > 1 else [run(scene, ask)]
        rows, bad = [], 0
        for response in runs:
            if response.status not in (Status.OK, Status.UNRESOLVED):
                bad += 1
                continue
            curves = summary_of(response, scene)
            row: Values = {}
            for base in BASELINES:
                metrics = compute(curves, bases[base], len(scene.devices))
                row |= {f"{m}_{base}": metrics[m] for m in ("delta", "gamma")}
                if base in ("uniform", "locked"):
                    row[f"rms_reduction_{base}"] = metrics["rms_reduction"]
                    row[f"rms_probe_reduction_{base}"] = metrics["rms_probe_reduction"]
            row |= {m: metrics[m] for m in KEPT}
            row |= high_share(response, window)
            rows.append(row)
        found |= statistics(name, rows) | {f"{name}_untrusted": float(bad)}
        print(f"  {model} {segments} {name}", file=sys.stderr, flush=True)
    return found


# --------------------------------------------------------------------------- energy over the cable's modes


@cache
def modes(points: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and shapes at arc lengths of the plain study cable's transverse modes, clamped, in still water.

    Hermite elements of a beam under the mean static tension, with structural and added mass; shapes have an integral
    of squares over the cable of 1.

    Returns
    -------
    (n,), (n, len(points))
    """
    scene = study("bnes_optimum").scene
    section, L, pull, elements = scene.cable[0], scene.length, 500.0, 240
    mass = section.mass + section.Can * scene.density * math.pi / 4 * section.d**2
    h = L / elements
    K = section.EI / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                                      [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])  # fmt: skip
    K += pull / (30 * h) * np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h * h, -3 * h, -h * h],
                                     [-36, -3 * h, 36, -3 * h], [3 * h, -h * h, -3 * h, 4 * h * h]])  # fmt: skip
    M = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                            [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])  # fmt: skip
    size = 2 * (elements + 1)
    A, B = np.zeros((size, size)), np.zeros((size, size))
    for e in range(elements):
        A[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += K
        B[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += M
    from scipy.linalg import eigh

    square, shapes = eigh(A[2:-2, 2:-2], mass * B[2:-2, 2:-2])
    count = min(elements, len(points) - 2)
    full = np.zeros((size, count))
    full[2:-2] = shapes[:, :count] * math.sqrt(mass)
    s = np.clip(np.array(points) / h, 0, elements - 1e-9)
    e = s.astype(int)
    x = s - e
    N = [1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)]
    values = sum(N[i][:, None] * full[2 * e + i] for i in range(4))
    return np.sqrt(square[:count]) / (2 * math.pi), np.asarray(values).T


ABOVE = (8.0, 20.0)  # Hz: the highest term of (3.4), and well beyond it


def modal_energy(response: Response) -> tuple[np.ndarray, np.ndarray]:
    """(k,) frequencies [Hz] and (nt, k) int m v_k^2/2 of each mode of the plain cable [J], transverse velocity."""
    scene = study("bnes_optimum").scene
    arc = response.signals["arc"]
    f, shapes = modes(tuple(float(s) for s in arc))
    v = transverse(response, "velocity")[:, :, 0]
    weights = np.zeros(len(arc))
    weights[:-1] += np.diff(arc) / 2
    weights[1:] += np.diff(arc) / 2
    return f, 0.5 * scene.cable[0].mass * (v @ (shapes * weights).T) ** 2


def high_share(response: Response, window: tuple[float, float]) -> Values:
    """Share of modes above frequencies in the kinetic energy, and that energy [J s], over a window at rest ends."""
    f, energy = modal_energy(response)
    inside = (response.t >= window[0]) & (response.t <= window[1])
    dt = float(response.t[1] - response.t[0])
    each = energy[inside].sum(axis=0) * dt
    found: Values = {"energy_integral": float(each.sum())}
    for limit in ABOVE:
        found[f"above{limit:.0f}"] = float(each[f > limit].sum() / each.sum())
        found[f"above{limit:.0f}_integral"] = float(each[f > limit].sum())
    half = np.flatnonzero(inside)[-1] - int(1.0 / dt)
    late = energy[half : half + int(1.0 / dt)].sum(axis=0)
    return found | {"late8": float(late[f > 8.0].sum() / late.sum()), "late_energy": float(late.sum() * dt)}


# --------------------------------------------------------------------------- groups: paper 003, dear


@group(dear=True)
def devices_lumped() -> Values:
    """Every arrangement on the study's line and mesh, 100 lumped segments."""
    scenes = sinks() | dampers()
    return compared("lumped", 100, list(scenes), scenes)


@group(dear=True)
def devices_transverse() -> Values:
    """The same on 80 spans of the small-motion line, another discretisation."""
    scenes = sinks() | dampers()
    names = ("uniform", "plain", "locked", "rod_locked", "bnes_rods", "bnes_points", "cubic_rods", "cubic_points",
             "tmd", "tmd_low", "tmd_high", "tmd_calm")  # fmt: skip
    return compared("transverse", 80, names, scenes)


@group(dear=True)
def tuning() -> Values:
    """Frequency and damping ratio of four equal linear dampers: least Delta, and most Gamma, against locked masses."""
    scene = study("bnes_optimum").scene
    ask = ask_of("transverse", 60)
    locked = baseline_scene(scene, "locked")
    base = summary_of(run(locked, ask), locked)
    tried = []
    for frequency in np.geomspace(0.5, 16.0, 11):
        for damping in (0.1, 0.2, 0.4, 0.8):
            each = tuned(scene, float(frequency), damping)
            metrics = compute(summary_of(run(each, ask), each), base, 4)
            tried.append((metrics["delta"], metrics["gamma"], float(frequency), damping))
    delta, calm = min(tried), max(tried, key=lambda row: row[1])
    return {
        "delta": delta[0], "gamma": delta[1], "frequency": delta[2], "damping": delta[3],
        "calm_delta": calm[0], "calm_gamma": calm[1], "calm_frequency": calm[2], "calm_damping": calm[3],
    }  # fmt: skip


def dampers() -> dict[str, Scene]:
    """Linear dampers tuned to the nominal cable, and the same out of tune by a factor of two either way."""
    known = json.loads((ROOT / "docs" / "papers_numbers.json").read_text())["tuning"]["values"]
    scene, f, z = study("bnes_optimum").scene, known["frequency"], known["damping"]
    return {
        "tmd": tuned(scene, f, z),
        "tmd_low": tuned(scene, f / 2, z),
        "tmd_high": tuned(scene, 2 * f, z),
        "tmd_calm": tuned(scene, known["calm_frequency"], known["calm_damping"]),
    }


@group(dear=True)
def fouling() -> Values:
    """Section 4: RMS reductions in random seas over clean and fouled cables, mean and spread over three seas."""
    fouled = study("biofouling")
    ask = ask_of("transverse", 40)
    known = json.loads((ROOT / "docs" / "papers_numbers.json").read_text())["tuning"]["values"]
    found: Values = {}
    for index, environment in enumerate(fouled.environments):
        rows: dict[str, list[Values]] = {}
        for seed in range(1, 4):
            scene = design_scene(fouled, {}, index)
            motion = replace(scene.end_b.motion, stochastic=replace(scene.end_b.motion.stochastic, seed=seed))
            scene = replace(scene, end_b=replace(scene.end_b, motion=motion))
            cable = scene.cable
            bases = {}
            for base in ("uniform", "locked"):
                other = baseline_scene(scene, base)
                bases[base] = summarise(run(other, ask), other, settings(), cable)
            cubic = replace(scene, devices=study("nes_plain").scene.devices)
            cases = {
                "bnes_rods": scene,
                "bnes_points": at_points(scene),
                "cubic_points": at_points(cubic),
                "tmd": tuned(scene, known["frequency"], known["damping"]),
                "rod_locked": baseline_scene(scene, "rod_locked"),
            }
            for name, each in cases.items():
                response = run(each, ask)
                if not response.trusted:
                    continue
                curves = summarise(response, each, settings(), cable)
                row = {}
                for base, curve in bases.items():
                    metrics = compute(curves, curve, len(each.devices))
                    row |= {f"probe_{base}": metrics["rms_probe_reduction"], f"rms_{base}": metrics["rms_reduction"]}
                rows.setdefault(name, []).append(row)
        for name, each_rows in rows.items():
            found |= statistics(f"{name}_{index}", each_rows)
        print(f"  fouling {environment.name}", file=sys.stderr, flush=True)
    names = ("bnes_rods", "bnes_points", "cubic_points", "tmd", "rod_locked")
    for name in names:
        for what in ("probe_uniform", "rms_uniform", "probe_locked", "rms_locked"):
            values = [found[f"{name}_{i}_{what}"] for i in range(1, 10) if f"{name}_{i}_{what}" in found]
            found |= {f"{name}_fouled_{what}": float(np.mean(values)), f"{name}_fouled_{what}_low": min(values),
                      f"{name}_fouled_{what}_high": max(values)}  # fmt: skip
    return found


# --------------------------------------------------------------------------- groups: paper 003, quick


@group()
def scene_numbers() -> Values:
    """What the geometry of the study scene comes to."""
    scene = study("bnes_optimum").scene
    L, cable = scene.length, scene.cable[0]
    mass = L * cable.mass
    jump = sum(2 * math.pi * h.frequency * h.amplitude[0] for h in scene.end_b.motion.harmonics)
    return {
        "length": L,
        "mass": mass,
        "share_4kg": 4 / mass,
        "share_3kg": 3 / mass,
        "node5_depth": 25.0 - 5 * L / 20,
        "jump": jump,
        "wet": cable.wet(scene.density, scene.g) / scene.g,
        "lowest_mode": float(modes(tuple(np.linspace(0, L, 101)))[0][0]),
        "wet_fouled": replace(cable, d=0.12, mass=5.73).wet(scene.density, scene.g),
    }


@group()
def curvature() -> Values:
    """The printed curvature over that of the circle through the nodes, of three nodes on a circle."""
    found = {}
    for degrees in (1.0, 30.0):
        theta, dl = math.radians(degrees), 1.0
        exact = 2 * math.sin(theta / 2) / dl
        found[f"ratio_{degrees:.0f}"] = 2 / dl * math.sqrt(1 - math.cos(theta)) / exact
    return found


def law(device: Any, kind: float) -> tuple[float, float, float, float, float]:
    return kind, device.EA / device.length, device.BA / device.length, device.length, device.half_span


@group()
def barriers() -> Values:
    """Energy that Table 1's devices need to cross mid-stroke, and the energy that the cable has to give."""
    devices = study("bnes_optimum").scene.devices
    two_way = [float(law_energy(0.0, law(d, SPRINGS))) for d in devices]
    cords = [float(law_energy(0.0, law(d, CORDS))) for d in devices]
    scene = study("bnes_optimum").scene
    base = run(baseline_scene(scene, "uniform"), ask_of("lumped", 100))
    signals = base.signals
    peak = float((signals["kinetic"] + signals["strain"] + signals["gravity"]).max())
    return {
        "least": min(two_way),
        "largest": max(two_way),
        "cords": max(cords),
        "cable": peak,
        "y0_mm": 1e3 * devices[0].rest_offset,
        "dead_band_mm": 2e3 * devices[0].rest_offset,
    }


@group()
def force_laws() -> Values:
    """Figure 3's device: wells, least force and stiffness of the springs, and of the cords between the wells."""
    found: Values = {}
    k, a = 2e4, 0.05
    for phi in (0.0, 2.0, 11.48):
        rest = a / math.cos(math.radians(phi))
        y0 = a * math.tan(math.radians(phi))
        y = np.linspace(0, max(y0, 0.01), 20001)
        springs = np.array([law_force(float(x), 0.0, (SPRINGS, k, 0.0, rest, a))[0] for x in y])
        cords = [law_force(float(x), 0.0, (CORDS, k, 0.0, rest, a))[0] for x in np.linspace(0, 0.999 * y0, 50)]
        tag = f"{phi:.0f}"
        found |= {f"y0_{tag}": 1e3 * y0, f"least_{tag}": float(springs.min())}
        found[f"between_{tag}"] = float(np.abs(cords).max())
    found["cubic_5mm"] = float(law_force(0.005, 0.0, (SPRINGS, k, 0.0, a, a))[0])
    for phi in (0.01, 0.1, 0.22):  # stiffness at mid-stroke: negative means bistable
        rest = a / math.cos(math.radians(phi))
        found[f"stiffness_{phi}"] = float(law_force(1e-9, 0.0, (SPRINGS, k, 0.0, rest, a))[1])
    return found


@group()
def damping_law() -> Values:
    """Table 1's dampers over sqrt(0.002 EA), and the ends of the printed range."""
    printed = {"1": (5.384e8, 1.038e3), "2": (7.293e9, 3.819e4), "3": (1.067e9, 1.460e3)}
    found = {f"ratio_{name}": d / math.sqrt(0.002 * EA) for name, (EA, d) in printed.items()}
    return found | {"low": math.sqrt(0.002 * 1e4), "high": math.sqrt(0.002 * 5e10),
                    "proportional": 1.038e3 / 5.384e8 / (1.460e3 / 1.067e9)}  # fmt: skip


@group()
def rods_alone() -> Values:
    """Rods with locked masses beside no rods, one run each: fairlead tension, kinetic and displacement integrals."""
    scene = study("bnes_optimum").scene
    ask = ask_of("lumped", 100)
    curves = {name: summary_of(run(baseline_scene(scene, name), ask), scene) for name in BASELINES}
    found: Values = {}
    for name in BASELINES:
        metrics = compute(curves[name], curves["uniform"], 0)
        found |= {f"{name}_{m}": metrics[m] for m in ("delta", "gamma", "peak_tension_top", "rms_tension_top",
                                                      "rms_reduction", "t_settle")}  # fmt: skip
    rods = compute(curves["rod_locked"], curves["locked"], 0)
    return found | {"rods_delta": rods["delta"], "rods_gamma": rods["gamma"], "rods_rms": rods["rms_reduction"]}


@group()
def settling() -> Values:
    """G of eq. (3.3) with the square at the window's end, and Gamma, which must be the same."""
    scene = study("bnes_optimum").scene
    ask = ask_of("transverse", 60)
    base = summary_of(run(baseline_scene(scene, "uniform"), ask), scene)
    own = summary_of(run(scene, ask), scene)
    assert own is not None
    assert base is not None
    from sweep.metrics import settling_index

    index = settling_index(own, base)
    # what eq. (3.3) can reach: G(t*) = 0.9 and Gamma = 0.5201 over t1 leave this share of the baseline's integral
    return {"G_end": float(index[-1]), "gamma": compute(own, base, 4)["gamma"], "G_largest": float(np.nanmax(index)),
            "needed_growth": (1 - 0.5201) / (1 - 0.9)}  # fmt: skip


@group()
def morlet_transform() -> Values:
    """A chirp's transform by FFT beside direct quadrature of the corrected (3.6)."""
    from sweep.signals import CENTRE, morlet

    dt = 1e-3
    t = np.arange(0, 4, dt)
    x = np.sin(2 * np.pi * (2 * t + 1.5 * t**2)) * np.exp(-((t - 2) ** 2))
    f = np.array([3.0, 5.0, 8.0, 12.0])
    fast = morlet(x, dt, f)
    worst = 0.0
    for i, frequency in enumerate(f):
        scale = CENTRE / (2 * np.pi * frequency)
        for j in range(1000, 3000, 250):
            tau = (t - t[j]) / scale
            psi = np.pi**-0.25 * np.exp(1j * CENTRE * tau - tau**2 / 2)
            direct = (x * psi.conj()).sum() * dt / math.sqrt(scale)
            worst = max(worst, abs(fast[i, j] - direct) / np.abs(fast[i]).max())
    # the printed window has a width of omega_c/sqrt(2) s at every frequency: a Gabor transform
    return {"error": float(worst), "printed_width": CENTRE / math.sqrt(2),
            "width_2hz": CENTRE / (2 * np.pi * 2), "width_8hz": CENTRE / (2 * np.pi * 8)}  # fmt: skip


# --------------------------------------------------------------------------- groups: paper 001


def suspension(joint: float | None, segments: int = 160) -> dict[str, Any]:
    scene = load_study(CONFIGS / "suspension.yaml").scene
    model = {} if joint is None else {"rods": ((joint, 2.0),)}
    found = solve(scene, Ask(model="rod" if joint is None else "hybrid", segments=segments, accuracy=0.3, **model))
    signals = found.signals
    x = signals["position"][-1]
    from sweep.metrics import depth

    return {
        "status": found.status,
        "x": x,
        "arc": signals["arc"],
        "tension": signals["tension"][-1],
        "moment": np.linalg.norm(signals["moment"][-1], axis=1),
        "shear": signals["shear"][-1],
        "sag": depth(x, signals["arc"]),
    }


@group()
def wire() -> Values:
    """Goyal and Perkins' suspension at rest, 160 elements: the rod, and the hybrid with its joint at 1.5 m."""
    rod, hybrid = suspension(None), suspension(1.5)
    at = float(rod["arc"][-1])
    inner = rod["arc"] < 1.5
    near = rod["arc"] >= 1.5
    moment = np.interp(rod["arc"], hybrid["arc"], hybrid["moment"])
    shear = np.interp(rod["arc"], hybrid["arc"], hybrid["shear"])
    mid = (rod["arc"][1:] + rod["arc"][:-1]) / 2
    hybrid_mid = (hybrid["arc"][1:] + hybrid["arc"][:-1]) / 2
    tension = np.interp(mid, hybrid_mid, hybrid["tension"])
    # clear of the joint, where a free moment is asked for
    clear = rod["arc"] >= 1.6
    return {
        "length": at,
        "sag_rod": rod["sag"],
        "sag_hybrid": hybrid["sag"],
        "sag_more": hybrid["sag"] / rod["sag"] - 1,
        "end_moment_rod": float(rod["moment"][-1]),
        "end_moment_hybrid": float(hybrid["moment"][-1]),
        "end_moment_more": float(hybrid["moment"][-1] / rod["moment"][-1] - 1),
        "tension_error": float(np.abs(tension - rod["tension"]).max() / rod["tension"].max()),
        "tension_at_joint": float(np.interp(1.5, mid, rod["tension"]) / rod["tension"].max()),
        "tension_end": float(rod["tension"][-1] / rod["tension"].max()),
        "moment_left": float(rod["moment"][inner].max() / rod["moment"].max()),
        "shear_left": float(rod["shear"][inner].max() / rod["shear"].max()),
        "moment_error": float(np.abs(moment - rod["moment"])[near].max() / rod["moment"].max()),
        "moment_error_clear": float(np.abs(moment - rod["moment"])[clear].max() / rod["moment"].max()),
        "shear_error": float(np.abs(shear - rod["shear"])[near].max() / rod["shear"].max()),
        "shear_error_clear": float(np.abs(shear - rod["shear"])[clear].max() / rod["shear"].max()),
        "end_shear": float(rod["shear"][-1]),
    }


# --------------------------------------------------------------------------- groups: papers 000 and 002


@group()
def oc3() -> Values:
    """The OC3 line with the right and the misprinted EA: static fairlead tension by the elastic catenary."""
    from solvers.catenary import catenary

    found: Values = {}
    for name, EA in (("right", 3.84243e8), ("printed", 3.84243e7)):
        H, V = catenary(848.67, 250.0, 902.2, 698.094, EA, bed=True)[:2]
        found |= {f"{name}_T": math.hypot(H, V) / 1e3, f"{name}_H": H / 1e3}
    return found


@group()
def oc3_surge() -> Values:
    """The OC3 line hung free, 5 m at 15 s, misprinted EA: end tension by harmonic balance and by settled marching."""
    scene = load_study(CONFIGS / "oc3_hung.yaml").scene
    cable = tuple(replace(section, EA=3.84243e7) for section in scene.cable)
    found: Values = {}
    for name, ask in (
        ("hb", Ask(duration=15.0, method="harmonic", model="lumped", segments=50, harmonics=10, interval=0.05)),
        ("td", Ask(duration=150.0, method="explicit", model="lumped", segments=50, output_from=135.0, interval=0.05)),
    ):
        response = solve(replace(scene, cable=cable), ask)
        pull = np.linalg.norm(response.signals["end_force"][:, 1], axis=1)
        last = pull[response.t > response.t[-1] - 15.0]
        found |= {f"{name}_low": float(last.min()) / 1e3, f"{name}_high": float(last.max()) / 1e3,
                  f"{name}_status": float(response.status)}  # fmt: skip
    return found


# --------------------------------------------------------------------------- command


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--list", action="store_true", help="what there is")
    options = parser.parse_args()
    if options.list:
        for name, entry in GROUPS.items():
            print(f"{name:20} {'dear' if entry.dear else ''}  {(entry.make.__doc__ or '').splitlines()[0]}")
        return
    unknown = set(options.names) - GROUPS.keys()
    if unknown:
        parser.error(f"no group {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    for name in options.names or [name for name, entry in GROUPS.items() if not entry.dear]:
        begun = time.perf_counter()
        values = GROUPS[name].make()
        print(f"{name}  ({time.perf_counter() - begun:.1f} s)")
        for key, value in values.items():
            print(f"    {key:32} {value:.8g}")


if __name__ == "__main__":
    main()
