"""Runs under mpirun: the same rows as a serial run, whatever dies on the way."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr

from sweep import open_study
from sweep.store import read_headers, read_records

UNIT = Path(__file__).resolve().parents[1] / "unit"
ROOT = UNIT.parents[1]
BIN = Path(sys.executable).parent
MPIRUN = shutil.which("mpirun", path=f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}")
COST = ["seconds", "first_seconds"]


def command(ranks: int, *words: object) -> list[str]:
    start = [str(MPIRUN), "-n", str(ranks), sys.executable, "-m", "mpi4py"] if ranks else [sys.executable]
    return [*start, *map(str, words)]


def start(ranks: int, *words: object) -> subprocess.Popen[str]:
    """Start a script or module on some ranks, 0 for a serial run, in a process group of its own."""
    return subprocess.Popen(
        command(ranks, *words),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        process_group=0,
    )


HANGS = 600  # a test fails where something takes longer; nothing does on a machine that is merely busy [s]


def run(ranks: int, *words: object, timeout: float = HANGS) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(ranks, *words), capture_output=True, text=True, timeout=timeout, cwd=ROOT)


def _works() -> str:
    """Why MPI cannot be tested here, or nothing."""
    if MPIRUN is None:
        return "there is no mpirun"
    code = "from mpi4py.MPI import COMM_WORLD as all; all.rank or print(all.size)"
    try:
        ended = run(2, "-c", code, timeout=120)
    except subprocess.TimeoutExpired:
        return "mpirun hangs here"
    return "" if ended.stdout.strip() == "2" else f"mpirun -n 2 does not work here: {ended.stderr[-300:]}"


WHY_NOT = _works()
pytestmark = pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)


def rows(folder: Path) -> dict[str, tuple]:
    """What a run found, without what it cost."""
    found = {r.key: (r.status, r.message, repr(r.metrics), r.design) for r in read_records(folder)}
    assert len(found) == len(read_records(folder)), "a point was run twice"
    return found


# --------------------------------------------------------------------------------------------- a real study


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("serial") / "out"
    assert run(0, "-m", "sweep", "run", UNIT / "tiny.yaml", "--out", out).returncode == 0
    return open_study(out)


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_any_number_of_ranks_makes_the_same_file(serial, tmp_path, ranks):
    ended = run(ranks, "-m", "sweep", "run", UNIT / "tiny.yaml", "--out", tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert f"on {ranks} rank" in ended.stderr
    xr.testing.assert_identical(open_study(tmp_path).drop_vars(COST), serial.drop_vars(COST))
    assert {header["solver"] for header in read_headers(tmp_path)} == {serial.attrs["solver"]}


# --------------------------------------------------------------------------------------------- a search


@pytest.fixture(scope="module")
def searched(tmp_path_factory) -> xr.Dataset:
    out = tmp_path_factory.mktemp("search") / "out"
    ended = search(0, out)
    assert ended.returncode == 1, ended.stderr  # some designs fail
    return open_study(out)


def search(ranks: int, out: Path) -> subprocess.CompletedProcess[str]:
    words = "-m", "fake_sweep", "optimise", UNIT / "known.yaml", "--out", out, "--evaluations", 40
    return subprocess.run(command(ranks, *words), capture_output=True, text=True, timeout=200, cwd=ROOT, env=FAKE)


FAKE = os.environ | {"PYTHONPATH": f"{ROOT}:{UNIT}", "FAKE_EVALUATOR": "known_front", "FAKE_BAD": "7"}


@pytest.mark.parametrize("ranks", [2, 3])
def test_any_number_of_ranks_makes_the_same_search(searched, tmp_path, ranks):
    ended = search(ranks, tmp_path)
    assert ended.returncode == 1, ended.stderr
    assert f"on {ranks} ranks" in ended.stderr
    assert len(rows(tmp_path)) == 40
    xr.testing.assert_identical(open_study(tmp_path).drop_vars(COST), searched.drop_vars(COST))
    assert sum(1 for path in (tmp_path / "parts").glob("*.jsonl") if path.read_text().count('"start"') == 1) == ranks


def test_a_killed_search_of_ranks_goes_on_in_serial_to_the_same_front(searched, tmp_path):
    words = command(2, "-m", "fake_sweep", "optimise", UNIT / "known.yaml", "--out", tmp_path, "--evaluations", "40")
    slow = FAKE | {"FAKE_SECONDS": "0.1"}
    started = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT, env=slow,
                               process_group=0)  # fmt: skip
    _wait_for(tmp_path, 20)  # of the second generation
    os.killpg(started.pid, signal.SIGKILL)
    started.communicate()
    _quiet(tmp_path)
    assert 20 <= len(rows(tmp_path)) < 40
    assert search(0, tmp_path).returncode == 1
    assert len(rows(tmp_path)) == 40
    xr.testing.assert_identical(open_study(tmp_path).drop_vars(COST), searched.drop_vars(COST))


def test_bad_input_is_said_once_on_all_ranks(tmp_path):
    ended = run(2, "-m", "sweep", "run", "nowhere.yaml", "--out", tmp_path)
    assert ended.returncode == 2
    assert ended.stderr.count("there is no such file") == 1
    assert "Traceback" not in ended.stderr


# ----------------------------------------------------------------------------------------- what goes wrong


def test_bad_points_are_the_same_rows_on_ranks_as_in_serial(tmp_path):
    modes = ["good", "segfault", "raise", "exit", "good", "loop", "kill", "print"]
    for ranks in (0, 3):
        ended = run(ranks, UNIT / "fakes.py", tmp_path / str(ranks), 8, 0, *modes)
        assert ended.returncode == 0, ended.stderr
    assert len(rows(tmp_path / "0")) == 8
    assert rows(tmp_path / "3") == rows(tmp_path / "0")


def _wait_for(folder: Path, count: int) -> None:
    deadline = time.monotonic() + HANGS
    while len(read_records(folder)) < count:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_killed_run_loses_what_was_in_flight_and_no_more(tmp_path):
    started = start(2, UNIT / "fakes.py", tmp_path, 30, 0.1)
    _wait_for(tmp_path, 8)
    os.killpg(started.pid, signal.SIGKILL)
    started.communicate()
    _quiet(tmp_path)
    before = rows(tmp_path)
    assert 8 <= len(before) < 30
    ended = run(2, UNIT / "fakes.py", tmp_path, 30, 0)
    assert f"{30 - len(before)} of 30 to do" in ended.stdout
    assert len(rows(tmp_path)) == 30  # and none of them twice
    assert before.items() <= rows(tmp_path).items()


def _quiet(folder: Path) -> None:
    """Wait until nobody writes: the ranks notice that mpirun is gone a moment later."""
    last, since = -1, time.monotonic()
    while time.monotonic() - since < 1.0:
        size = sum(path.stat().st_size for path in folder.glob("parts/*"))
        if size != last:
            last, since = size, time.monotonic()
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1])
def test_a_signal_to_mpirun_ends_the_run_in_good_order(tmp_path, number):
    started = start(2, UNIT / "fakes.py", tmp_path, 60, 0.1)
    _wait_for(tmp_path, 4)
    started.send_signal(number)
    _, errors = started.communicate(timeout=HANGS)
    assert started.returncode == 3, errors
    assert 4 <= len(rows(tmp_path)) < 60


def test_a_full_disk_on_one_rank_ends_the_run(tmp_path):
    ended = run(2, UNIT / "fakes.py", tmp_path, 100, 0.05, "full-1")
    assert ended.returncode == 3
    assert "rank 1: cannot write" in ended.stderr


def test_full_disks_on_two_of_three_ranks_end_the_run(tmp_path):
    """Rank 0 and rank 1 can write no more while rank 2 has a point in flight: the end must reach it all the same."""
    ended = run(3, UNIT / "fakes.py", tmp_path, 60, 0.6, "full-0", "full-1")
    assert ended.returncode in (2, 3)
    assert "cannot write" in ended.stderr
