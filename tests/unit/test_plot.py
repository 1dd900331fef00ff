"""Figures: each kind draws what it is given, says units, shows what is not trusted, and clips nothing."""

from __future__ import annotations

import json
import re

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from test_rods import profiles

from sweep import plot
from sweep.labels import STYLE, label, metric_label, symbol
from sweep.plot import PLOTS, plot_ea, plot_front, plot_parallel, points_of, save_plot
from sweep.series import force_laws, orders, power, spectrum, stroke_wavelets, wavelet

SENTENCE = re.compile(r"^[^\n]{10,200}$")


def study(n=24, objectives=("delta", "gamma", "t_settle"), variables=("EA1", "EA2"), seed=0):
    """Random results: two untrusted points, one far off, a failed and a missing one."""
    draw = np.random.default_rng(seed)
    status = np.array(["OK"] * n, dtype=object)
    columns = {
        "delta": draw.uniform(0.5, 0.9, n),
        "gamma": draw.uniform(-0.3, 0.4, n),
        "t_settle": draw.uniform(1, 4, n),
        "rms": draw.uniform(0.01, 0.02, n),
        "t_first": np.full(n, np.inf),
    }
    if n > 8:
        status[:4] = "ENERGY_OPEN", "UNRESOLVED", "DIVERGED", "MISSING"
        columns["delta"][1] = 47000.0
        for values in columns.values():
            values[2:4] = np.nan
    keys = np.array([f"{i:04x}" for i in range(n)], dtype=object)
    data = {name: ("point", values) for name, values in columns.items()}
    coords = {"design": ("point", np.arange(n))}
    for name in variables:
        coords[name] = ("point", 10 ** draw.uniform(4, 10, n), {"units": "N"})
    return xr.Dataset(
        data | {"status": ("point", status), "key": ("point", keys)},
        coords=coords,
        attrs={"objectives": json.dumps(list(objectives))},
    )


def series(**attrs):
    """Two seconds of a hanging cable with a bistable sink, a tuned damper and a fixed mass."""
    t, arc = np.linspace(0, 2, 401), np.linspace(0, 10, 11)
    decay = np.exp(-t)
    x = np.outer(decay * np.sin(4 * np.pi * t), np.sin(np.pi * arc / 10))
    stroke = np.stack([0.03 * np.cos(2 * np.pi * t), 0.02 * np.cos(9 * t), 0 * t], axis=1)
    passages = np.diff(np.sign(stroke), axis=0, prepend=1.0) != 0
    metre, joule, pure = ({"units": unit} for unit in ("m", "J", "1"))
    data = {
        "arc": ("node", arc, metre),
        "depth": ("node", 20 - arc, metre),
        "displacement": (("time", "node"), 0.5 * x, metre),
        "tension": ("time", 5e3 + 2e3 * np.sin(4 * np.pi * t) + 30 * np.cos(8 * np.pi * t), {"units": "N"}),
        "baseline_arc": ("baseline_node", arc, metre),
        "baseline_displacement": (("time", "baseline_node"), x, metre),
        "stroke": (("time", "device"), stroke, metre),
        "rest_offset": ("device", [0.03, 0.0, 0.0], metre),
        "device_s": ("device", [2.0, 5.0, 8.0], metre),
        "device_kind": ("device", np.array(["bnes", "tmd", "mass"], dtype=object)),
        "jump": (("time", "device"), passages.astype("i1"), pure),
        "G": ("time", 0.95 * (1 - decay), pure),
        "share": ("time", 1 - decay**2, pure),
        "residual": ("time", 1e-4 * t, pure),
        "lost_water": ("time", 3 - 3 * decay**2, joule),
        **dict.fromkeys(("kinetic", "mechanical"), ("time", 3 * decay**2, joule)),
        **dict.fromkeys(
            ("strain", "gravity", "work", "lost_cable", "lost_device", "lost_seabed", "rotation"),
            ("time", 0 * t, joule),
        ),
    }
    about = {"status": "OK", "baseline": "locked", "probe": 3.3, "pulse_end": 0.5, "design": 3, "key": "abcd"}
    about |= {"metric_t_first": np.inf, "metric_t_settle": 1.15, "metric_t_energy": 1.15, "devices": 3}
    return xr.Dataset(data, coords={"time": ("time", t, {"units": "s"})}, attrs=about | attrs)


def loops(**changes):
    """A loop of harmonic balance and two of a march, that nearly agree."""
    phase = np.linspace(0, 2 * np.pi, 101)
    way, pull = 0.02 * np.sin(phase), 5e3 + 2e3 * np.cos(phase + 0.3)
    metre = {"units": "m", "long_name": "displacement of end B"}
    newton = {"units": "N", "long_name": "tension at end B"}
    data = {
        "displacement": ("phase", way, metre),
        "tension": ("phase", pull, newton),
        "march_displacement": (("march_period", "phase"), np.stack([0.9 * way, way]), metre),
        "march_tension": (("march_period", "phase"), np.stack([pull, pull + 1]), newton),
    }
    about = {"period": 2.0, "harmonic_status": "OK", "march_status": "OK", "gap": 2.5e-4, "key": "abcd", "design": 3}
    return xr.Dataset(data, attrs=about | {"harmonic": "OK", "march": "OK"} | changes)


def response(panels=2, curves=3):
    """Curves that bend over, unstable between their folds; the last one stops short."""
    arc = np.linspace(0, 1, 61)
    f = 1 + arc + 0.4 * np.sin(2 * np.pi * arc)
    turns = np.zeros(61, dtype="i1")
    turns[[21, 40]] = 1
    shape = (panels, curves, 61)
    size = np.arange(1, curves + 1)[:, None]
    x = np.broadcast_to(f, shape).copy()
    x[-1, -1, 50:] = np.nan
    y = np.where(np.isnan(x), np.nan, 3e3 * size * np.exp(-((arc - 0.4) ** 2) / 0.05))
    rows = (panels, curves, 5)
    note = np.full((panels, curves), "", dtype=object)
    note[-1, -1] = "the arc's step fell below 1e-05 at 1.8"
    trusted = np.broadcast_to(np.array([1, 1, 0, 0, 1], dtype="i1"), rows)
    about = {"units": "N", "long_name": "tension at end B, half range"}
    hertz = {"units": "Hz", "long_name": "frequency"}
    return xr.Dataset(
        {
            "parameter": (("panel", "curve", "along"), x, hertz),
            "half_range": (("panel", "curve", "along"), y, about),
            "stable": (("panel", "curve", "along"), np.broadcast_to(((arc < 0.35) | (arc > 0.65)).astype("i1"), shape)),
            "trusted": (("panel", "curve", "along"), np.ones(shape, dtype="i1")),
            "fold": (("panel", "curve", "along"), np.broadcast_to(turns, shape)),
            "row_parameter": (("panel", "curve", "row"), np.broadcast_to(np.linspace(1, 2, 5), rows), hertz),
            "row_half_range": (("panel", "curve", "row"), np.where(trusted, 1e3, np.nan), about),
            "row_trusted": (("panel", "curve", "row"), trusted),
            "row_failed": (("panel", "curve", "row"), np.broadcast_to(np.array([0, 0, 0, 1, 0], dtype="i1"), rows)),
            "others": ("curve", np.array([f"amplitude = {0.1 * k:.4g} m" for k in range(curves)], dtype=object)),
            "note": (("panel", "curve"), note),
            "environment": ("panel", np.array(["hung", "touchdown"][:panels], dtype=object)),
        },
        attrs={"study": "shaken", "curves_of": 10, "panels_of": panels},
    )


def environments(n=5):
    """The made-up series in several environments, as `across` gives them."""
    one, spectra = series(), spectrum(series())
    found = xr.Dataset(
        coords={
            "environment": [f"sea seed {i + 1}" for i in range(n)],
            "time": one["time"],
            "frequency": spectra["frequency"],
        },
        attrs={"s": 3.3, "design": 3, "baseline": "locked", "pulse_end": 0.5, "left_out": 2},
    )
    for name in ("displacement", "baseline_displacement"):
        history = np.stack([one[name].values[:, 3] * (1 + i) for i in range(n)])
        found[name] = (("environment", "time"), history, {"units": "m"})
        amplitudes = np.stack([spectra[name].values] * n)
        found[f"{name}_amplitude"] = (("environment", "frequency"), amplitudes, spectra[name].attrs)
    found["rms_probe_reduction"] = ("environment", [0.5, -0.2, np.nan, 0.0, 0.1][:n])
    found["status"] = ("environment", np.array(["OK", "OK", "ENERGY_OPEN", "OK", "OK"][:n], object))
    return found


def flows(devices=3):
    """Two devices that take what the cable loses, and a fixed mass that is not among them."""
    t = np.linspace(0, 2, 201)
    lost = np.stack([1 - np.exp(-t * k) for k in range(1, devices + 1)], axis=1)
    joule = {"units": "J"}
    ledger = {"lost_water": t, "lost_cable": 0.1 * t, "lost_seabed": 0 * t, "work": 9 * t}
    ledger["lost_device"] = lost.sum(axis=1)
    data = {name: ("time", values, joule) for name, values in ledger.items()}
    data |= dict.fromkeys(("device_energy", "device_lost", "passed"), (("time", "device"), lost, joule))
    data |= {"cable_energy": ("time", 5 * np.exp(-t), joule)}
    kinds = ("device", np.array(["bnes"] * devices, dtype=object))
    about = {"pulse_end": 0.5, "status": "OK", "key": "abcd", "design": 3, "devices": devices}
    coords = {"time": ("time", t, {"units": "s", "long_name": "time"}), "device": np.arange(devices) + 1}
    return xr.Dataset(data, coords=coords | {"device_kind": kinds}, attrs=about)


def modal_energies(baseline=True):
    t, f = np.linspace(0, 2, 201), np.array([1.0, 2, 4, 8, 16, 32, 64])
    energy = np.exp(-np.outer(t, np.ones(7))) / f**2
    above = np.array([8.0, 8 * np.sqrt(2), 16.0])
    data = {"frequency": ("mode", f, {"units": "Hz"}), "mechanical": ("time", 1.1 * energy.sum(axis=1))}
    for prefix in ("", "baseline_")[: 1 + baseline]:
        data[f"{prefix}modal_energy"] = (("time", "mode"), energy)
        data |= {f"{prefix}{name}": ("above", [0.3, 0.2, 0.1]) for name in ("before", "after")}
    coords = {"time": ("time", t, {"units": "s", "long_name": "time"}), "above": above}
    about = {"cut": above[1], "pulse_end": 0.5, "baseline": "locked", "key": "abcd", "design": 3, "status": "OK"}
    return xr.Dataset(data, coords=coords, attrs=about)


def tired():
    arc, damage = np.linspace(0, 10, 11), np.geomspace(1e-6, 1e-3, 11)
    data = {"range": ("bin", np.arange(5.0) * 20, {"units": "MPa"})}
    for prefix in ("", "baseline_"):
        data |= {f"{prefix}s": (f"{prefix}node", arc), f"{prefix}damage": (f"{prefix}node", damage)}
        data |= {f"{prefix}cycles": ("bin", [50.0, 20, 5, 1, 0]), f"{prefix}done": ("bin", [1e-5, 1e-4, 2e-4, 1e-4, 0])}
    about = {"error": 0.034, "device_s": [2.0, 5.0], "baseline": "locked", "key": "abcd", "design": 3, "status": "OK"}
    return xr.Dataset(data, attrs=about)


def probes(count=2):
    """The probe's displacement of a point, of its baseline and of others over it."""
    t = np.linspace(0, 2, 201)
    metre = {"units": "m", "which": "EA1 = 1e+06, lumped"}
    data = {"displacement": ("time", np.sin(9 * t), metre), "baseline_displacement": ("time", np.cos(9 * t))}
    data |= {f"over{i}_displacement": (f"over{i}_time", i * np.sin(8 * t), metre) for i in range(1, count + 1)}
    coords = {"time": ("time", t, {"units": "s"})} | {f"over{i}_time": t for i in range(1, count + 1)}
    about = {"s": 4.7, "pulse_end": 0.5, "baseline": "locked", "key": "abcd", "design": 3}
    return xr.Dataset(data, coords=coords, attrs=about)


def sensitivities(kind="saltelli", metrics=("delta", "gamma"), variables=("EA1", "EA2")):
    shape = (len(metrics), len(variables))
    names = {"saltelli": ("S1", "ST"), "morris": ("mu_star", "mu", "sigma")}[kind]
    data = {name: (("metric", "variable"), np.full(shape, 0.3 + 0.1 * i)) for i, name in enumerate(names)}
    data |= {f"{name}_conf": (("metric", "variable"), np.full(shape, 0.05)) for name in names}
    data |= {name: ("metric", [n] * shape[0]) for name, n in (("blocks", 64), ("complete", 60))}
    data["variance"] = ("metric", [1.0] * (shape[0] - 1) + [np.nan])
    coords = {"metric": list(metrics), "variable": list(variables)}
    return xr.Dataset(data, coords=coords, attrs={"kind": kind, "sampler": kind, "study": "shaken"})


DATA = {"loop": loops, "response": response}
DATA |= {"wavelet": lambda: wavelet(series()), "spectrum": lambda: spectrum(series())}
DATA |= {"power": lambda: power(series()), "stroke-wavelet": lambda: stroke_wavelets(series())}
DATA |= {"fatigue": tired, "flow": flows, "modes": modal_energies, "compare": probes, "sensitivity": sensitivities}
DATA |= dict.fromkeys(("front", "parallel", "ea"), study)
DATA |= {"profile": profiles} | dict.fromkeys(("histories", "spectra"), environments)


def searched():
    """Three generations of a search, of which the first has no front."""
    columns = {"evaluations": [50.0, 100, 150], "hypervolume": [np.nan, 0.2, 0.3]}
    return xr.Dataset(
        {name: ("generation", np.array(values)) for name, values in columns.items()},
        attrs={"reference": '{"delta_ensemble": 0.7, "t_settle": 4.5}', "algorithm": "nsga2", "seed": 1},
    )


DATA |= {"hypervolume": searched}
DATA |= {"force-law": force_laws, "force-angle": lambda: force_laws((0.0, 5.0, 10.0))}


def drawn(kind, data=None):
    """A kind of figure, not yet laid out."""
    figure = Figure(layout="constrained")
    with matplotlib.rc_context(STYLE):
        PLOTS[kind].draw(DATA.get(kind, series)() if data is None else data, figure)
    return figure


def words(figure):
    return " | ".join(text.get_text() for text in figure.findobj(matplotlib.text.Text))


@pytest.mark.parametrize("kind", PLOTS)
def test_every_kind_draws_within_its_paper(kind):
    figure = drawn(kind)
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    # 0.05 inch: the layout's own padding
    assert box.x0 > -0.05
    assert box.x1 < width + 0.05
    assert box.y0 > -0.05
    assert box.y1 < height + 0.05


@pytest.mark.parametrize("kind", PLOTS)
def test_labels_have_units(kind):
    figure = drawn(kind)
    texts = [ax.get_xlabel() for ax in figure.axes] + [ax.get_ylabel() for ax in figure.axes]
    texts.append(figure.get_supylabel())
    if kind == "parallel":
        texts += [tick.get_text() for tick in figure.axes[0].get_xticklabels()]
    texts = [text for text in texts if text]
    assert len(texts) >= 2
    assert all(re.search(r"\[[^\]]+\]", text) for text in texts), texts


@pytest.mark.parametrize("kind", ["front", "ea", "parallel"])
def test_untrusted_and_failed_points_are_visible_as_such(kind):
    text = words(drawn(kind))
    for part in ("trusted (20)", "untrusted (2)", "1 failed", "1 not run"):
        assert part in text


def test_markers_differ():
    """Untrusted points are crosses; front points are outlined; the best is a star; nothing is drawn twice."""
    ax = drawn("front").axes[0]
    points = points_of(study())
    sizes = [len(c.get_offsets()) for c in ax.collections]
    shapes = [len(c.get_paths()[0].vertices) for c in ax.collections]
    assert sizes == [20 - points.front.size, 1, points.front.size - 1, 1]  # the other untrusted one is far off
    assert len({shapes[0], shapes[1], shapes[3]}) == 3
    assert ax.collections[2].get_edgecolor()[0] == pytest.approx([0, 0, 0, 1])


def test_an_untrusted_point_far_off_does_not_set_the_axes():
    figure = drawn("front")
    assert figure.axes[0].get_xlim()[1] < 1.2
    assert "1 untrusted beyond the axes" in words(figure)


def test_the_colour_is_logarithmic_and_can_be_chosen():
    colours = plot_front(study(), Figure(layout="constrained"), colour="EA2").axes[0].collections[0]
    assert isinstance(colours.norm, matplotlib.colors.LogNorm)
    assert colours.norm.vmax == pytest.approx(study()["EA2"].max())
    with pytest.raises(ValueError, match="no design variable `EA9`; there are EA1, EA2"):
        plot_front(study(), Figure(), colour="EA9")


@pytest.mark.parametrize(
    ("objectives", "panels"),
    [
        (("delta",), 2),
        (("delta", "gamma"), 1),
        (("delta", "gamma", "rms"), 4),
        (("delta", "gamma", "rms", "t_settle"), 7),
    ],
)
def test_any_number_of_objectives(objectives, panels):
    figure = drawn("front", study(objectives=objectives))
    assert sum(ax.get_label() != "<colorbar>" for ax in figure.axes) == panels


@pytest.mark.parametrize("kind", ["front", "ea", "parallel"])
@pytest.mark.parametrize("variables", [(), ("EA1",)])
@pytest.mark.parametrize("n", [1, 2])
def test_few_points_and_variables(kind, variables, n):
    """Drawn, or refused in a sentence where there is nothing to compare."""
    if (kind == "ea" and not variables) or (kind == "parallel" and n == 1):
        with pytest.raises(ValueError, match=r"no design variables|compare designs"):
            drawn(kind, study(n=n, variables=variables))
    else:
        drawn(kind, study(n=n, variables=variables))


@pytest.mark.parametrize("kind", ["front", "ea", "parallel"])
def test_only_untrusted_points(kind):
    data = study()
    data["status"][data["status"] == "OK"] = "ENERGY_OPEN"
    assert "untrusted (22)" in words(drawn(kind, data))


def test_environments_and_error_bars():
    """A design counts as its worst environment; its objectives are means; spreads are bars on the front."""
    n = 6
    values = np.linspace(0.3, 0.8, 2 * n).reshape(n, 2)
    status = np.full((n, 2), "OK", dtype=object)
    status[2, 1], status[3, 0] = "ENERGY_OPEN", "DIVERGED"
    dims = ("design", "environment")
    data = xr.Dataset(
        {
            "status": (dims, status),
            "delta": (dims, values),
            "gamma": (dims, values),
            "delta_spread": (dims, np.full((n, 2), 0.02)),
        },
        coords={"design": np.arange(n), "environment": ["calm", "rough"]},
        attrs={"objectives": '["delta", "gamma"]'},
    )
    points = points_of(data)
    assert points.kinds.tolist() == ["trusted", "trusted", "untrusted", "failed", "trusted", "trusted"]
    assert points.values["delta"] == pytest.approx(values.mean(axis=1))
    assert len(drawn("front", data).axes[0].containers) == points.front.size == 4


@pytest.mark.parametrize(
    ("function", "data", "match"),
    [
        (plot_front, lambda: study(objectives=()), "no objectives"),
        (plot_ea, lambda: study(objectives=("t_first",)), "no point has finite t_first"),
        (plot_parallel, lambda: study(objectives=("stroke", "delta")), "hold no metric `stroke`"),
        (plot.plot_gt, lambda: series().drop_vars("G"), "hold no G"),
        (plot.plot_stroke, lambda: series().drop_vars("stroke"), "no device"),
        (plot.plot_energy, lambda: series().drop_vars("work"), "hold no work"),
    ],
)
def test_nothing_to_draw_is_a_sentence(function, data, match):
    with pytest.raises(ValueError, match=match) as caught:
        function(data())
    assert SENTENCE.match(str(caught.value))


@pytest.mark.parametrize("kind", ["history", "stroke", "envelope", "gt", "energy"])
def test_an_untrusted_history_says_so(kind):
    assert "untrusted: ENERGY_OPEN" in words(drawn(kind, series(status="ENERGY_OPEN")))


def test_a_periodic_response_shows_its_harmonics():
    """Two seconds hold four periods of 0.5 s; the tension has two harmonics and its mean, in kN."""
    settled = {"period": 0.5, "method": "harmonic", "harmonics": 4, "ramped": 0.0, "status": "UNSTABLE"}
    figure = drawn("spectrum", orders(series(**settled)))
    text = words(figure)
    for part in ("untrusted: UNSTABLE", "mean 5 kN", "2 Hz", "multiple of the base frequency", "not periodic"):
        assert part in text
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    assert heights[:2] == pytest.approx([2e3, 30.0])
    assert max(heights[2:]) < 1e-5  # bars of nothing stand on a log axis
    assert len(figure.axes[1].patches) == 8  # with devices and the baseline
    figure.draw_without_rendering()


def test_a_loop_says_how_its_runs_ended():
    assert "0.025 % of the tension's range" in words(drawn("loop"))
    found = loops(harmonic="no convergence of it", status="UNSTABLE", march_status="ENERGY_OPEN").drop_vars("tension")
    text = words(drawn("loop", found))
    assert "no harmonic: no convergence of it" in text
    assert "last period (ENERGY_OPEN)" in text
    assert "untrusted: UNSTABLE" in text
    assert "displacement of end B [mm]" in text


def test_a_response_shows_stability_folds_and_rows():
    figure = drawn("response")
    text = words(figure)
    for part in ("18 of the 30 rows", "6 failed", "3 of 10 curves", "hung", "touchdown", "half range [kN]"):
        assert part in text
    lines = figure.axes[0].lines
    assert {line.get_linestyle() for line in lines} == {"-", "--", "None"}
    folds = [line for line in lines if line.get_marker() == "D"]
    assert [len(line.get_xdata()) for line in folds] == [2, 2, 2]
    assert sum(str(line.get_markerfacecolor()) == "white" for line in lines if line.get_marker() == "o") == 3
    assert "not followed further" in text


@pytest.mark.parametrize(("panels", "curves"), [(1, 1), (1, 6), (3, 2), (4, 6)])
def test_responses_fit_their_paper(panels, curves):
    names = ["one", "two", "three", "four"][:panels]
    found = response(2, curves).isel(panel=[0, 1, 0, 1][:panels]).assign(environment=("panel", np.array(names, object)))
    figure = drawn("response", found)
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    assert box.x0 > -0.05
    assert box.x1 < figure.get_size_inches()[0] + 0.05
    assert all(ax.get_position().height > 0.2 for ax in figure.axes)


def test_a_hypervolume_needs_a_front():
    said = words(drawn("hypervolume"))
    assert "0.3" in said
    assert "Δ, ensemble = 0.7" in said
    with pytest.raises(ValueError, match="no generation has a front"):
        drawn("hypervolume", searched().isel(generation=[0]))


def test_all_leaves_out_what_is_dear():
    assert [name for name, entry in PLOTS.items() if entry.dear] == [
        "response", "histories", "spectra", "sensitivity",
    ]  # fmt: skip


def test_environments_say_what_became_of_them():
    text = words(drawn("histories"))
    for part in ("RMS 50% less", "RMS 20% more", "untrusted: ENERGY_OPEN", "2 more environments not shown"):
        assert part in text
    alone = environments(1).drop_vars(["baseline_displacement", "baseline_displacement_amplitude"])
    assert all("baseline" not in words(drawn(kind, alone)) for kind in ("histories", "spectra"))


def test_a_flow_says_both_losses():
    text = words(drawn("flow"))
    assert "sum of the devices' losses 2.844 J, ledger 2.844 J" in text
    assert "lost to the bed" not in text


def test_modes_say_how_much_is_above():
    text = words(drawn("modes"))
    assert "baseline 20 % in the pulse, 20 % after it; design 20 % in the pulse" in text
    assert "above 11.3 Hz [%]" in text
    assert "baseline" in words(drawn("modes", modal_energies(baseline=False)))  # in the legend alone


def test_stroke_wavelets_show_the_devices_that_move():
    figure = drawn("stroke-wavelet")
    assert [ax.get_title(loc="left") for ax in figure.axes[:2]] == ["device 1 (bnes)", "device 2 (tmd)"]
    with pytest.raises(ValueError, match="no device"):
        stroke_wavelets(series().drop_vars("stroke"))


def test_the_power_is_that_after_the_pulse():
    assert power(series()).attrs["start"] == 0.5
    assert power(series(pulse_end=1.8)).attrs["start"] == 0.0  # too little is left
    found = power(series(pulse_end=0.0))
    f = found["frequency"].values
    assert f[int(found["displacement"].values.argmax())] == pytest.approx(2.0, abs=1 / 0.8)  # one bin


@pytest.mark.parametrize("kind", ["saltelli", "morris"])
@pytest.mark.parametrize("count", [1, 4])
def test_sensitivities_fit_their_paper(kind, count):
    metrics, variables = ("delta", "gamma", "rms", "t_settle")[:count], tuple(f"EA{i}" for i in range(2 * count))
    figure = drawn("sensitivity", sensitivities(kind, metrics, variables))
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    assert box.x0 > -0.05
    assert box.x1 < figure.get_size_inches()[0] + 0.05
    assert "no indices" in words(figure)
    assert "60 of 64" in words(figure)


@pytest.mark.parametrize("kind", ["history", "envelope"])
def test_without_a_baseline(kind):
    alone = series().drop_vars(["baseline_displacement", "baseline_arc", "device_s", "device_kind"])
    assert "baseline" not in words(drawn(kind, alone))


def test_stroke_marks_jumps_and_leaves_out_fixed_masses():
    figure = drawn("stroke")
    assert [ax.get_title(loc="left") for ax in figure.axes] == [
        "device 1 (bnes) at s = 2.00 m: 4 cross-well jumps",
        "device 2 (tmd) at s = 5.00 m: one well",
    ]
    assert len(figure.axes[0].collections[0].get_segments()) == 4


def test_gt_marks_the_metrics():
    assert "1.150 s" in words(drawn("gt"))
    assert "never reaches 0.9" in words(drawn("gt"))
    assert "= 1.500 s" in words(drawn("gt", series(metric_t_first=1.5)))


def test_words():
    assert metric_label("delta") == "Δ [-]   ← better"
    assert metric_label("gamma_worst", ("less", "more"), ", ") == "Γ, worst [-], more"
    assert metric_label("peak_curvature", ("", "")) == "peak curvature [1/m]"
    assert symbol("rms_probe") == "rms probe"
    assert label(xr.DataArray(0.0, attrs={"units": "m3"}), "volume") == "volume [m³]"


def test_a_figure_of_a_folder(tmp_path, monkeypatch):
    from matplotlib import pyplot

    monkeypatch.setitem(PLOTS, "front", PLOTS["front"]._replace(data=lambda directory: study()))
    path = save_plot(tmp_path, "front")
    assert path == tmp_path / "figures" / "front.png"
    assert path.read_bytes()[:4] == b"\x89PNG"
    assert [each.name for each in path.parent.iterdir()] == ["front.png"]
    assert pyplot.get_fignums() == []
    with pytest.raises(ValueError, match="no figure is called `fornt`; there are front, "):
        save_plot(tmp_path, "fornt")


def test_a_notebook_gets_its_own_figures():
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    try:
        ax = plot.plot_gt(series())
        assert ax.figure.number in pyplot.get_fignums()
        assert plot.plot_gt(series(), ax) is ax
        assert len(pyplot.get_fignums()) == 1
    finally:
        pyplot.close("all")
