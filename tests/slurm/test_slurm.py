"""The job scripts on a real SLURM, brought up on this machine by ``slurm-here``."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import xarray as xr

from sweep import open_study
from sweep.store import journals, merge

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
TINY = ROOT / "tests/unit/tiny.yaml"
COST = ["seconds", "first_seconds"]


def call(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*map(str, words)],
        capture_output=True,
        text=True,
        timeout=180,
        cwd=ROOT,
        env=os.environ | environment,
    )


@pytest.fixture(scope="module")
def slurm(tmp_path_factory) -> Iterator[dict[str, str]]:
    """A running one-machine cluster: the environment in which its commands work."""
    place = {
        "SLURM_HERE_DIR": str(tmp_path_factory.mktemp("slurm-here")),
        "SLURM_HERE_CPUS": "4",
        "SLURM_HERE_INSTALL": os.environ.get("SLURM_HERE_INSTALL", "0"),  # 1 lets it call apt-get
    }
    started = call(HERE / "slurm-here", "start", **place)
    if started.returncode == 77:
        pytest.skip(
            f"no SLURM here, {started.stderr.strip().splitlines()[-1]}; SLURM_HERE_INSTALL=1 installs it"
        )
    assert started.returncode == 0, started.stderr
    conf = started.stdout.split("SLURM_CONF=")[1].split()[0]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    cache = (
        os.environ.get("CABLE_SWEEP_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    )
    yield {"SLURM_CONF": conf, "PATH": path, "CABLE_SWEEP_CACHE": cache, **place}
    call(HERE / "slurm-here", "clean", **place)


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("serial") / "out"
    assert call(sys.executable, "-m", "sweep", "run", TINY, "--out", out).returncode == 0
    return open_study(out).drop_vars(COST)


def submit(slurm: dict[str, str], folder: Path, *words: object) -> str:
    """Submit a job script and return the job's number."""
    ended = call("sbatch", "--parsable", f"--output={folder}/%x-%j.log", "--mem-per-cpu=0", *words, **slurm)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.strip()


def wait(slurm: dict[str, str], job: str, seconds: float = 150) -> None:
    deadline = time.monotonic() + seconds
    while call("squeue", "-h", "-j", job, **slurm).stdout.strip():
        assert time.monotonic() < deadline, call("squeue", **slurm).stdout
        time.sleep(0.2)


def logs(folder: Path) -> str:
    return "\n".join(path.read_text() for path in sorted(folder.glob("*.log")))


def test_an_array_of_three_makes_the_serial_file(slurm, serial, tmp_path):
    job = submit(slurm, tmp_path, "--array=0-2", "slurm/array.sbatch", TINY, tmp_path / "out")
    wait(slurm, job)
    assert [path.name for path in journals(tmp_path / "out")] == [
        f"journal-part{k}of3-0.jsonl" for k in range(3)
    ], logs(tmp_path)
    merge(tmp_path / "out")
    xr.testing.assert_identical(open_study(tmp_path / "out").drop_vars(COST), serial)


def test_an_mpi_job_makes_the_serial_file(slurm, serial, tmp_path):
    job = submit(slurm, tmp_path, "--ntasks=2", "slurm/mpi.sbatch", TINY, tmp_path / "out")
    wait(slurm, job)
    assert "on 2 ranks" in logs(tmp_path), logs(tmp_path)
    xr.testing.assert_identical(open_study(tmp_path / "out").drop_vars(COST), serial)
