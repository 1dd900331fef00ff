"""One child, bad points, signals and limits: every point ends in a row with a reason."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import fakes
import pytest

from sweep import child, distribute, supervise
from sweep.distribute import Alone, Crew, Job, map_points
from sweep.store import CannotWrite, DiskStore
from sweep.supervise import CannotRun, Child


def job(directory=None, **changes) -> Job:
    settings = {"evaluator": f"{fakes.HERE}:evaluate", "warm_ups": (), "time_limit": 1.0}
    return Job(directory=None if directory is None else str(directory), **(settings | changes))


def test_bad_points_are_rows_with_reasons(tmp_path):
    modes = ("good", "segfault", "exit", "loop", "raise", "print", "kill", "quit")
    points = [fakes.make(i, mode) for i, mode in enumerate(modes)]
    assert map_points([*points, fakes.make(99)], job(tmp_path), Alone()) == ""
    rows = {key: (row.status, row.message) for key, row in DiskStore(tmp_path).rows().items()}
    assert rows["0099"] == ("OK", "")
    assert {mode: rows[f"{i:04d}"] for i, mode in enumerate(modes)} == {
        "good": ("OK", ""),
        "print": ("OK", ""),
        "segfault": ("CRASHED", "the worker process was killed by signal 11 (SIGSEGV)"),
        "kill": ("CRASHED", "the worker process was killed by signal 9 (SIGKILL)"),
        "exit": ("CRASHED", "the worker process ended with exit code 3"),
        "loop": ("TIMEOUT", "passed the time limit of 1 s"),
        "raise": ("ERROR", rows["0004"][1]),
        "quit": ("ERROR", rows["0007"][1]),
    }
    assert rows["0004"][1].startswith("ValueError: on purpose (fakes.py:")


def test_a_point_that_dies_does_not_take_the_next_one_with_it():
    """Short points lie in the child's socket ahead of time: those that were not begun are run by the next child."""
    modes = ["good"] * 4 + ["segfault", "good", "good", "raise", "kill", "good", "good"]
    points = [fakes.make(i, mode) for i, mode in enumerate(modes)]
    seen = []
    map_points(points, job(), Alone(), lambda done: seen.append(done.status))
    assert seen == ["OK"] * 4 + ["CRASHED", "OK", "OK", "ERROR", "CRASHED", "OK", "OK"]


@pytest.mark.skipif(sys.platform != "linux", reason="page faults are counted as Linux does")
def test_a_child_keeps_the_memory_that_its_points_free():
    """Three arrays of 3.2 MB, again and again: their 2300 pages are faulted in once, not each time."""
    code = (
        "import resource, numpy\n"
        "from sweep.child import keep_memory\n"
        "keep_memory()\n"
        "def work(): return sum(x[0] for x in [numpy.ones(400_000) for _ in range(3)])\n"
        "faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "work(); before = faults(); [work() for _ in range(20)]; print(faults() - before)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(ended.stdout) < 2300


def test_memory_is_limited_in_leaps_and_in_small_steps():
    """At once by the kernel's limit on data; where that is not had, by looking at the process."""
    limited = job(memory_limit=700.0, time_limit=30.0)
    assert distribute.evaluate_alone(fakes.make(0, "eat"), limited).message == "passed the memory limit of 700 MB"
    unlimited = job(memory_limit=700.0, time_limit=30.0, evaluator=f"{fakes.HERE}:evaluate_unlimited")
    found = distribute.evaluate_alone(fakes.make(0, "eat"), unlimited)
    assert (found.status, found.message) == ("MEMORY", "passed the memory limit of 700 MB")


def test_the_spare_child_is_as_one_that_is_started(tmp_path):
    """A fork of a warm process: no launcher's variables, one thread, no file but its socket; it dies like any other."""
    code = f"""
import os, sys
sys.path.insert(0, {str(Path(fakes.HERE).parent)!r})
held = open({str(tmp_path / "held")!r}, "w")
import fakes
from sweep import distribute, supervise
assert supervise.fork_spare()
pid = supervise._spares[0].pid
job = distribute.Job(evaluator={fakes.HERE + ":tell"!r}, warm_ups=(), time_limit=60.0)
print(distribute.evaluate_alone(fakes.make(0), job).message)
assert not supervise._spares
assert not os.path.exists(f"/proc/{{pid}}")
usual, sys.stdout = sys.stdout, held  # as a notebook's or a test's is no file of the child
assert supervise.fork_spare()
sys.stdout = usual
job = distribute.Job(evaluator={fakes.HERE + ":evaluate"!r}, warm_ups=(), time_limit=60.0)
seen = []
modes = ["good", "print", "segfault", "good"]
distribute.map_points([fakes.make(i, m) for i, m in enumerate(modes)], job, distribute.Alone(),
                      lambda done: seen.append(done.status))
print(seen)
"""
    launched = {"PMI_RANK": "3", "SLURM_JOB_ID": "17", "OMP_NUM_THREADS": "1"}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ | launched)
    assert ended.stdout.splitlines() == [
        "OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1",
        "['OK', 'OK', 'CRASHED', 'OK']",
    ], ended.stderr


def test_nothing_is_forked_beside_threads_or_mpi(monkeypatch):
    end = threading.Event()
    beside = threading.Thread(target=end.wait)
    beside.start()
    assert not supervise.fork_spare()
    end.set()
    beside.join()


def test_a_limit_below_what_the_program_takes_is_refused():
    """Else every point of the study would be a row that says so."""
    with pytest.raises(CannotRun, match=r"memory limit of 20 MB is less than the \d+ MB that it takes without a point"):
        distribute.evaluate_alone(fakes.make(0), job(memory_limit=20.0))


def test_long_messages_are_cut(tmp_path):
    """An array printed in full, a million times, would fill disk and memory."""
    found = distribute.evaluate_alone(fakes.make(0), job(evaluator=f"{fakes.HERE}:talk", time_limit=60.0))
    assert found.message.startswith("ValueError: xxx")
    assert found.message.endswith("characters)")
    assert len(found.message) <= child.MOST_MESSAGE
    assert child.brief("a\0b \udc80") == "a b ?"


def test_the_share_of_memory_is_the_jobs(monkeypatch):
    monkeypatch.setenv("SLURM_MEM_PER_CPU", "2000")
    assert distribute.memory_share() == 1700
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "4")
    assert distribute.memory_share() == 7700
    monkeypatch.delenv("SLURM_MEM_PER_CPU")
    monkeypatch.setenv("SLURM_MEM_PER_NODE", "4000")
    monkeypatch.setenv("SLURM_NTASKS_PER_NODE", "4")
    assert distribute.memory_share() == 600
    assert distribute.memory_share(2) == 1500  # MPI has counted


def test_the_child_sees_no_launcher_and_one_thread(monkeypatch):
    monkeypatch.setenv("PMI_RANK", "3")
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    told = distribute.evaluate_alone(fakes.make(0), job(evaluator=f"{fakes.HERE}:tell")).message
    assert told == "OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1"


@pytest.mark.parametrize("evaluator", ["no.such.module:evaluate", f"{fakes.HERE}:nothing"])
def test_a_child_that_cannot_start_says_why(evaluator):
    with pytest.raises(CannotRun, match=r"cannot start: (ModuleNotFound|Attribute)Error"):
        distribute.evaluate_alone(fakes.make(0), job(evaluator=evaluator))


def test_a_child_that_dies_at_its_start_is_given_up():
    with pytest.raises(CannotRun, match=r"exit code 5 before it was ready, 3 times"):
        distribute.evaluate_alone(fakes.make(0), job(warm_ups=(f"{fakes.HERE}:die",)))


def test_the_child_dies_with_its_parent():
    code = f"""
import sys, time
sys.path.insert(0, {str(Path(fakes.HERE).parent)!r})
import fakes
from sweep.supervise import Child
child = Child({fakes.HERE + ":evaluate"!r})
child.submit(fakes.make(0))
while child.poll(0.1) is None: pass
child.submit(fakes.make(1, "loop"))
print(child._process.pid, flush=True)
time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        parent.kill()
    deadline = time.monotonic() + 5
    while Path(f"/proc/{pid}").exists() and "Z" not in _state(pid):
        assert time.monotonic() < deadline, "the child outlived its parent"
        time.sleep(0.05)


def _state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return "Z"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1])
def test_an_interrupt_stops_the_map_and_keeps_what_is_done(tmp_path, number):
    def after_two(done):
        if len(DiskStore(tmp_path).rows()) == 2:
            os.kill(os.getpid(), number)

    points = [fakes.make(i) for i in range(9)]
    assert map_points(points, job(tmp_path), Alone(), after_two) == signal.Signals(number).name
    assert 2 <= len(DiskStore(tmp_path).rows()) <= 4  # two more were in flight, and may end
    assert signal.getsignal(number) is not None


def test_a_full_disk_ends_the_map(tmp_path):
    size = []  # of the journal after one row and after two: a row's length varies with the digits of its timings
    points = [fakes.make(i) for i in range(4)]
    measured = job(tmp_path / "measured", time_limit=60.0)
    map_points(points[:2], measured, Alone(), lambda done: size.append(_bytes(tmp_path / "measured")))
    with fakes.full_disk((size[0] + size[1]) // 2), pytest.raises(CannotWrite, match="run the same command again"):
        map_points(points, job(tmp_path / "full", time_limit=60.0), Alone())
    assert len(DiskStore(tmp_path / "full").rows()) == 1


def _bytes(directory: Path) -> int:
    return max(path.stat().st_size for path in directory.rglob("*") if path.is_file())


@pytest.mark.parametrize("name", ["SLURM_NTASKS", "PMI_SIZE", "OMPI_COMM_WORLD_SIZE"])
@pytest.mark.parametrize("installed", [True, False])
def test_strangers_are_refused(monkeypatch, name, installed):
    lonely = types.ModuleType("mpi4py")
    lonely.MPI = types.SimpleNamespace(COMM_WORLD=types.SimpleNamespace(size=1, rank=0))
    monkeypatch.setitem(sys.modules, "mpi4py", lonely if installed else None)
    monkeypatch.setenv(name, "3")
    with pytest.raises(CannotRun, match=rf"3 processes were asked for \({name}=3\)"):
        distribute.world()


def test_an_array_task_does_not_load_mpi(monkeypatch):
    """Some MPIs end a process that they did not start."""
    for name in ("mpi4py", "mpi4py.MPI"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setenv("SLURM_NTASKS", "1")
    assert distribute.world().size == 1
    assert "mpi4py" not in sys.modules


def test_a_second_ctrl_c_ends_a_run_at_once(monkeypatch):
    monkeypatch.setattr(distribute, "IMPATIENT", 0.0)
    with distribute.interruptible() as interrupt:
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt.name == "SIGINT"
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_stop_kills_the_child_at_once():
    looping = Child(f"{fakes.HERE}:evaluate")
    looping.submit(fakes.make(0, "loop"))
    while not looping._ready:
        looping.poll(0.1)
    pid = looping._process.pid
    looping.stop()
    assert not Path(f"/proc/{pid}").exists()


# ------------------------------------------------------------------------------------------ batches


def test_a_crew_keeps_its_child_from_batch_to_batch(tmp_path):
    work = job(tmp_path, evaluator=f"{fakes.HERE}:who", batches=True)
    with Crew(work, Alone()) as crew:
        first, told = crew.map([fakes.make(0)])
        second, _ = crew.map([fakes.make(i) for i in (1, 2, 3)])
        assert crew.map([]) == ([], "")
    assert told == ""
    assert [row.key for row in first] == ["0000"]
    assert sorted(row.key for row in second) == ["0001", "0002", "0003"]
    assert len({row.message for row in (*first, *second)}) == 1
    assert sorted(DiskStore(tmp_path).rows()) == ["0000", "0001", "0002", "0003"]
    assert not Path(f"/proc/{first[0].message}").exists()


def test_a_crew_that_is_interrupted_says_so_and_keeps_what_it_has(tmp_path):
    def beat():
        if len(DiskStore(tmp_path).rows()) >= 2:
            os.kill(os.getpid(), signal.SIGTERM)

    with Crew(job(tmp_path, batches=True), Alone(), beat=beat) as crew:
        rows, told = crew.map([fakes.make(i, seconds=0.05) for i in range(20)])
        assert told == "SIGTERM"
        assert 2 <= len(rows) < 20
        assert {row.key for row in rows} == set(DiskStore(tmp_path).rows())
        assert crew.map([fakes.make(30)]) == ([], "SIGTERM")  # nothing is begun any more


def test_a_failure_between_batches_ends_the_child(tmp_path):
    before = signal.getsignal(signal.SIGTERM)
    found = []

    def fail():
        with Crew(job(tmp_path, evaluator=f"{fakes.HERE}:who", batches=True), Alone()) as crew:
            found.extend(crew.map([fakes.make(0)])[0])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert not Path(f"/proc/{found[0].message}").exists()
    assert signal.getsignal(signal.SIGTERM) == before
