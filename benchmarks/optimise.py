"""Does an algorithm in the loop pay? NSGA-II with 500 evaluations beside a random sweep of 2000 on the same scene.

    python benchmarks/optimise.py --out DIR [--seeds 1 2 3 4 5] [--sweep 2000] [--evaluations 500] [--fresh 15]

Both run configs/bnes_optimise.yaml, whose objectives are means over a run and its perturbed repetitions. Responses are
chaotic, so that the front of many designs is partly luck: each front is run again with other perturbations (a run and
--fresh repetitions, none of them seen in the search), and only these means are counted, with the reference point of the
study. Prints both, and the hypervolume that the search itself believed in. Resumes what is in DIR.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from solvers import SOURCE_HASH
from sweep import distribute, open_study, pareto
from sweep.config import Sampler, Study, load_study
from sweep.optimise import answers, given_reference, optimise, volume
from sweep.plan import Orders, plan_of
from sweep.run import Settings, run
from sweep.store import read_records, settle

CONFIG = Path(__file__).parents[1] / "configs" / "bnes_optimise.yaml"
FRESH_SEED = 1000  # perturbations from here on are seen by no search


def changed(study: Study, **changes: object) -> Study:
    """The study with other fields; its text says so, because the store keeps it."""
    raw = yaml.safe_load(study.text)
    raw |= {name: value for name, value in changes.items() if isinstance(value, dict)}
    return replace(study, text=yaml.safe_dump(raw, sort_keys=False), **typed(study, changes))


def typed(study: Study, changes: dict[str, object]) -> dict[str, object]:
    made: dict[str, object] = {}
    if "sampler" in changes:
        made["sampler"] = Sampler(**changes["sampler"])
    if "optimise" in changes:
        made["optimise"] = replace(study.optimise, **changes["optimise"])
    return made


def front_values(folder: Path, study: Study) -> np.ndarray:
    """(n_front, n_variable) designs on the front that a folder's rows make."""
    dataset = open_study(folder)
    chosen = pareto.front(dataset, study.objectives)
    return np.column_stack([dataset[name].values[chosen] for name in study.variables])


def again(study: Study, designs: np.ndarray, folder: Path, repeats: int) -> np.ndarray:
    """(n, n_objective) costs of designs as means over fresh perturbations; designs that are not trusted left out."""
    fresh = replace(
        study,
        ask=replace(study.ask, perturbation=study.settings.perturbation, seed=FRESH_SEED),
        settings=replace(study.settings, repeats=repeats),
    )
    plan = plan_of(fresh, designs)
    rows = settle(read_records(folder))
    left = np.array([i for i, key in enumerate(plan.keys) if key not in rows], dtype=int)
    if len(left):
        job = distribute.Job(directory=str(folder), header={"solver": SOURCE_HASH}, any_version=True, study=fresh)
        distribute.map_points(Orders.of(plan, left), job, distribute.Alone())
    found = answers(fresh, plan, settle(read_records(folder)))
    return found.costs[found.good]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--sweep", type=int, default=2000)
    parser.add_argument("--evaluations", type=int, default=500)
    parser.add_argument("--fresh", type=int, default=15)
    options = parser.parse_args()
    study = load_study(CONFIG)
    reference = given_reference(study)
    rows = []

    def count(label: str, folder: Path, runs: int) -> float:
        designs = front_values(folder, study)
        believed = pareto.costs(open_study(folder), study.objectives)
        believed = believed[pareto.front(open_study(folder), study.objectives)]
        true = again(study, designs, options.out / "fresh", options.fresh)
        rows.append((label, runs, len(designs), volume(believed, reference), volume(true, reference)))
        print("| {} | {} | {} | {:.4f} | {:.4f} |".format(*rows[-1]), flush=True)
        return rows[-1][-1]

    print(f"objectives {', '.join(study.objectives)}; reference {study.optimise.reference}")
    print(f"solver {SOURCE_HASH}, {os.cpu_count()} cores\n")
    print("| what | designs run | on its front | hypervolume believed | hypervolume of fresh means |")
    print("|---|---|---|---|---|", flush=True)
    found = []
    for seed in options.seeds:
        folder = options.out / f"seed{seed}"
        section = yaml.safe_load(study.text)["optimise"] | {"seed": seed, "evaluations": options.evaluations}
        optimise(changed(study, optimise=section), Settings(directory=folder))
        found.append(count(f"NSGA-II, seed {seed}", folder, options.evaluations))
    sampler = {"kind": "random", "n": options.sweep, "seed": 1}
    folder = options.out / "random"
    run(changed(study, sampler=sampler), Settings(directory=folder))
    swept = count("random sweep", folder, options.sweep)
    mean = float(np.mean(found))
    print(f"\nmean over {len(found)} seeds {mean:.4f} ({min(found):.4f} to {max(found):.4f}), sweep {swept:.4f}: "
          f"{'holds' if mean >= swept else 'MISSED'} ({mean / swept - 1:+.1%})")


if __name__ == "__main__":
    main()
