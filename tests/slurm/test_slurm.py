"""The job scripts on a real SLURM, brought up on this machine by ``slurm-here``: of two nodes, as far as it knows."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import xarray as xr
import yaml

from sweep import open_study
from sweep.plan import read_plan
from sweep.store import Replay, journals, read_records
from sweep.submit import _max_array

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
UNIT = ROOT / "tests/unit"
TINY = ROOT / "tests/unit/tiny.yaml"
KNOWN = ROOT / "tests/unit/known.yaml"
COST = ["seconds", "first_seconds"]
HANGS = 600  # a test fails where something takes longer; nothing does on a machine that is merely busy [s]


def call(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*map(str, words)],
        capture_output=True,
        text=True,
        timeout=HANGS,
        cwd=ROOT,
        env=os.environ | environment,
    )


@pytest.fixture(scope="module")
def slurm(tmp_path_factory) -> Iterator[dict[str, str]]:
    """A running cluster of two nodes: the environment in which its commands work."""
    place = {
        "SLURM_HERE_DIR": str(tmp_path_factory.mktemp("slurm-here")),
        "SLURM_HERE_CPUS": "4",
        "SLURM_HERE_NODES": "2",
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
    _forget_shared_memory()
    yield {"SLURM_CONF": conf, "PATH": path, "CABLE_SWEEP_CACHE": cache, **place}
    call(HERE / "slurm-here", "clean", **place)


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("serial") / "out"
    assert call(sys.executable, "-m", "sweep", "run", TINY, "--out", out).returncode == 0
    return open_study(out).drop_vars(COST)


def _forget_shared_memory() -> None:
    """Remove what killed steps of earlier clusters left: jobs had the same numbers, and mpich would hang on it."""
    used = ""
    for path in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            used += path.read_text()
    for path in Path("/dev/shm").glob("mpich_shm_*"):
        if path.name not in used:
            path.unlink(missing_ok=True)


def wait(slurm: dict[str, str], jobs: list[str], seconds: float = HANGS) -> None:
    """Until the jobs have left the queue; a requeued one, which SLURM holds for two minutes, is started after three
    seconds: in the second of its requeue its credential is revoked, and the new turn would fail."""
    deadline = time.monotonic() + seconds
    held: dict[str, float] = {}  # since when
    empty = 0  # answers in a row: a job on its way back to the queue is not seen for a moment
    while empty < 5:
        ended = call("squeue", "-h", "-r", "-j", ",".join(jobs), "-o", "%i %T %r", **slurm)
        lines = ended.stdout.splitlines()
        assert time.monotonic() < deadline, (lines, ended.stderr)
        empty = 0 if lines or ended.returncode else empty + 1
        for job, state, reason in (line.split(maxsplit=2) for line in lines):
            if state != "PENDING" or reason != "BeginTime":
                held.pop(job, None)
            elif time.monotonic() - held.setdefault(job, time.monotonic()) > 3:
                call("scontrol", "update", f"JobId={job}", "StartTime=now", **slurm)
        time.sleep(0.2)


def logs(folder: Path) -> str:
    return "\n".join(f"== {path.name}\n{path.read_text()}" for path in sorted((folder / "logs").glob("*.log")))


def submit(slurm: dict[str, str], study: Path, out: Path, *words: object, **environment: str) -> list[str]:
    """``sweep submit``; the numbers of its jobs, the merge job last."""
    code = [sys.executable, "-m", "sweep", "submit", study, "--out", out, "--site", out.parent / "site.yaml"]
    ended = call(*code, *words, **slurm, **environment)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return [json.loads(line)["job"] for line in (out / "jobs/submitted.jsonl").read_text().splitlines()]


@pytest.fixture
def folder(tmp_path) -> Path:
    """A results folder to be, beside a site.yaml."""
    _site(tmp_path)
    return tmp_path / "out"


def _site(place: Path, setup: tuple[str, ...] = (), nodes: int | None = None, **settings: object) -> None:
    usual = f"export PATH={Path(sys.executable).parent}:$PATH PYTHONPATH={ROOT}:{UNIT}"
    options = {"mem-per-cpu": 0, "time": "00:20:00", "nodes": nodes}
    content = {"options": options, "setup": [usual, *setup], **settings}
    (place / "site.yaml").write_text(yaml.safe_dump(content))


# ------------------------------------------------------------------------------------------ the serial file, again


def test_an_array_of_four_makes_the_serial_file(slurm, serial, folder):
    """Pilots first, slices by the costs in plan.json, results.nc by the dependent merge job."""
    jobs = submit(slurm, TINY, folder, "--array", 4, "--pilots", 2)
    assert len(jobs) == 2
    again = call(sys.executable, "-m", "sweep", "submit", TINY, "--out", folder, "--array", 2, **slurm)
    assert (again.returncode, "still in the queue" in again.stderr) == (2, True)
    wait(slurm, jobs)
    plan = read_plan(folder / "plan.json")
    assert sorted(plan.costs)[:2] == [0, 0]  # the pilots were done before
    assert len(journals(folder)) == 5, logs(folder)
    assert f"{folder}/results.nc\ntrusted" in (folder / f"logs/tiny-{jobs[1]}.log").read_text(), logs(folder)
    xr.testing.assert_identical(open_study(folder).drop_vars(COST), serial)


@pytest.mark.parametrize(("launch", "nodes"), [("srun --mpi=pmi2 --kill-on-bad-exit=1", 1), ("mpirun", 2)])
def test_ranks_make_the_serial_file(slurm, serial, tmp_path, launch, nodes):
    _site(tmp_path, launch=launch, nodes=nodes)
    jobs = submit(slurm, TINY, tmp_path / "out", "--ranks", 3, "--pilots", 0)
    wait(slurm, jobs)
    said = logs(tmp_path / "out")
    assert f"job {jobs[0]} rank 0/3" in said, said
    assert "6 points, 6 to do, on 3 ranks" in said
    assert f"NumNodes={nodes}" in call("scontrol", "-o", "show", "job", jobs[0], **slurm).stdout
    xr.testing.assert_identical(open_study(tmp_path / "out").drop_vars(COST), serial)


def test_the_largest_array_is_asked_of_slurm(slurm, monkeypatch):
    monkeypatch.setenv("SLURM_CONF", slurm["SLURM_CONF"])
    assert _max_array() == 10001


# ------------------------------------------------------------------------------------------ what goes wrong

COUNT = 24


@pytest.fixture(scope="module")
def many(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("study") / "many.yaml"
    path.write_text(TINY.read_text().replace("n: 6,", f"n: {COUNT},"))
    return path


@pytest.fixture(scope="module")
def undisturbed(many, tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("undisturbed")
    path = {"PYTHONPATH": f"{ROOT}:{UNIT}"}
    assert call(sys.executable, "-m", "fake_sweep", "run", many, "--out", out, **path).returncode == 0
    return open_study(out).drop_vars(COST)


def _made_up(place: Path, hold: int, free: int = 0, **settings: object) -> None:
    """A site where `python -m sweep run` is `python -m fake_sweep run`: the evaluator made up, the rest as it is.

    Designs from the ``hold``-th on wait until `_let_go`; with ``free`` not the first one of each rank. Each node keeps
    compiled kernels for itself.
    """
    (place / "bin").mkdir(exist_ok=True)
    python = place / "bin" / "python"
    words = 'for word in "$@"; do [ "$word" = sweep ] && word=fake_sweep; words+=("$word"); done'
    cache = f"export CABLE_SWEEP_CACHE={place}/cache-${{SLURMD_NODENAME:-here}}"
    python.write_text(f'#!/bin/bash\n{cache}\n{words}\nexec {sys.executable} "${{words[@]}}"\n')
    python.chmod(0o755)
    setup = (f"export PATH={place}/bin:$PATH FAKE_HOLD={hold}:{place}/go FAKE_FREE={free} FAKE_GRACE=1",)
    _site(place, setup, **settings)


def _let_go(place: Path) -> None:
    (place / "go").touch()


def _rows(out: Path) -> int:
    return len(read_records(out))


def _wait_for(out: Path, rows: int) -> None:
    _until(lambda: _rows(out) >= rows, out)


def _until(seen: Callable[[], bool], out: Path) -> None:
    deadline = time.monotonic() + HANGS
    while not seen():
        assert time.monotonic() < deadline, logs(out)
        time.sleep(0.1)


def _complete(out: Path, undisturbed: xr.Dataset) -> None:
    assert _rows(out) == COUNT, logs(out)  # none twice
    xr.testing.assert_identical(open_study(out).drop_vars(COST), undisturbed)


def test_an_array_that_meets_its_time_limit_goes_on_in_a_new_turn(slurm, many, undisturbed, tmp_path):
    """USR1 comes some 40 s after the start and before the limit, while both tasks have points that do not end."""
    _made_up(tmp_path, 4)
    out = tmp_path / "out"
    with_signal = {"SBATCH_SIGNAL": "B:USR1@80"}
    jobs = submit(slurm, many, out, "--array", 2, "--pilots", 0, "--time", "00:02:00", **with_signal)
    _until(lambda: logs(out).count("after USR1: back to the queue") == 2, out)
    _let_go(tmp_path)
    wait(slurm, jobs)
    said = logs(out)
    assert "interrupted by SIGUSR1" in said, said
    assert {journal.turn for journal in Replay(out, read_plan(out / "plan.json").keys).journals} != {1}
    _complete(out, undisturbed)
    assert (out / "results.nc").is_file()


def test_a_killed_job_is_submitted_again_and_a_cancelled_one_stays_cancelled(slurm, many, undisturbed, tmp_path):
    """SIGKILL of all processes of a job of ranks; then scancel; then a third submission ends it."""
    _made_up(tmp_path, 4, nodes=2)
    out = tmp_path / "out"
    first = submit(slurm, many, out, "--ranks", 3, "--pilots", 0)
    _wait_for(out, 4)
    before = sorted(out.rglob("*"))
    status = call(sys.executable, "-m", "sweep", "status", out, "--missing", **slurm)  # from outside, while it works
    assert status.returncode == 3
    ranks = [line for line in status.stdout.splitlines() if line.startswith("rank ")]
    assert [line.split()[1] for line in ranks] == ["0", "1", "2"]
    assert all(line.split()[3] == first[0] and line.endswith("yes") for line in ranks), status.stdout
    assert f"{COUNT - 4} points to go" in status.stdout
    assert sorted(out.rglob("*")) == before
    call("scancel", "--signal=KILL", "--full", first[0], **slurm)
    wait(slurm, first)
    assert _rows(out) == 4
    _made_up(tmp_path, 10, nodes=2)
    second = submit(slurm, many, out, "--ranks", 3, "--pilots", 0)[2:]
    _wait_for(out, 10)
    call("scancel", second[0], **slurm)
    wait(slurm, second)
    assert "Restarts=0" in call("scontrol", "-o", "show", "job", second[0], **slurm).stdout
    assert _rows(out) == 10
    _let_go(tmp_path)
    third = submit(slurm, many, out, "--ranks", 3, "--pilots", 0)[4:]
    wait(slurm, third)
    _complete(out, undisturbed)


def test_a_killed_search_is_submitted_again_and_finds_the_undisturbed_front(slurm, tmp_path):
    """SIGKILL of all processes of `sweep submit --optimise`; a rank's death sends the second job back to the queue."""
    known = {"FAKE_EVALUATOR": "known_front", "FAKE_BAD": "7", "PYTHONPATH": f"{ROOT}:{UNIT}"}
    serial = call(sys.executable, "-m", "fake_sweep", "optimise", KNOWN, "--out", tmp_path / "serial", **known)
    assert serial.returncode == 1, serial.stderr  # some designs fail
    _made_up(tmp_path, COUNT)
    known["FAKE_SECONDS"] = "1"  # the whole takes some 40 s: the kills come long before its end
    out = tmp_path / "out"
    first = submit(slurm, KNOWN, out, "--optimise", "--ranks", 3, **known)
    _wait_for(out, 20)  # of the second generation
    call("scancel", "--signal=KILL", "--full", first[0], **slurm)
    wait(slurm, first)
    assert 20 <= _rows(out) < 112, logs(out)
    second = submit(slurm, KNOWN, out, "--optimise", "--ranks", 3, **known)[2:]
    _wait_for(out, 60)
    os.kill(max(_ranks(out)), signal.SIGKILL)
    wait(slurm, second)
    assert "back to the queue" in logs(out), logs(out)
    assert "112 of 112 evaluations by nsga2: the budget is spent" in logs(out), logs(out)
    assert _rows(out) == 112  # none twice
    found, expected = (open_study(place).drop_vars(COST) for place in (out, tmp_path / "serial"))
    xr.testing.assert_identical(found.drop_attrs(deep=False), expected.drop_attrs(deep=False))
    curves = [xr.load_dataset(place / "hypervolume.nc") for place in (out, tmp_path / "serial")]
    xr.testing.assert_identical(*curves)


@pytest.mark.parametrize("fault", ["a killed rank", "the time limit"])
def test_a_job_of_ranks_goes_back_to_the_queue(slurm, many, undisturbed, tmp_path, fault):
    """A rank is killed, or USR1 comes, as before the time limit; on each node one rank fills the compilers' cache."""
    _made_up(tmp_path, 8, free=1, nodes=2)
    out = tmp_path / "out"
    jobs = submit(slurm, many, out, "--ranks", 3, "--pilots", 0)
    _wait_for(out, 8)
    _until(lambda: all(list((tmp_path / f"cache-{node}").rglob("warm")) for node in ("n1", "n2")), out)
    if fault == "the time limit":
        call("scancel", "--batch", "--signal=USR1", jobs[0], **slurm)
        words = "after USR1: back to the queue"
    else:
        os.kill(max(_ranks(out)), signal.SIGKILL)
        words = "back to the queue"
    _until(lambda: words in logs(out), out)
    _let_go(tmp_path)
    wait(slurm, jobs)
    _complete(out, undisturbed)
    assert "Restarts=1" in call("scontrol", "-o", "show", "job", jobs[0], **slurm).stdout


def _ranks(out: Path) -> list[int]:
    """Processes of the ranks that work in a folder, their children aside."""
    return [
        int(path.name)
        for path in Path("/proc").glob("[0-9]*")
        if str(out).encode() in _read(path / "cmdline")
        and _read(path / "cmdline").split(b"\0")[1:3] == [b"-m", b"mpi4py"]
        and _read(path / "comm").strip() != b"sweep.child"
    ]


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:
        return b""


def test_copies_of_size_one_are_refused(slurm, many, tmp_path):
    """A launcher that does not know the MPI would run the whole study three times."""
    _made_up(tmp_path, COUNT, launch="srun --mpi=none")
    out = tmp_path / "out"
    wait(slurm, submit(slurm, many, out, "--ranks", 3, "--pilots", 0))
    assert "3 processes were asked for (SLURM_NTASKS=3) but MPI sees only one" in logs(out), logs(out)
    assert _rows(out) == 0
