"""One design across its environments at the probe, with and without devices: paper 003, figures 13 and 14."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from .plan import read_plan
from .series import at, series_of, spectrum

MOST = 16  # environments that a figure can show


def across(directory: str | Path, key: str) -> xr.Dataset:
    """Histories and amplitude spectra at the probe in every environment of the design that has this key.

    The first MOST environments; each is a run and one of its baseline, kept like those of other figures.

    Returns
    -------
    dataset with ``displacement`` and ``baseline_displacement`` (environment, time), their ``..._amplitude``
    (environment, frequency), and ``rms_probe_reduction`` (environment) of the rows; ``left_out`` in the attributes

    Raises
    ------
    ValueError
        Where the study has one environment, or a run of the design leaves no history.
    """
    plan = read_plan(Path(directory) / "plan.json")
    if len(plan.environments) < 2:
        raise ValueError("the study has one environment: `history` and `spectrum` show it")
    if key not in plan.keys:
        raise ValueError(f"{directory} has no point {key}")
    m = len(plan.environments)
    design = plan.keys.index(key) // m
    names = plan.environments[:MOST]
    runs = [series_of(directory, plan.keys[design * m + e]) for e in range(len(names))]
    if len({run.sizes["time"] for run in runs}) > 1:
        raise ValueError("the environments are of different lengths, and do not fit one figure")
    spectra = [spectrum(run) for run in runs]
    s = float(spectra[0].attrs["s"])
    attrs = {name: runs[0].attrs[name] for name in ("baseline", "pulse_end", "values")}
    found = xr.Dataset(
        coords={"environment": names, "time": runs[0]["time"], "frequency": spectra[0]["frequency"]},
        attrs=attrs | {"s": s, "design": design, "left_out": m - len(names)},
    )
    for name in ("displacement", "baseline_displacement"):
        if all(name in run for run in runs):
            history = np.array([at(run, s, name) for run in runs])
            about = {"units": "m", "long_name": "transverse displacement at the probe"}
            found[name] = (("environment", "time"), history, about)
            amplitude = np.array([one[name].values for one in spectra])
            found[f"{name}_amplitude"] = (("environment", "frequency"), amplitude, spectra[0][name].attrs)
    reduction = [float(run.attrs.get("metric_rms_probe_reduction", np.nan)) for run in runs]
    found["rms_probe_reduction"] = ("environment", reduction, {"units": "1"})
    found["status"] = ("environment", np.array([str(run.attrs["status"]) for run in runs], dtype=object))
    return found
