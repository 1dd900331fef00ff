"""Stability maps: outcomes by their definition, steps about the limit, files, figure, and mistakes of the command."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner

from solvers import Ask, Response, Status
from sweep import stability
from sweep.cli import app
from sweep.config import ConfigError
from sweep.stability import (
    ALL,
    Job,
    Over,
    Truth,
    ask_of,
    checked,
    false_alarms,
    outcome,
    placed,
    settings_of,
    spread,
    summary,
)

ROOT = Path(__file__).resolve().parents[2]
T = np.linspace(0, 1, 11)


def response(shift: float, status: Status = Status.OK, residual: float = 1e-6, estimate: float = math.nan) -> Response:
    """A wave of one node whose phase is off."""
    x = np.zeros((len(T), 2, 3))
    x[:, 1, 0] = np.sin(2 * math.pi * T + shift)
    signals = {"position": x, "static_position": np.zeros((2, 3))}
    return Response(status=status, t=T, signals=signals, energy_residual=residual, estimated_error=estimate)


TRUTH = Truth(response(0.0), 1e-4, "")


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        (response(0.0), "good"),
        (response(0.2), "inaccurate"),
        (response(0.2, estimate=0.3), "good"),  # it promised no more
        (response(0.0, residual=2e-3), "inaccurate"),
        (response(0.0, residual=math.nan), "inaccurate"),
        (response(0.0, Status.COARSE_STEP), "false alarm"),
        (response(0.2, Status.COARSE_STEP), "coarse step"),
        (response(0.2, Status.COARSE_STEP, estimate=0.3), "coarse step"),  # its estimate does not excuse an alarm
        (response(0.0, Status.ENERGY_OPEN, residual=2e-3), "energy open"),
        (response(0.0, Status.UNRESOLVED), "unresolved"),
        (response(0.0, Status.UNSTABLE), "unstable"),
        ("refused: why", "refused"),
    ],
)
def test_outcome(run: Response | str, expected: str) -> None:
    """A phase error of 0.2 rad is a relative error of 0.2 of the waveform; 5 % is asked."""
    assert outcome(run, TRUTH, Over())[0] == expected


def test_a_reference_that_is_not_known_judges_nothing() -> None:
    vague = TRUTH._replace(uncertainty=0.02)  # more than a fifth of 5 %
    assert outcome(response(0.2), vague, Over())[0] == "no reference"
    assert outcome(response(0.2, Status.DIVERGED), vague, Over())[0] == "diverged"


def test_steps_about_the_limit() -> None:
    """From 0.05 to 4 times the limit; an implicit method about the limit of transverse waves; tolerances in decades."""
    known = dict.fromkeys(ALL, 1e-3) | {"genalpha 0.8": math.inf}
    over = Over(steps=5, duration=1.0)
    step = settings_of("rk4", known, 1e-2, over)
    assert step[0] == pytest.approx((5e-5, 0.05))
    assert step[-1] == pytest.approx((4e-3, 4.0))
    own = settings_of("srkn4", known, 1e-2, over)
    assert np.isnan(own[0]).all()
    assert own[1:] == step
    assert ask_of(Job("lumped", "srkn4", 0.0, *own[0], 1e-3), Ask(step=0.1)).step is None  # the mesh's
    assert settings_of("genalpha 0.8", known, 1e-2, over)[-1][0] == pytest.approx(4e-2)
    np.testing.assert_allclose([x for x, _ in settings_of("trbdf2", known, 1e-2, over)], np.geomspace(1e-2, 1e-8, 5))


def test_values_over_a_range() -> None:
    assert spread(1.0, 100.0, 3) == (1.0, 10.0, 100.0)
    assert spread(-1.0, 1.0, 3) == (-1.0, 0.0, 1.0)


def test_summary_counts_alarms_against_good_runs() -> None:
    rows = [{"method": "rk4", "outcome": name} for name in ("good", "good", "good", "false alarm", "diverged")]
    names, table = summary(rows)
    assert dict(zip(names, table[-1], strict=True)) == {
        "method": "all", "runs": "5", "good": "3", "inaccurate": "0", "false alarm": "1", "diverged": "1",
    }  # fmt: skip
    assert false_alarms(rows) == 0.25


def test_a_field_of_the_scene_and_of_the_ask() -> None:
    scene, _ = stability.load(ROOT / "configs" / "scenes" / "jumper.yaml")
    changed, _ = placed(scene, Ask(), Over(field="cable[0].EI"), 5.0)
    assert changed.cable[0].EI == 5.0
    same, ask = placed(scene, Ask(segments=10), Over(field="ask.segments"), 20.0)
    assert (same, ask.segments) == (scene, 20)
    for field, value in (("cable[0].XY", 1.0), ("cable[0].EA", -1.0)):
        with pytest.raises(ConfigError):
            placed(scene, Ask(), Over(field=field), value)


def test_all_mistakes_of_a_command_at_once() -> None:
    with pytest.raises(ConfigError) as error:
        checked(replace(Over(), models=("lumpd",), methods=("euler",), steps=1, field="cable[0].EI"))
    for word in ("lumpd", "euler", "--steps", "--range"):
        assert word in str(error.value)


def run(*options: Any) -> Any:
    return CliRunner().invoke(app, ["stability", *map(str, options)])


def test_the_command(tmp_path: Path) -> None:
    """A jumper at two stiffnesses by two methods: the files hold the same runs, the figure is drawn, and rk4 diverges
    above its limit, while what is good lies below 1.5 of it."""
    scene = ROOT / "configs" / "scenes" / "jumper.yaml"
    ended = run(
        scene, "--out", tmp_path, "--over", "cable[0].EA", "--range", 1e8, 5e8, "--points", 2, "--steps", 4,
        "--duration", 5, "--segments", 12, "--method", "rk4", "--method", "dopri5",
    )  # fmt: skip
    assert ended.exit_code == 0, ended.output
    frame = pd.read_csv(tmp_path / "stability.csv")
    data = xr.load_dataset(tmp_path / "stability.nc")
    assert len(frame) == data.sizes["run"] == 16
    assert (tmp_path / "stability.png").stat().st_size > 10_000
    fixed = frame[frame["method"] == "rk4"]
    assert set(fixed[fixed["multiple"] > 3]["outcome"]) == {"diverged"}
    good = fixed[fixed["outcome"] == "good"]
    assert len(good)
    assert (good["setting"] < 1.5 * good["limit"]).all()
    assert not (frame["outcome"] == "inaccurate").any()
    assert data["limit"].attrs["units"] == "s"
    assert "good runs that were called bad" in ended.output
