# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 4. Robustness
#
# Does a design keep working when growth changes the cable? The study needs `environments`; objectives may be aggregates over them,
# `gamma_mean`, `gamma_worst`, or the quantile of the bad tail, `gamma_q10`.

# %%
import json

import matplotlib.pyplot as plt
import numpy as np
from study import folder, show

from sweep import open_study, pareto
from sweep.across import across
from sweep.across_plot import plot_histories, plot_spectra
from sweep.config import split_name
from sweep.series import chosen_key

directory = folder()
data = open_study(directory)
several = "environment" in data.dims
if not several:
    data = data.rename(point="design").expand_dims("environment", axis=1).assign_coords(environment=["as it is"])
objectives = []  # metrics without what is said of them over environments: a column for each environment, each once
for name in json.loads(data.attrs["objectives"]):
    stem, said = split_name(name)
    column = f"{stem}_ensemble" if said[:1] == ("ensemble",) else stem
    objectives += [column] if column not in objectives else []
names = [str(name) for name in data["environment"].values]
good = (data["status"] == "OK").values
print(f"{data.sizes['design']} designs in {len(names)} environments: {', '.join(names)}; {good.all(axis=1).sum()} trusted in all")

# %% [markdown]
# ## Each design in each environment
#
# Bars are standard uncertainties (`uncertainty`), or half ranges over repetitions (`repeats`), where the study has them.

# %%
colours = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"]
markers = "os^Dv<>"
figure, panels = plt.subplots(len(objectives), 1, figsize=(7.5, 3.0 * len(objectives)), sharex=True, squeeze=False, layout="constrained")
order = np.argsort(np.nanmean(data[objectives[0]].values, axis=1))
for ax, name in zip(panels[:, 0], objectives, strict=True):
    for e, environment in enumerate(names):
        values = np.where(good[:, e], data[name].values[:, e], np.nan)[order]
        kind = pareto.barred(data, [name])[0]
        bars = data[f"{split_name(name)[0]}_{kind}"].values[:, e][order] if kind else None
        ax.errorbar(np.arange(len(order)) + 0.12 * e, values, yerr=bars, fmt=markers[e % 7], color=colours[e % 7], capsize=2, label=environment)
    unit = data[name].attrs.get("units", "1")
    ax.set(ylabel=f"{name} [{unit}]")
    ax.grid(True, alpha=0.3)
panels[-1, 0].set(xlabel=f"design, in order of its mean {objectives[0]} [1]")
panels[0, 0].legend()
show(figure)

# %% [markdown]
# ## Mean against worst
#
# On the diagonal a design does not care; what is far off it is good on the average only.

# %%
aggregates = {f"{name}_{how}": pareto.column(data, f"{name}_{how}").values for name in objectives for how in ("mean", "worst")}
figure, panels = plt.subplots(1, len(objectives), figsize=(4.2 * len(objectives), 4.0), squeeze=False, layout="constrained")
for ax, name in zip(panels[0], objectives, strict=True):
    mean, worst = aggregates[f"{name}_mean"], aggregates[f"{name}_worst"]
    ax.plot(mean, worst, "o", color="#0072B2")
    ends = [np.nanmin([mean, worst]), np.nanmax([mean, worst])]
    ax.plot(ends, ends, color="0.5", linewidth=1)
    unit = data[name].attrs.get("units", "1")
    ax.set(xlabel=f"mean {name} [{unit}]", ylabel=f"worst {name} [{unit}]")
    ax.grid(True, alpha=0.3)
show(figure)

# %% [markdown]
# ## Does the front survive?
#
# The front of the first environment, by what its own runs gave, beside that of the worst case over all.

# %%
first = data.isel(environment=0)  # its own columns: the stored `_mean` and `_worst` are over all environments
nominal = set(pareto.front(first, objectives).tolist())
robust = set(pareto.front(data, [f"{name}_worst" for name in objectives]).tolist())
print(f"front in {names[0]}: {sorted(nominal)}\nfront of the worst case: {sorted(robust)}\non both: {sorted(nominal & robust)}")

# %% [markdown]
# ## The best design, environment by environment
#
# Displacement at the probe with and without devices, and its spectra: the paper's figures 14 and 13.

# %%
if several:
    found = across(directory, chosen_key(open_study(directory)))
    show(plot_histories(found))

# %%
if several:
    show(plot_spectra(found))
