"""Histories for figures: reduction, jumps, transforms against closed forms, force laws, and what a folder keeps."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from study_kit import response

from solvers import BNES, PointMass
from sweep import series as module
from sweep.config import load_study
from sweep.evaluate import clear_baselines, evaluate_with_series
from sweep.metrics import count_jumps
from sweep.plan import make_plan
from sweep.series import (
    at,
    chosen_key,
    directions,
    force_laws,
    jump_samples,
    reduce,
    series_of,
    spectrum,
    wavelet,
)
from sweep.store import prepare

EVALUATOR = importlib.import_module("sweep.evaluate")  # `sweep.evaluate` is the function
STUDY = load_study(Path(__file__).parent / "tiny.yaml")
T = np.linspace(0, 4, 401)
SHAPE = np.array([0.0, 1.0, 3.0, 2.0, 0.0])


def fake_solve(scene, ask):
    """A decaying 2 Hz response, half as large where a sink is alive, whose ledger closes."""
    alive = any(not isinstance(device, PointMass) for device in scene.devices)
    x = (0.5 if alive else 1.0) * np.exp(-T) * np.sin(4 * np.pi * T)
    kinetic, lost = 2 * np.exp(-2 * T), 2 - 2 * np.exp(-2 * T)
    stroke = np.zeros((len(T), len(scene.devices)))
    for i, device in enumerate(scene.devices):
        stroke[:, i] = 1.2 * getattr(device, "rest_offset", 0.0) * np.cos(2 * np.pi * T)
    return response(np.outer(x, SHAPE), T, stroke=stroke, kinetic=kinetic, lost_water=lost)


@pytest.fixture
def reduced(monkeypatch):
    monkeypatch.setattr(EVALUATOR, "solve", fake_solve)
    clear_baselines()
    point = make_plan(STUDY).point(STUDY, 0)
    point = replace(point, settings=replace(point.settings, probe=2.5, window=None, pulse_end=0.0))
    record, raw = evaluate_with_series(point)
    yield reduce(raw, point, record)
    clear_baselines()


def test_reduction(reduced):
    assert reduced["displacement"].dims == ("time", "node")
    ours, theirs = reduced["displacement"].values, reduced["baseline_displacement"].values
    assert ours == pytest.approx(0.5 * theirs, abs=1e-6)  # stored in single precision
    assert at(reduced, 2.5)[10] == pytest.approx(0.5 * ours[10, 2:4].sum(), rel=1e-6)
    assert reduced["depth"].values == pytest.approx(-(np.arange(5.0) - 10))
    assert np.abs(reduced["residual"]).max() < 1e-12
    assert reduced["mechanical"].values[0] == pytest.approx(2.0)
    assert reduced["share"].values[[0, -1]] == pytest.approx([0.0, 1.0])
    settle = float(np.interp(0.9, reduced["share"].values, T))
    assert settle == pytest.approx(reduced.attrs["metric_t_settle"], abs=1e-3)
    assert reduced["jump"].values.sum() == reduced.attrs["metric_jumps"] > 0
    assert all(array.attrs.get("units") for name, array in reduced.data_vars.items() if name != "device_kind")


def test_directions_of_a_hanging_line_lie_in_its_plane():
    """A line in a vertical plane through x and y that moves in that plane: normals, all on one side."""
    angle = np.linspace(0.1, 3.0, 9)
    along = np.array([0.6, 0.8, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    tangent = np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * up
    normal = -np.sin(angle)[:, None] * along + np.cos(angle)[:, None] * up
    field = np.sin(np.arange(20))[:, None, None] * normal
    raw = xr.Dataset({"static_tangent": (("node", "axis"), tangent), "transverse": (("time", "node", "axis"), field)})
    dots = np.einsum("na,na->n", directions(raw), normal)
    assert np.abs(dots) == pytest.approx(1.0)
    assert len(set(np.sign(dots))) == 1


@pytest.mark.parametrize("seed", range(5))
def test_marked_jumps_are_the_counted_ones(seed):
    """A wandering mass: passages of mid-stroke are marked just where the metric counts a jump."""
    steps = np.random.default_rng(seed).standard_normal(4000)
    y = np.convolve(steps, np.ones(80) / 80, mode="valid")
    y0 = 1.2 * float(y.std())
    found = jump_samples(y, y0)
    assert len(found) == count_jumps(y, y0) > 0
    assert all(y[i - 1] * y[i] <= 0 for i in found)


def test_spectrum_and_wavelet_see_the_frequency(reduced):
    spectra = spectrum(reduced)
    peak = float(spectra["frequency"][int(spectra["displacement"].values.argmax())])
    assert peak == pytest.approx(2.0, abs=0.25)  # one bin of a record of 4 s
    assert spectra["displacement"].attrs["units"] == "m"
    transform = wavelet(reduced)
    power = (transform["baseline_displacement"].values ** 2).sum(axis=1)
    assert float(transform["frequency"][int(power.argmax())]) == pytest.approx(2.0, rel=0.1)
    with pytest.raises(ValueError, match="too few"):
        spectrum(reduced.isel(time=slice(0, 5)))


def test_amplitude_of_a_sine_on_the_grid():
    t = np.arange(512) / 64
    x = np.outer(0.3 * np.sin(2 * np.pi * 4 * t), [1.0, 1.0])
    made = xr.Dataset({"displacement": (("time", "node"), x), "arc": ("node", [0.0, 1.0])}, coords={"time": t})
    assert float(spectrum(made)["displacement"].sel(frequency=4.0)) == pytest.approx(0.3)


def test_force_laws():
    """Springs are eq. (2.2.2); cords are the same outside the dead band and nothing inside."""
    laws = force_laws((0.0, 2.0, 11.48), k=2e4, half_span=0.05)
    for i, angle in enumerate(np.radians([0.0, 2.0, 11.48])):
        y = laws["x"].values[i] + 0.05 * math.tan(angle)
        expected = 2 * 2e4 * (1 - 0.05 / math.cos(angle) / np.sqrt(0.05**2 + y**2)) * y
        springs, cords = laws["force"].values[:, i]
        assert springs == pytest.approx(expected, abs=1e-9)
        outside = np.abs(y) > 0.05 * math.tan(angle) + 1e-12
        assert cords[outside] == pytest.approx(springs[outside], abs=1e-9)
        assert not np.any(cords[~outside])
    sink = BNES(s=0, mass=1, EA=1, length=0.05 / math.cos(math.radians(2)), phi0=2)
    assert float(laws["rest_offset"][1]) == pytest.approx(sink.rest_offset)


# --------------------------------------------------------------------------- folders


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(EVALUATOR, "solve", fake_solve)
    clear_baselines()
    prepare(STUDY, tmp_path)
    yield tmp_path
    clear_baselines()


def test_a_folder_keeps_its_histories(folder, monkeypatch):
    asked = []

    def counted(point):
        asked.append(point.key)
        return evaluate_with_series(point)

    monkeypatch.setattr(module, "evaluate_with_series", counted)
    key = make_plan(STUDY).keys[1]
    first, second = series_of(folder, key), series_of(folder, key)
    assert asked == [key]
    xr.testing.assert_allclose(first, second)
    assert [path.name for path in (folder / "series").iterdir()] == [f"{key}.nc"]
    monkeypatch.setattr(module, "SOURCE_HASH", "another version")
    series_of(folder, key)
    assert asked == [key, key]


def test_a_point_without_history_says_why(folder, monkeypatch):
    def broken(scene, ask):
        raise ValueError("on purpose")

    with pytest.raises(ValueError, match="has no point nobody"):
        series_of(folder, "nobody")
    monkeypatch.setattr(EVALUATOR, "solve", broken)
    with pytest.raises(ValueError, match=r"leaves no history: ERROR.*on purpose"):
        series_of(folder, make_plan(STUDY).keys[0])


def test_the_chosen_point():
    def results(*status):
        data = {"key": ("point", ["a", "b"]), "status": ("point", list(status)), "delta": ("point", [0.2, 0.1])}
        return xr.Dataset(data, attrs={"objectives": '["delta"]'})

    assert chosen_key(results("OK", "OK")) == "b"
    assert chosen_key(results("OK", "ENERGY_OPEN")) == "a"
    assert chosen_key(results("DIVERGED", "ENERGY_OPEN")) == "b"
    with pytest.raises(ValueError, match="no point has metrics yet"):
        chosen_key(results("DIVERGED", "MISSING"))
