# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 3. Speed against accuracy
#
# What does an error cost, by line and mesh? The study's cable without its devices, because waveforms after impacts do not
# converge. `sweep chart STUDY.yaml --out DIR` does this for all lines and methods, with a reference that is checked.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from study import folder, show

from solvers import Ask, solve
from solvers.pilot import gap
from sweep.space import baseline_scene, design_scene, designs
from sweep.store import study_of

study = study_of(folder())
scene = baseline_scene(design_scene(study, designs(study, 1)[0]), "plain")
ask = Ask(duration=min(study.ask.duration, 2.0), interval=study.ask.interval, accuracy=0.9)
scene.length, scene.cable[0]

# %% [markdown]
# ## A reference
#
# Fine in mesh and tolerance, and checked by another line: an error below their difference cannot be told.

# %%
reference = solve(scene, replace(ask, model="hermite", method="esdirk4", segments=60, tolerance=1e-6))
other = solve(scene, replace(ask, model="transverse", method="dopri5", segments=40, tolerance=1e-5))
doubt = gap(other, reference)
print(f"reference {reference.status.name}; 40 transverse spans differ by {doubt:.1e}")

# %% [markdown]
# ## Error against counted work
#
# Work is evaluations of the equations times nodes: it does not depend on the machine. Seconds do, and are printed beside.

# %%
meshes = {"lumped": (10, 20, 40, 80), "hermite": (4, 6, 9, 14), "transverse": (6, 9, 14, 20)}
methods = {"lumped": "dopri5", "hermite": "esdirk4", "transverse": "dopri5"}
rows = {}
for model, sizes in meshes.items():
    rows[model] = []
    for n in sizes:
        run = solve(scene, replace(ask, model=model, method=methods[model], segments=n))
        error = gap(run, reference)
        rows[model].append((run.cost.evaluations * len(run.signals["arc"]), error))
        print(f"{model:10} {n:4d}  {run.status.name:10} error {error:8.1e}  {run.cost.evaluations:8d} evaluations  {run.cost.seconds:.3f} s")

# %%
figure, ax = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
looks = {"lumped": ("#0072B2", "o"), "hermite": ("#D55E00", "s"), "transverse": ("#009E73", "^")}
for model, points in rows.items():
    colour, marker = looks[model]
    ax.loglog(*np.array(points).T, color=colour, marker=marker, label=f"{model}, {methods[model]}")
ax.axhline(doubt, color="0.5", linestyle="dashed", label="doubt about the reference")
ax.set(xlabel="work [evaluations × nodes]", ylabel="relative error of the displacement [1]")
ax.grid(True, which="both", alpha=0.3)
ax.legend()
show(figure)

# %% [markdown]
# ## Order in the mesh
#
# Slope between the two finest meshes above the doubt: 2 for lumped masses, up to 4 for the others where the motion is smooth; jumps of
# its velocity or acceleration, as at the ends of cosine ramps, lower it.

# %%
for model, sizes in meshes.items():
    errors = np.array([error for _, error in rows[model]])
    seen = np.flatnonzero(errors > 3 * doubt)[-2:]
    if len(seen) == 2:
        i, j = seen
        print(f"{model:10} order {np.log(errors[i] / errors[j]) / np.log(sizes[j] / sizes[i]):.1f} from {sizes[i]} to {sizes[j]}")
