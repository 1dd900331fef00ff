"""How far may a line move before `local` goes wrong? Its error against `lumped`, over growing surge of the fairlead.

    python benchmarks/local_range.py --out figures [--segments 60] [--amplitudes 0.1 0.3 1 2 5 10]

Two OC3 lines, marched by `dopri5` on the same mesh for 5 periods of 15 s after a ramp of 30 s: `oc3_hung`, the whole
line clear of the bed with the misprinted EA, and `oc3_touchdown`, the part above the touchdown point with the right
one. Prints, per amplitude: the lumped line's settled peak-to-peak end tension, the relative error of that of `local`,
the error of its displacements (rms over the last two periods and all nodes, over the rms of the lumped line's), the
same two with the factors (1 + es) that the papers drop, the least tension of the lumped line, what `range_error`
estimates beforehand, and whether `local` itself saw a segment go slack. Writes local_range.png.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from solvers import MODELS, Ask, End, Harmonic, Motion, Response, Scene, Section, Water, Window, solve
from solvers.catenary import catenary
from solvers.lines.local import LocalModel

PERIOD, RAMP = 15.0, 30.0
CHAIN = Section(
    length=902.2, d=0.09, mass=77.7066, EA=3.84243e8, BA=3.84243e5, Cdn=1.6, Cdt=1.6 / math.pi, wet_weight=698.094,
    compression=False,
)  # fmt: skip


def moved(x: float) -> Motion:
    """Surge, ramped smoothly from rest."""
    surge = Harmonic(amplitude=(x, 0.0, 0.0), frequency=1 / PERIOD, phase=math.pi / 2)
    return Motion(harmonics=(surge,), window=Window(ramp_up=RAMP, shape="smooth"))


def hung(x: float) -> Scene:
    """The whole line, clear of the bed, with the papers' misprinted EA."""
    return Scene(
        cable=(replace(CHAIN, EA=3.84243e7),), end_a=End(kind="pinned", position=(0.0, 0.0, -320.0)), water=Water(),
        end_b=End(kind="pinned", position=(848.67, 0.0, -70.0), motion=moved(x)),
    )  # fmt: skip


def touchdown(x: float) -> Scene:
    """The part above the touchdown point, which is held."""
    H, V = catenary(848.67, 250.0, CHAIN.length, 698.094, CHAIN.EA, bed=True)
    resting = CHAIN.length - V / 698.094
    foot = (resting * (1 + H / CHAIN.EA), 0.0, -320.0)
    return Scene(
        cable=(replace(CHAIN, length=CHAIN.length - resting),), end_a=End(kind="pinned", position=foot), water=Water(),
        end_b=End(kind="pinned", position=(848.67, 0.0, -70.0), motion=moved(x)),
    )  # fmt: skip


def settled(run: Response) -> tuple[np.ndarray, np.ndarray]:
    """End tension and displacements of the last two periods."""
    late = run.t >= run.t[-1] - 2 * PERIOD
    T = np.linalg.norm(run.signals["end_force"][late, 1], axis=1)
    return T, run.signals["position"][late] - run.signals["static_position"]


def march(scene: Scene, segments: int, model: str) -> Response:
    ask = Ask(
        accuracy=0.99, duration=RAMP + 5 * PERIOD, segments=segments, interval=0.1, model=model, method="dopri5"
    )
    return solve(scene, ask)


def compare(run: Response, best: Response) -> tuple[float, float]:
    """Relative error of the range of the end tension, and of the displacements."""
    (T, x), (T0, x0) = settled(run), settled(best)
    return float(np.ptp(T) / np.ptp(T0) - 1), float(np.sqrt(((x - x0) ** 2).sum() / (x0**2).sum()))


def draw(rows: dict[str, list[tuple[float, ...]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(rows), figsize=(11, 4.5), sharey=True, layout="constrained")
    for ax, (name, table) in zip(axes, rows.items(), strict=True):
        x, _, tension, shape, tension_s, shape_s, _, guess = np.abs(np.array(table)).T
        for y, label, style in (
            (tension, "end tension, as printed", "o-"), (shape, "displacement, as printed", "s-"),
            (tension_s, "end tension, with (1 + es)", "o:"), (shape_s, "displacement, with (1 + es)", "s:"),
            (guess, "estimate", "k--"),
        ):  # fmt: skip
            ax.loglog(x, y, style, label=label)
        ax.set(title=name, xlabel="fairlead surge [m]", ylabel="relative error")
        ax.grid(True, which="both", alpha=0.3)
    axes[0].legend()
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--segments", type=int, default=60)
    parser.add_argument("--amplitudes", type=float, nargs="+", default=[0.1, 0.3, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    default = MODELS["local"]
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name, make in (("oc3_hung", hung), ("oc3_touchdown", touchdown)):
        print(f"{name}\n\n| surge, m | range, kN | tension | displacement | tension, (1 + es) | displacement, (1 + es) "
              "| least tension, kN | range_error | local |")  # fmt: skip
        print("|---|---|---|---|---|---|---|---|---|")
        for x in options.amplitudes:
            best = march(make(x), options.segments, "lumped")
            exact = march(make(x), options.segments, "local")
            MODELS["local"] = default._replace(build=LocalModel)  # as printed
            run = march(make(x), options.segments, "local")
            MODELS["local"] = default
            errors = (*compare(run, best), *compare(exact, best))
            model = default.build(make(x), options.segments)
            guess, size = model.range_error(), float(np.ptp(settled(best)[0])) / 1e3
            least = float(best.signals["tension"].min()) / 1e3
            rows.setdefault(name, []).append((x, size, *errors, least, guess))
            print(f"| {x:g} | {size:.1f} | {errors[0]:+.2%} | {errors[1]:.2%} | {errors[2]:+.2%} | {errors[3]:.2%} "
                  f"| {least:.0f} | {guess:.2%} | {model.validity(run.signals)[0].name} |")  # fmt: skip
        print()
    draw(rows, options.out / "local_range.png")


if __name__ == "__main__":
    main()
