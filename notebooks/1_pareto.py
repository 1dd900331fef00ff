# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 1. Pareto analysis
#
# Which designs are on the front, and which of them differ by more than their error bars? The study is the folder that
# `CABLE_SWEEP_STUDY` names, or the small one of `notebooks/study.yaml`, whose numbers mean nothing.

# %%
import json

import numpy as np
from study import folder, show

from sweep import open_study, pareto
from sweep.plot import plot_ea, plot_front, plot_parallel

directory = folder()
data = open_study(directory)
objectives = json.loads(data.attrs["objectives"])
print(f"{directory.name}: {dict(data.sizes)}, objectives {', '.join(objectives)}")

# %% [markdown]
# ## How the runs ended
#
# Only rows with status OK may be on a front: run to its end, energy balance closed, mesh and steps fine enough.

# %%
data["status"].to_series().value_counts()

# %% [markdown]
# ## The front
#
# With several environments an objective is its mean over them (or its worst, if the study says so).

# %%
front = pareto.front(data, objectives)
stands = pareto.significant(data, objectives, front)
dim = "design" if "environment" in data.dims else "point"
columns = {name: pareto.column(data, name).isel({dim: front}).values for name in objectives}
bars = pareto.spreads(data, objectives)[front]
print(f"{len(front)} points on the front, {stands.sum()} of them not tied with a better one")
for row in range(len(front)):
    cells = [f"{name} = {columns[name][row]:.3f} ± {bars[row, j]:.3f}" for j, name in enumerate(objectives)]
    print(f"  {dim} {front[row]:4d}: {', '.join(cells)}{'' if stands[row] else '   tied'}")

# %%
show(plot_front(data, objectives=objectives))

# %% [markdown]
# Ties are not a matter of taste: two points are tied when in every objective they differ by less than the sum of their half
# ranges over runs that start 1e-9 m/s apart. Without `repeats` in the study the bars are zero and nothing is tied.

# %% [markdown]
# ## What the design variables do

# %%
show(plot_ea(data, objectives=objectives))

# %%
show(plot_parallel(data))

# %% [markdown]
# ## How much of the scatter is chaos?
#
# The spread of an objective over repetitions, beside its standard deviation over all trusted designs: where the two are alike
# the study has ranked noise.

# %%
trusted = pareto.trusted(data)
for j, name in enumerate(objectives):
    values = pareto.column(data, name).values[trusted]
    spread = pareto.spreads(data, objectives)[trusted, j]
    print(f"{name:8}: over designs {values.std():.4f}, half range of one design {np.median(spread[np.isfinite(spread)]):.4f} (median)")
