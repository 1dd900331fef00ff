"""The commands, each as a user types it: exit codes, sentences, and no traceback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray as xr

from sweep import evaluate, load_study, open_study
from sweep.cli import main
from sweep.report import one_point
from sweep.space import points

HERE = Path(__file__).parent
TINY = HERE / "tiny.yaml"


class Ended(NamedTuple):
    """How a command ended."""

    returncode: int
    stdout: str
    stderr: str


def sweep(*words: object) -> Ended:
    """``python -m sweep`` with these words, in a process of its own."""
    ended = subprocess.run(
        [sys.executable, "-m", "sweep", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=HERE.parents[1],
    )
    assert "Traceback" not in ended.stderr
    return Ended(ended.returncode, ended.stdout, ended.stderr)


@pytest.fixture
def here(monkeypatch, capfd):
    """As ``sweep``, in this process: nothing is run that needs its signals or its log."""

    def call(*words: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["sweep", *map(str, words)])
        monkeypatch.setenv("COLUMNS", "120")
        with pytest.raises(SystemExit) as ended:
            main()
        return Ended(int(ended.value.code or 0), *capfd.readouterr())

    return call


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The tiny study, run serially."""
    out = tmp_path_factory.mktemp("tiny") / "out"
    ended = sweep("run", TINY, "--out", out)
    assert ended.returncode == 0, ended.stderr
    assert "results" in ended.stdout
    return out


def test_results_describe_themselves(folder):
    with xr.open_dataset(folder / "results.nc") as data:
        assert dict(data.sizes) == {"point": 6}
        assert data["EA1"].attrs["units"] == "N"
        assert data["delta"].attrs["direction"] == "min"
        assert all(data[name].attrs.get("long_name") for name in data.data_vars)
        assert data.attrs["study"].startswith("name: tiny")
        assert json.loads(data.attrs["objectives"]) == ["delta", "gamma"]
        assert json.loads(data.attrs["versions"])[0]["numpy"] == np.__version__
        assert set(data["status"].values) == {"OK"}


def test_a_second_run_has_nothing_to_do(folder):
    before = (folder / "parts/journal-0.jsonl").read_bytes()
    assert "0 to do" in sweep("run", TINY, "--out", folder).stderr
    assert (folder / "parts/journal-0.jsonl").read_bytes() == before


def test_slices_and_limits_make_the_same_dataset(here, folder, tmp_path):
    assert sweep("run", TINY, "--out", tmp_path, "--limit", 2).returncode == 0
    assert dict(open_study(tmp_path).sizes) == {"point": 2}
    for k in (1, 0):
        assert sweep("run", TINY, "--out", tmp_path, "--part", f"{k}/2").returncode == 0
    assert "complete" in here("status", tmp_path).stdout
    assert here("merge", tmp_path).stdout.strip() == str(tmp_path / "results.nc")
    cost = ["seconds", "first_seconds"]
    xr.testing.assert_identical(open_study(tmp_path).drop_vars(cost), open_study(folder).drop_vars(cost))


def test_planned_points_without_a_row_are_missing(here, tmp_path):
    assert sweep("run", TINY, "--out", tmp_path, "--part", "0/3").returncode == 0
    data = open_study(tmp_path)
    assert list(data["status"].values) == ["OK", "MISSING", "MISSING"] * 2
    assert np.isnan(data["delta"].values[1])
    assert "4 points to go" in here("status", tmp_path).stdout


def test_show_and_rerun(here, folder):
    shown = here("show", folder, "best").stdout
    key = next(line.split()[1] for line in shown.splitlines() if line.startswith("key"))
    assert "criterion" in shown
    assert here("show", folder, key[:8]).stdout.splitlines()[0].split()[1] == key
    again = here("rerun", folder, key)
    assert (again.returncode, "bit for bit" in again.stdout) == (0, True)


def test_a_reader_that_goes_away_is_no_error(folder):
    for words, code in ((["show", folder, "best"], 0), (["check", "nowhere.yaml"], 2)):
        command = [sys.executable, "-m", "sweep", *map(str, words)]
        errors = subprocess.STDOUT if code else subprocess.PIPE
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, cwd=HERE.parents[1]) as ended:
            ended.stdout.close()
            assert ended.stderr is None or ended.stderr.read() == b""
        assert ended.returncode == code


def test_show_puts_aggregates_and_spread_beside_the_value():
    dims, about = ("design", "environment"), {"units": "1", "long_name": "ratio"}
    data = {
        "key": (dims, [["a", "b"]]),
        "status": (dims, [["OK", "OK"]]),
        "message": (dims, [["", ""]]),
        "delta": (dims, [[0.5, 0.7]], about),
        "delta_mean": ("design", [0.6], about),
        "delta_worst": ("design", [0.7], about),
        "delta_spread": (dims, [[0.01, 0.02]]),
        "delta_spread_mean": ("design", [0.015]),
        "jumps": (dims, [[1.0, 2.0]]),
        "jumps_mean": ("design", [1.5]),
    }
    coords = {"design": [0], "environment": ["clean", "fouled"], "EA1": ("design", [4e5], {"units": "N"})}
    lines = one_point(xr.Dataset(data, coords), "b").splitlines()
    assert [line.split()[0] for line in lines if line] == [
        *("key", "status", "design", "environment", "EA1", "metric", "delta", "jumps")
    ]
    assert lines[-2].split() == ["delta", "0.7", "±", "0.02", "0.6", "0.7", "ratio"]
    assert lines[-1].split() == ["jumps", "2", "1.5"]


def test_pareto_writes_table_and_file(here, folder):
    ended = here("pareto", folder)
    assert ended.returncode == 0, ended.stderr
    assert "best" in ended.stdout
    with xr.open_dataset(folder / "front.nc") as front:
        assert 0 < front.sizes["point"] <= 6


def test_another_solver_version_is_refused(here, folder, tmp_path):
    (tmp_path / "parts").mkdir()
    old = (folder / "parts/journal-0.jsonl").read_text().replace('"solver":"', '"solver":"old')
    (tmp_path / "parts/journal-0.jsonl").write_text(old)
    ended = here("run", TINY, "--out", tmp_path)
    assert (ended.returncode, "another version of the solvers" in ended.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "nowhere.yaml", "--out", "OUT"], "there is no such file"),
        (["run", TINY], "Missing option '--out'"),
        (["run", TINY, "--out", "OUT", "--part", "3/3"], "K from 0 to N-1"),
        (["run", TINY, "--out", "OUT", "--part", "one"], "K from 0 to N-1"),
        (["run", TINY, "--out", "OUT", "--limit", "0"], "--limit"),
        (["run", TINY, "--out", "OUT", "--retry", "all"], "--retry"),
        (["run", TINY, "--out", TINY / "inside"], "cannot write"),
        (["status", "OUT"], "does not exist"),
        (["show", HERE, "best"], "is no results folder"),
        (["plot", HERE, "nothing"], "'nothing' is not one of"),
        (["nonsense"], "No such command"),
    ],
)
def test_bad_input_is_a_sentence_and_exit_code_2(here, words, sentence, tmp_path):
    ended = here(*[tmp_path / "out" if word == "OUT" else word for word in words])
    assert ended.returncode == 2
    assert sentence in " ".join(ended.stderr.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def test_an_unknown_key_names_the_nearest(here, folder):
    key = str(open_study(folder)["key"].values[0])
    ended = here("show", folder, key[:-1] + "?")
    assert (ended.returncode, key in ended.stderr) == (2, True)


def test_copies_without_mpi_are_refused(here, tmp_path, monkeypatch):
    monkeypatch.setenv("SLURM_NTASKS", "4")
    ended = here("run", TINY, "--out", tmp_path / "out")
    assert (ended.returncode, "4 processes were asked for" in ended.stderr) == (2, True)


@pytest.mark.parametrize("command", ["models", "metrics", "schema", "--help"])
def test_tables(here, command):
    ended = here(command)
    assert ended.returncode == 0
    assert len(ended.stdout.splitlines()) > 3


def test_init_writes_a_study_that_checks_and_runs(here, tmp_path):
    place = tmp_path / "new" / "study"
    ended = here("init", place)
    assert ended.returncode == 0, ended.stderr
    assert sorted(path.name for path in place.iterdir()) == ["cable.yaml", "study.yaml"]
    study = load_study(place / "study.yaml")
    assert evaluate(next(points(study))).trusted
    again = here("init", place)
    assert (again.returncode, "cable.yaml and study.yaml already" in again.stderr) == (2, True)
    (tmp_path / "file").touch()
    assert here("init", tmp_path / "file").returncode == 2


def test_sensitivity(tmp_path, here):
    """A study of made-up runs, of which every twentieth raises: a table, a file, a figure, and what was left out.

    With one variable the second and third design of a block are the same, and run as the second: of the designs 19,
    39, ... 119 the runs of 59 and 119 are never made, and 19 and 79 take their twins with them.
    """
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(TINY.read_text().replace("{kind: sobol, n: 6, seed: 1}", "{kind: saltelli, n: 40, seed: 1}"))
    modes = ",".join(["good"] * 19 + ["raise"])
    ended = subprocess.run(
        [sys.executable, "-m", "fake_sweep", "run", study, "--out", out],
        env=os.environ | {"FAKE_MODES": modes, "PYTHONPATH": f"{HERE.parents[1]}:{HERE}"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert ended.returncode == 1, ended.stderr  # finished, with failed points
    said = here("sensitivity", out, "--metric", "delta")
    assert said.returncode == 0, said.stderr
    for part in ("36 of 40 blocks of a saltelli design", "4 of 40 blocks left out, for 6 points", "EA1", "ST"):
        assert part in said.stdout
    with xr.open_dataset(out / "sensitivity.nc") as found:
        assert np.isfinite(found["S1"].values).all()
    assert (out / "figures" / "sensitivity.png").stat().st_size > 10_000
    wrong = here("sensitivity", out, "--metric", "delt")
    assert wrong.returncode == 2
    assert "no metric `delt`" in wrong.stderr
