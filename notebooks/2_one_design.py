# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # 2. One design under the microscope
#
# The best design of a study: what moves, where the energy goes, at which frequencies.

# %%
from study import folder, show

from sweep import open_study
from sweep.flows import flow_of, modal_of
from sweep.histories import (
    plot_energy,
    plot_envelope,
    plot_gt,
    plot_history,
    plot_spectrum,
    plot_stroke,
    plot_wavelet,
)
from sweep.series import chosen_key, series_of, spectrum, wavelet
from sweep.signal_plots import plot_flow, plot_modes

directory = folder()
data = open_study(directory)
key = chosen_key(data)  # or any key of data["key"]
series = series_of(directory, key)
print(f"{key}: energy residual {float(series['residual'][-1]):.1e} at the end")
{name.removeprefix("metric_"): value for name, value in series.attrs.items() if name.startswith("metric_")}

# %% [markdown]
# ## Displacement, with the device and without it

# %%
show(plot_history(series))

# %%
show(plot_envelope(series))

# %% [markdown]
# ## The masses
#
# Dashed lines: passages from beyond one rest position to beyond the other. Between them tension-only cords are slack, and the mass
# flies freely: straight lines.

# %%
show(plot_stroke(series))

# %% [markdown]
# ## Where the energy went
#
# The ledger closes, or the run would not be trusted. What the device took is the area that counts for its use.

# %%
show(plot_energy(series))
lost = {name: float(series[name][-1]) for name in ("lost_water", "lost_cable", "lost_device")}
print({name: f"{value / sum(lost.values()):.1%}" for name, value in lost.items()})

# %% [markdown]
# What passes to and fro between cable and devices, and in which of the cable's modes the energy is: the share above the highest
# frequency of the motion rises where a device scatters energy upwards.

# %%
show(plot_flow(flow_of(directory, key)))

# %%
show(plot_modes(modal_of(directory, key)))

# %% [markdown]
# ## Settling

# %%
show(plot_gt(series))

# %% [markdown]
# ## Frequencies at the probe

# %%
show(plot_spectrum(spectrum(series)))

# %%
show(plot_wavelet(wavelet(series)))
