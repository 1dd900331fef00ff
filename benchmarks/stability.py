"""Where each method fails: more than two thousand runs over steps, tolerances and fields of several scenes.

    python benchmarks/stability.py [--out DIR] [--only NAME ...] [--method NAME ...] [--steps 7]

Prints the outcomes by method and by map, every run that said OK and was not (the bar is none), the share of good runs
that were called bad (the bar is 5 %), and the theoretical limits beside the largest step that was good. Errors are of
time integration: against a tight run on the same mesh, checked by a second method. Windows are short where a scene is
chaotic.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from solvers import (
    BNES,
    TMD,
    CubicNES,
    Current,
    End,
    Harmonic,
    Motion,
    Scene,
    Seabed,
    Section,
    Water,
    Window,
)
from sweep.config import load_scene
from sweep.stability import ALL, Over, cells, dataset, false_alarms, spread, summary

SCENES = Path(__file__).parents[1] / "configs" / "scenes"
STUDY = load_scene(SCENES / "study_cable.yaml")
MARCHES = tuple(name for name in ALL if name != "harmonic")


def bare() -> Scene:
    return replace(STUDY, devices=(), water=Water(depth=25.0, current=Current(z=(-25, 0), velocity=((0, 0, 0),) * 2)))


def one_sink(**change: Any) -> Scene:
    """The study's cable with its first device: tension-only cords on a rod."""
    return replace(STUDY, devices=(replace(STUDY.devices[0], **change),))


def oc3() -> Scene:
    """The OC3 line on its bed; surge of 5 m at 15 s after a ramp of 5 s."""
    scene = load_scene(SCENES / "oc3_line.yaml")
    motion = scene.end_b.motion
    assert motion is not None
    bed = Seabed(z=-320.0, stiffness=3e5, damping=3e4)
    return replace(scene, seabed=bed, end_b=replace(scene.end_b, motion=replace(motion, window=Window(ramp_up=5.0))))


def jumper() -> Scene:
    return load_scene(SCENES / "jumper.yaml")


def without_damping(scene: Scene) -> Scene:
    """BA = 0: lines of the rod family have no internal damping."""
    return replace(scene, cable=tuple(replace(x, BA=0.0) for x in scene.cable))


def shaken(x: float, z: float, frequency: float, ramp: float) -> Motion:
    window = Window(ramp_up=ramp, shape="smooth")
    return Motion(harmonics=(Harmonic(amplitude=(x, 0, z), frequency=frequency),), window=window)


def slack_chain() -> Scene:
    """A light chain between two points, shaken until it goes slack and snaps taut."""
    chain = Section(length=10.0, d=0.02, mass=1.0, EA=1e5, BA=50.0, Cdn=1.5, Cdt=0.1, compression=False)
    return Scene(
        cable=(chain,), water=Water(), end_a=End(kind="pinned", position=(0, 0, -10)),
        end_b=End(kind="pinned", position=(8.0, 0, -6.5), motion=shaken(0.2, 0.3, 0.8, 0.5)),
    )  # fmt: skip


def upright(tension: float = 200.0, EI: float = 50.0) -> Scene:
    """A vertical cable without weight whose end sways, at a tension that the map takes through zero."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e5, EI=EI, BA=20.0, wet_weight=0.0, compression=True)
    return Scene(
        cable=(cable,), water=Water(density=1000.0), end_a=End(kind="pinned", position=(0, 0, -20)),
        end_b=End(kind="pinned", position=(0, 0, -20 + 10 * (1 + tension / 1e5)), motion=shaken(0.05, 0, 1.5, 0.3)),
    )  # fmt: skip


def hose(devices: tuple[Any, ...] = ()) -> Scene:
    cable = Section(length=12.0, d=0.06, mass=5.0, EA=1e6, BA=2e3, Cdn=1.2, Cdt=0.01, compression=True)
    return Scene(
        cable=(cable,), water=Water(), devices=devices, end_a=End(kind="pinned", position=(0, 0, -13)),
        end_b=End(kind="pinned", position=(0, 0, -13 + 12 * 1.002), motion=shaken(0.1, 0, 1.2, 0.5)),
    )  # fmt: skip


def string() -> Scene:
    """A taut string without any damping, shaken for two seconds and left to swing: errors of phase add up."""
    cable = Section(length=10.0, d=0.05, mass=2.0, EA=1e5, wet_weight=0.0, compression=True)
    push = Motion(
        harmonics=(Harmonic(amplitude=(0.02, 0, 0), frequency=0.5),),
        window=Window(stop=2.0, ramp_up=0.5, ramp_down=0.5, shape="smooth"),
    )
    return Scene(
        cable=(cable,), g=0.0, end_a=End(kind="pinned", position=(0, 0, 0)),
        end_b=End(kind="pinned", position=(0, 0, 10 * (1 + 500 / 1e5)), motion=push),
    )  # fmt: skip


def stretched(*tensions: float) -> tuple[float, ...]:
    return tuple(-20 + 10 * (1 + T / 1e5) for T in tensions)


def maps(steps: int) -> dict[str, tuple[Scene, Over]]:
    def over(field: str, values: Sequence[float], duration: float, segments: int, **more: Any) -> Over:
        given = {"methods": MARCHES, **more}
        return Over(
            field=field, values=tuple(values), duration=duration, segments=segments, steps=steps, **given
        )

    family = ("rk4", "genalpha 1", "genalpha 0.8", "trbdf2")
    sink = CubicNES(s=5.0, mass=2.0, EA=5e3, BA=20.0, length=0.5)
    springs = BNES(s=5.0, mass=2.0, EA=2e4, BA=20.0, length=0.5, phi0=3.0, law="springs")
    damper = TMD(s=5.0, mass=2.0, k=120.0, c=4.0)
    tensions = (-400.0, -50.0, 0.0, 50.0, 400.0, 3000.0)
    top = tuple(-25 + 18.8016 * (1 + T / 9e6) for T in (-500.0, -50.0, 0.0, 500.0, 5000.0))
    return {
        "bare cable, EI": (bare(), over("cable[0].EI", spread(1e3, 1e5, 3), 0.6, 40)),
        "bare cable, EI, long": (bare(), over("cable[0].EI", (11710.0,), 2.0, 40)),
        "bare cable, segments": (bare(), over("ask.segments", (30, 40, 60), 0.4, 40)),
        "bare cable, tension": (bare(), over("end_b.position[2]", top, 0.4, 40)),
        "bare cable, BA": (bare(), over("cable[0].BA", (0.0, 100.0, 1e4), 0.4, 40)),
        "bare cable, drag": (bare(), over("cable[0].Cdn", (0.0, 20.0, 200.0), 0.4, 40)),
        "bare cable, current": (bare(), over("water.current.velocity[1][0]", (0.3, 1.0, 3.0), 0.4, 40)),
        "sink, cord EA": (one_sink(), over("devices[0].EA", spread(1e4, 5e10, 7), 0.3, 40)),
        "sink, phi0": (one_sink(), over("devices[0].phi0", (0.5, 2.0, 3.562, 8.0, 15.0), 0.3, 40)),
        "four sinks, cord EA of one": (STUDY, over("devices[1].EA", (7.293e9,), 0.6, 40)),
        "four sinks, model transverse, cord EA of one": (
            STUDY, over("devices[1].EA", (1e5, 1e7, 7.293e9), 0.4, 32, models=("transverse",))),
        "sink, cord EA, long": (one_sink(), over("devices[0].EA", (1e5, 5.384e8), 1.5, 40)),
        "string in air, long": (string(), over("", (math.nan,), 60.0, 16)),
        "free sink, cord EA": (
            one_sink(kind="bnes_free", rod=None), over("devices[0].EA", spread(1e4, 1e9, 4), 0.2, 40)),
        "OC3 line on its bed, fairlead": (
            oc3(), over("end_b.position[0]", (830.0, 845.0, 848.67, 855.0), 20.0, 30)),
        "jumper, EI": (jumper(), over("cable[0].EI", (0.0, 1.208e5, 1e7), 20.0, 30)),
        "jumper, model local, surge": (
            jumper(), over("end_b.motion.harmonics[0].amplitude[0]", (0.5, 2.0), 20.0, 30, models=("local",))),
        "jumper, rod and catenary": (
            without_damping(jumper()), over("", (math.nan,), 10.0, 20, models=("rod", "catenary"), methods=family)),
        "slack chain, span": (slack_chain(), over("end_b.position[0]", (5.0, 8.0, 9.2, 9.39), 1.0, 20)),
        "slack chain, BA": (slack_chain(), over("cable[0].BA", (1.0, 50.0, 1e3), 0.8, 20)),
        "through zero tension, EI = 50": (upright(), over("end_b.position[2]", stretched(*tensions), 1.0, 20)),
        "through zero tension, EI = 0": (upright(EI=0.0), over("end_b.position[2]", stretched(*tensions), 1.0, 20)),
        "hose, amplitude": (
            hose(), over("end_b.motion.harmonics[0].amplitude[0]", (0.02, 0.1, 0.4), 2.0, 16, methods=ALL)),
        "hose with a cubic sink": (
            hose((sink,)), over("devices[0].EA", (5e2, 5e3, 5e4), 2.0, 16, methods=ALL)),
        "hose with springs": (hose((springs,)), over("devices[0].EA", (2e3, 2e4, 2e5), 1.0, 16, methods=ALL)),
        "hose with a damper": (hose((damper,)), over("devices[0].k", (30.0, 120.0, 480.0), 2.0, 16, methods=ALL)),
    }  # fmt: skip


def table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (names, ["---"] * len(names), *rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the runs of each map here, as csv and netCDF")
    parser.add_argument("--only", nargs="+", default=[], help="maps whose name contains one of these")
    parser.add_argument("--steps", type=int, default=7, help="points along the step or tolerance")
    parser.add_argument("--method", nargs="+", default=[], help="these methods alone, as `sweep stability` names them")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    begun = time.perf_counter()
    chosen = {
        name: one for name, one in maps(options.steps).items()
        if not options.only or any(part in name for part in options.only)
    }  # fmt: skip
    if options.method:
        chosen = {
            name: (scene, replace(over, methods=kept)) for name, (scene, over) in chosen.items()
            if (kept := tuple(x for x in over.methods if x in options.method))
        }  # fmt: skip
    pool = ProcessPoolExecutor(options.processes, mp_context=get_context("spawn"))
    results = pool.map(cells, *zip(*chosen.values(), strict=True))
    for (name, (scene, over)), mine in zip(chosen.items(), results, strict=True):
        rows += [row | {"map": name} for row in mine]
        bad = sum(row["outcome"] == "inaccurate" for row in mine)
        print(f"{name}: {len(mine)} runs, {bad} inaccurate, {time.perf_counter() - begun:.0f} s", flush=True)
        if options.out:
            options.out.mkdir(parents=True, exist_ok=True)
            stem = "".join(c if c.isalnum() else "_" for c in name)
            dataset(mine, over, scene).to_netcdf(options.out / f"{stem}.nc")
            dataset(mine, over, scene).to_dataframe().to_csv(options.out / f"{stem}.csv", index=False)
    print("\n" + table(*summary(rows)))
    for what in ("inaccurate", "false alarm"):
        found = [row for row in rows if row["outcome"] == what]
        print(f"\n{what}: {len(found)} runs")
        for row in found:
            print(
                f"  {row['map']}, {row['value']:g}: {row['method']} at {row['setting']:.3g} (x {row['multiple']:.2f}): "
                f"error {row['error']:.2g}, promise {row['promise']:.2g}, energy {row['energy_residual']:.1e}, "
                f"{row['status']}: {row['message']}"
            )
    print(f"\ngood runs called bad: {false_alarms(rows):.1%}")
    largest(rows)


def largest(rows: Sequence[dict[str, Any]]) -> None:
    """The largest step that was good over the limit in theory, of methods that have one."""
    found: dict[str, list[float]] = {}
    for name in ("rk2", "rk4"):
        for where in {(row["map"], row["value"]) for row in rows}:
            mine = [row for row in rows if row["method"] == name and (row["map"], row["value"]) == where]
            good = [row["setting"] / row["limit"] for row in mine if row["outcome"] == "good" and row["limit"] > 0]
            if good:
                found.setdefault(name, []).append(max(good))
    for name, ratios in found.items():
        print(f"{name}: largest good step over the limit: median {np.median(ratios):.2f}, at most {max(ratios):.2f}")


if __name__ == "__main__":
    main()
