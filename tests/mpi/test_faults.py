"""What a cluster does to a run: whatever dies, every point has one row and the file is that of an undisturbed run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr
from test_mpi import COST, MPIRUN, ROOT, UNIT, WHY_NOT

from sweep import open_study
from sweep.store import journals, read_records

COUNT = 30
HANGS = 300  # a test fails where something takes longer; nothing does on a machine that is merely busy [s]
TEXT = (UNIT / "tiny.yaml").read_text().replace("n: 6,", f"n: {COUNT},").replace("time_limit: 60", "time_limit: 600")
needs_mpi = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("study") / "faults.yaml"
    path.write_text(TEXT)
    return path


def hold(out: Path, first: int) -> dict[str, str]:
    """The environment in which designs from the ``first`` on wait for ``let_go``."""
    return {"FAKE_HOLD": f"{first}:{out}-go"}


def let_go(out: Path) -> None:
    Path(f"{out}-go").touch()


def start(ranks: int, study: Path, out: Path, *words: str, **environment: str) -> subprocess.Popen[str]:
    """`sweep run` with a made-up evaluator on some ranks, 0 for a serial run, in a process group of its own."""
    launch = [str(MPIRUN), "-n", str(ranks), sys.executable, "-m", "mpi4py"] if ranks else [sys.executable]
    path = {"PYTHONPATH": f"{ROOT}{os.pathsep}{UNIT}"}
    return subprocess.Popen(
        [*launch, "-m", "fake_sweep", "run", str(study), "--out", str(out), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        process_group=0,
        env=os.environ | path | environment,
    )


def run(ranks: int, study: Path, out: Path, *words: str, **environment: str) -> tuple[int, str]:
    started = start(ranks, study, out, *words, **environment)
    said, errors = started.communicate(timeout=HANGS)
    return started.returncode, said + errors


def result(out: Path) -> xr.Dataset:
    """The folder's dataset without costs; no point may have two rows."""
    keys = [record.key for record in read_records(out)]
    assert len(keys) == len(set(keys)) == COUNT
    return open_study(out).drop_vars(COST)


@pytest.fixture(scope="module")
def undisturbed(study, tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("undisturbed")
    code, said = run(0, study, out)
    assert code == 0, said
    return result(out)


def wait_for(out: Path, rows: int) -> None:
    deadline = time.monotonic() + HANGS
    while len(read_records(out)) < rows:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def processes(out: Path, word: str) -> dict[int, int]:
    """Live ranks with the folder and the word in their command line, without their children: number and rank."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            line = (path / "cmdline").read_bytes().decode()
            environment = (path / "environ").read_bytes().decode()
            name = (path / "comm").read_text().strip()
        except OSError:
            continue
        if str(out) in line and word in line and "PMI_RANK=" in environment and name != "sweep.child":
            found[int(path.name)] = int(environment.split("PMI_RANK=")[1].split("\0")[0])
    return found


def gone(out: Path) -> None:
    """Wait until no process of the run is left."""
    deadline = time.monotonic() + HANGS
    while processes(out, "fake_sweep"):
        assert time.monotonic() < deadline
        time.sleep(0.1)


# ------------------------------------------------------------------------------------------ points that misbehave


@needs_mpi
def test_bad_points_cost_their_row_and_no_more(tmp_path):
    """Segfault, endless loop, memory eater, NaN, exception, SIGKILL of the child: rows with reasons, as in serial."""
    limits = tmp_path / "limits.yaml"
    limits.write_text(TEXT.replace("time_limit: 600", "time_limit: 8\nmemory_limit: 700"))
    bad = ["good", "segfault", "good", "good", "eat", "nan", "raise", "good", "kill", "good", "loop"]
    modes = {"FAKE_MODES": ",".join(bad + ["good"] * (COUNT - len(bad)))}
    found = {}
    for ranks in (0, 3):
        code, said = run(ranks, limits, tmp_path / str(ranks), **modes)
        assert code == 1, said  # finished with failed points
        found[ranks] = result(tmp_path / str(ranks))
    xr.testing.assert_identical(found[3], found[0])
    ended = dict(enumerate(zip(found[0]["status"].values, found[0]["message"].values, strict=True)))
    assert ended[1] == ("CRASHED", "the worker process was killed by signal 11 (SIGSEGV)")
    assert ended[4] == ("MEMORY", "passed the memory limit of 700 MB")
    assert ended[5] == ("ERROR", "no number came out: delta, gamma are NaN")
    assert ended[8] == ("CRASHED", "the worker process was killed by signal 9 (SIGKILL)")
    assert ended[10] == ("TIMEOUT", "passed the time limit of 8 s")
    assert ended[6][0] == "ERROR"
    assert sum(status == "OK" for status, _ in ended.values()) == COUNT - 6


# ------------------------------------------------------------------------------------------ processes that are killed


@needs_mpi
def test_killed_ranks(study, undisturbed, tmp_path):
    """SIGKILL of rank 1, and in the next run of rank 0: the launcher ends the job, and a third run finishes it."""
    for rank, rows in ((1, 4), (0, 12)):
        started = start(3, study, tmp_path, **hold(tmp_path, rows))
        wait_for(tmp_path, rows)
        for pid, which in processes(tmp_path, "mpi4py").items():
            if which == rank:
                os.kill(pid, signal.SIGKILL)
        started.communicate(timeout=HANGS)
        assert started.returncode != 0
        gone(tmp_path)
        assert len(read_records(tmp_path)) == rows
    code, said = run(3, study, tmp_path)
    assert code == 0, said
    xr.testing.assert_identical(result(tmp_path), undisturbed)


@needs_mpi
def test_a_killed_job_and_clocks_that_differ(study, undisturbed, tmp_path):
    """Each rank's clock is an hour behind the one before: what is done stays done, and `status` is not confused."""
    skew = {"FAKE_SKEW": "3600"}
    started = start(3, study, tmp_path, **hold(tmp_path, 6), **skew)
    wait_for(tmp_path, 6)
    os.killpg(started.pid, signal.SIGKILL)
    started.communicate()
    for pid in processes(tmp_path, "fake_sweep"):
        os.kill(pid, signal.SIGKILL)
    gone(tmp_path)
    code, said = run(2, study, tmp_path, **skew)
    assert code == 0, said
    xr.testing.assert_identical(result(tmp_path), undisturbed)


@needs_mpi
@pytest.mark.parametrize("told", [False, True])
def test_a_rank_that_hangs_is_given_up(study, undisturbed, tmp_path, told):
    """By its silence; or when the run is told to end and it does not, long before."""
    started = start(3, study, tmp_path, FAKE_SILENCE="600" if told else "12", **hold(tmp_path, 3))
    wait_for(tmp_path, 3)
    hung = [pid for pid, rank in processes(tmp_path, "mpi4py").items() if rank == 2]
    for pid in hung:
        os.kill(pid, signal.SIGSTOP)
    if told:
        started.send_signal(signal.SIGTERM)
    _, errors = started.communicate(timeout=HANGS)
    assert started.returncode != 0
    assert "rank 2 " + ("did not end when it was told to" if told else "has been silent for 12 s") in errors
    gone(tmp_path)
    code, said = run(2, study, tmp_path)
    assert code == 0, said
    xr.testing.assert_identical(result(tmp_path), undisturbed)


# ------------------------------------------------------------------------------------------ folders


@needs_mpi
def test_two_runs_on_one_folder_by_mistake(study, undisturbed, tmp_path):
    """An array task beside a run on ranks is refused, and the run is not disturbed."""
    started = start(2, study, tmp_path, **hold(tmp_path, 2))
    wait_for(tmp_path, 2)
    code, said = run(0, study, tmp_path, "--part", "1/4")
    assert code == 2
    assert "is in use: process" in said
    let_go(tmp_path)
    started.communicate(timeout=HANGS)
    assert started.returncode == 0
    xr.testing.assert_identical(result(tmp_path), undisturbed)


@pytest.fixture
def small_disk(tmp_path):
    """A tmpfs of 128 kB, of which 20 kB are free."""
    place = tmp_path / "disk"
    place.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(place)]
    try:
        subprocess.run(words, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no tmpfs can be mounted here (root is needed)")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


@needs_mpi
def test_a_full_disk(study, undisturbed, small_disk):
    """First there is no room for all rows, then for all rows but not for the file made of them."""
    (small_disk / "ballast").write_bytes(bytes(108 * 1024))
    for size, enough, file in ((128, False, "journal-"), (160, True, "results.nc")):
        subprocess.run(["mount", "-o", f"remount,size={size}k", str(small_disk)], check=True)
        code, said = run(2, study, small_disk / "out")
        assert code == 3, said
        assert "cannot write" in said
        assert file in said
        assert "run the same command again" in said
        assert "Traceback" not in said
        assert (len(read_records(small_disk / "out")) == COUNT) == enough
    subprocess.run(["mount", "-o", "remount,size=20m", str(small_disk)], check=True)
    code, said = run(2, study, small_disk / "out")
    assert code == 0, said
    xr.testing.assert_identical(result(small_disk / "out"), undisturbed)


def test_another_solver_version_is_refused_unless_told(study, tmp_path):
    assert run(0, study, tmp_path, "--limit", "4")[0] == 0
    path = journals(tmp_path)[0]
    text = path.read_text()
    solver = text.split('"solver":"')[1].split('"')[0]
    path.write_text(text.replace(solver, "0" * 16))
    code, said = run(0, study, tmp_path)
    assert code == 2
    assert "another version of the solvers" in said
    assert run(0, study, tmp_path, "--force-version")[0] == 0
    assert len(result(tmp_path)["key"]) == COUNT
