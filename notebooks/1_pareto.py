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
kinds = pareto.barred(data, objectives)  # what each objective's error bar is: "sd", "spread", or "" for none
normal = np.array([kind == "sd" for kind in kinds])
bars = np.where(normal, pareto.deviations(data, objectives), pareto.spreads(data, objectives))
print(f"{len(front)} points on the front, {stands.sum()} of them not tied with a better one")
meaning = {"sd": "standard uncertainty", "spread": "half range over repetitions", "": "no error bar: ties no points"}
print("; ".join(f"± of {name}: {meaning[kind]}" for name, kind in zip(objectives, kinds, strict=True)))
for row in range(len(front)):
    widths = [f" ± {bar:.3f}" if np.isfinite(bar) else " ± ?" for bar in bars[front[row]]]
    widths = [width if kind else "" for width, kind in zip(widths, kinds, strict=True)]
    cells = [f"{name} = {columns[name][row]:.3f}{width}" for name, width in zip(objectives, widths, strict=True)]
    print(f"  {dim} {front[row]:4d}: {', '.join(cells)}{'' if stands[row] else '   tied'}")

# %%
show(plot_front(data, objectives=objectives))

# %% [markdown]
# Ties are not a matter of taste: two points are tied when in every objective they differ by less than their error bars. With
# `uncertainty` in the study these are 1.96 standard deviations of the difference; else, with `repeats`, the sum of the half
# ranges over runs whose start velocities differ a little (`repeats.perturbation`; 1e-5 m/s in the small study). An objective
# with neither has no error bar: it ties nothing, which is not to say that its differences mean something.

# %% [markdown]
# ## What the design variables do

# %%
show(plot_ea(data, objectives=objectives))

# %%
show(plot_parallel(data))

# %% [markdown]
# ## How much of the scatter is chaos?
#
# The error bar of one design's objective, beside the standard deviation of the objective over all trusted designs: where the
# two are alike the study has ranked noise.

# %%
trusted = pareto.trusted(data)
for j, name in enumerate(objectives):
    values = pareto.column(data, name).values[trusted]
    known = bars[trusted, j][np.isfinite(bars[trusted, j])]
    noise = f"{meaning[kinds[j]]} of one design {np.median(known):.4f} (median)" if kinds[j] and known.size else "no error bar"
    print(f"{name:8}: over designs {np.nanstd(values):.4f}, {noise}")
