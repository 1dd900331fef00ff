"""The audit of a study: by what it is run, what it compares, who stays on the front, and that no row of it changes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from study_kit import scene

from solvers import Ask
from sweep import evaluate, open_study, report, run
from sweep.audit import Wanted, audit, audit_points, compared, costlier, next_model, picked
from sweep.config import ConfigError, load_study
from sweep.plan import read_plan
from sweep.store import StoreError, study_of

TINY = Path(__file__).parent / "tiny.yaml"
ASK = Ask(duration=1.0)


def row(model: str, method: str = "dopri5", segments: int = 20, tolerance: float = 1e-4) -> dict[str, object]:
    return {"model": model, "method": method, "segments": segments, "tolerance": tolerance}


# ----------------------------------------------------------------------------------------------- by what


@pytest.mark.parametrize(
    ("devices", "used", "found"),
    [
        (None, "transverse", "lumped"),  # with a sink: elements of order 4 have none
        ((), "transverse", "hermite"),
        ((), "local", "lumped"),
        ((), "catenary", "hybrid"),
        ((), "hybrid", "rod"),
        ((), "rod", "rod"),
        (None, "lumped", "lumped"),
    ],
)
def test_the_next_costlier_line(devices, used, found):
    assert next_model(scene(devices), ASK, used) == found


def test_a_line_without_a_next_one_is_audited_finer():
    asked = costlier(scene(), ASK, row("lumped"), Wanted())
    assert (asked.model, asked.method, asked.segments) == ("lumped", "dopri5", 40)
    assert asked.tolerance == pytest.approx(1e-5)
    fixed = costlier(scene(), replace(ASK, step=1e-3), row("lumped", "genalpha", tolerance=math.nan), Wanted())
    assert (fixed.method, fixed.step, fixed.tolerance) == ("genalpha", 5e-4, None)


def test_a_line_of_lower_order_gets_a_finer_mesh_and_a_method_that_it_has():
    asked = costlier(scene(), ASK, row("transverse", segments=32), Wanted())
    assert (asked.model, asked.method, asked.segments, asked.tolerance) == ("lumped", "dopri5", 128, 1e-4)
    asked = costlier(scene(()), ASK, row("transverse", "rk4", 32, math.nan), Wanted())
    assert (asked.model, asked.method, asked.segments, asked.step) == ("hermite", "esdirk4", 32, None)
    asked = costlier(scene(()), replace(ASK, rods=((0.0, 1.0),)), row("hybrid", "trbdf2"), Wanted(segments=50))
    assert (asked.model, asked.method, asked.segments, asked.rods) == ("rod", "trbdf2", 50, None)
    asked = costlier(scene(()), ASK, row("local", "harmonic", 40, 5e-4), Wanted())
    assert (asked.model, asked.method, asked.segments) == ("lumped", "harmonic", 40)


@pytest.mark.parametrize(("model", "segments"), [(None, 128), ("transverse", 64)])
def test_what_a_study_slows_its_audit_does_not(model, segments):
    ask = replace(ASK, model="transverse", mass_scaling=3.6)
    asked = costlier(scene(), ask, row("transverse", segments=32), Wanted(model=model))
    assert (asked.segments, asked.mass_scaling) == (segments, None)


@pytest.mark.parametrize(("model", "why"), [("spring", "no such model"), ("hermite", "cannot represent")])
def test_a_model_that_cannot(model, why):
    with pytest.raises(ConfigError, match=f"(?s){why}.*lumped"):
        costlier(scene(), ASK, row("lumped"), Wanted(model=model))


# ----------------------------------------------------------------------------------------------- what it compares


def results(status: list[str], **columns: list[float]) -> xr.Dataset:
    about = {name: ("point", np.array(values, dtype=float)) for name, values in columns.items()}
    n = len(status)
    about |= {"status": ("point", np.array(status, dtype=object))}
    for name, value in (("model", "lumped"), ("method", "dopri5"), ("message", ""), ("key", "x")):
        about[name] = ("point", np.array([value] * n, dtype=object))
    about |= {name: ("point", np.full(n, 1.0)) for name in ("segments", "tolerance", "seconds")}
    attrs = {"objectives": '["delta", "gamma"]'}
    return xr.Dataset(about, coords={"design": ("point", np.arange(n))}, attrs=attrs)


def test_differences_ranks_and_the_front_by_hand():
    """Designs 0, 1, 2 are the front; by the audit 1 is beaten by 3, a sample; design 4 is not audited."""
    data = results(
        ["OK"] * 5, delta=[0.1, 0.2, 0.3, 0.25, 9.0], gamma=[0.1, 0.2, 0.3, 0.15, 0.0],
        delta_spread=[0.005] * 5, t_first=[1.0, math.inf, math.inf, math.inf, 1.0],
    )  # fmt: skip
    designs, on_front = np.array([0, 1, 2, 3]), np.array([True, True, True, False])
    fine = results(
        ["OK"] * 4, delta=[0.1, 0.23, 0.3, 0.22], gamma=[0.1, 0.15, 0.3, 0.2],
        delta_spread=[0.005] * 4, t_first=[1.0, math.inf, 1.0, math.inf],
    )  # fmt: skip
    found = compared(data, fine, designs, on_front, ["delta", "gamma"]).set_index(metric="metric")
    assert found["stays"].values.tolist() == [True, False, True, True]
    delta, first = found.sel(metric="delta"), found.sel(metric="t_first")
    assert float(delta["rms"]) == pytest.approx(math.sqrt((0.03**2 + 0.03**2) / 4))
    assert float(delta["largest"]) == pytest.approx(0.03)
    assert float(delta["error_bar"]) == pytest.approx(0.01)
    assert float(delta["beyond"]) == 2
    assert float(delta["deviation"]) == pytest.approx(np.std([0.1, 0.2, 0.3, 0.25, 9.0]))
    assert float(delta["rank_correlation"]) == pytest.approx(1 - 6 * 2 / (4 * 15))  # ranks 1 2 4 3 and 1 3 4 2
    assert (float(first["n"]), float(first["one_only"]), float(first["rms"])) == (1, 1, 0)
    assert math.isnan(float(found.sel(metric="gamma")["error_bar"]))
    text = report.audited(compared(data, fine, designs, on_front, ["delta", "gamma"]), report.Console())
    assert "2 of its 3 designs" in text
    assert "1 of the others join it" in text
    assert "beyond its error bar" in text


def test_standard_uncertainties_are_error_bars_and_no_metrics():
    """Differences of 0.03 and 0.01 against 1.96 hypot(0.006, 0.008) = 0.0196; a spread is preferred."""
    columns = {"delta": [0.10, 0.20], "gamma": [0.1, 0.2], "gamma_spread": [0.1, 0.1], "gamma_sd": [0.0, 0.0]}
    data = results(["OK"] * 2, **columns, delta_sd=[0.006, 0.006])
    fine = results(["OK"] * 2, **(columns | {"delta": [0.13, 0.21]}), delta_sd=[0.008, 0.008])
    found = compared(data, fine, np.arange(2), np.ones(2, dtype=bool), ["delta", "gamma"]).set_index(metric="metric")
    assert list(found["metric"].values) == ["delta", "gamma"]
    assert float(found.sel(metric="delta")["error_bar"]) == pytest.approx(0.0196)
    assert found["beyond"].values.tolist() == [1, 0]
    assert float(found.sel(metric="gamma")["error_bar"]) == pytest.approx(0.2)


def test_what_the_audit_does_not_trust_is_compared_with_nothing():
    data = results(["OK"] * 3, delta=[0.1, 0.2, 0.3], gamma=[0.1, 0.2, 0.3])
    fine = results(["OK", "ENERGY_OPEN", "OK"], delta=[0.1, 99.0, 0.3], gamma=[0.1, 99.0, 0.3])
    found = compared(data, fine, np.arange(3), np.ones(3, dtype=bool), ["delta", "gamma"])
    assert found["n"].values.tolist() == [2, 2]
    assert found["largest"].values.tolist() == [0, 0]
    assert found["stays"].values.tolist() == [True, False, True]
    assert "ENERGY_OPEN" in report.audited(found, report.Console())


def test_the_sample_is_of_trusted_designs_beside_the_front():
    status = ["OK", "OK", "ENERGY_OPEN", *["OK"] * 7]
    data = results(status, delta=[0.1, *np.linspace(0.2, 1, 9)], gamma=[1.0, *np.zeros(9)])
    designs, on_front = picked(data, ["delta", "gamma"], Wanted(sample=4, seed=3))
    assert designs[on_front].tolist() == [0]
    assert len(designs) == 5
    assert 2 not in designs
    again, _ = picked(data, ["delta", "gamma"], Wanted(sample=4, seed=3))
    assert again.tolist() == designs.tolist()
    assert picked(data, ["delta", "gamma"], Wanted(sample=100))[0].tolist() == [0, 1, 3, 4, 5, 6, 7, 8, 9]


# ----------------------------------------------------------------------------------------------- the real thing


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("audited") / "out"
    run.run(load_study(TINY), run.Settings(directory=out))
    return out


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of the study itself."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path): path.read_bytes() for path in files if "audit" not in path.relative_to(folder).parts[0]}


def test_an_audit_runs_finer_resumes_and_leaves_the_study_alone(folder: Path) -> None:
    before = contents(folder)
    ended = audit(folder, Wanted(sample=1))
    assert (ended.exit_code, ended.interrupted) == (0, "")
    assert contents(folder) == before
    with xr.open_dataset(folder / "audit.nc") as stored:
        data = stored.load()
    assert set(data["segments"].values) == {20}
    assert set(data["study_segments"].values) == {10}
    assert int(data["on_front"].sum()) == data.sizes["point"] - 1
    assert float(data.set_index(metric="metric").sel(metric="delta")["rms"]) > 0
    study, plan = study_of(folder), read_plan(folder / "plan.json")
    designs = data["design"].values
    points = audit_points(study, plan, open_study(folder), designs, Wanted(sample=1))
    assert [point.key for point in points] == list(data["key"].values)
    assert evaluate(points[0]).metrics["delta"] == float(data["delta"][0])  # bit for bit what the evaluator gives
    journal = (folder / "audit/parts/journal-0.jsonl").read_bytes()
    assert audit(folder, Wanted(sample=1)).exit_code == 0
    assert (folder / "audit/parts/journal-0.jsonl").read_bytes() == journal
    with open_study(folder) as rows:
        assert rows.sizes["point"] == 6


def test_nothing_trusted_is_nothing_to_audit(folder: Path, tmp_path: Path) -> None:
    for name in ("study.yaml", "plan.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(StoreError, match="no trusted point"):
        audit(tmp_path, Wanted())
