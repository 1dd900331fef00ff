"""Locks of parts: who may work beside whom, and when a lock is nobody's."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import replace

import pytest

from sweep import locks
from sweep.locks import Busy, acquire, holders, myself
from sweep.store import CannotWrite

STUDY = "0123456789abcdef"


@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        ("part0of2", "part1of2", True),
        ("part0of2", "part0of2", False),
        ("part0of2", "part0of3", False),
        ("part0of2", "part1of3", False),
        ("part0of2", "", False),
        ("", "part0of2", False),
        ("", "", False),
    ],
)
def test_who_may_work_beside_whom(tmp_path, first, second, together):
    lock = acquire(tmp_path, first, STUDY)
    if together:
        acquire(tmp_path, second, STUDY).release()
    else:
        with pytest.raises(Busy, match=f"is in use: process {os.getpid()} on"):
            acquire(tmp_path, second, STUDY)
    lock.release()
    acquire(tmp_path, second, STUDY).release()
    assert list((tmp_path / "locks").iterdir()) == []


def test_another_form_of_the_study_is_refused(tmp_path):
    lock = acquire(tmp_path, "part0of2", STUDY)
    with pytest.raises(Busy, match="another form of this study, or another --limit, there"):
        acquire(tmp_path, "part1of2", "f" * 16)
    assert [holder.part for holder in holders(tmp_path)] == ["part0of2"]
    lock.release()
    assert holders(tmp_path) == []


def test_of_many_at_once_one_gets_in(tmp_path):
    got, refused = [], []

    def try_it():
        try:
            got.append(acquire(tmp_path, "", STUDY))
        except Busy:
            refused.append(1)

    threads = [threading.Thread(target=try_it) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (len(got), len(refused)) == (1, 7)
    got[0].release()


def _left_behind(folder, **changes) -> locks.Holder:
    """A lock whose holder will never give it back."""
    holder = replace(myself("", STUDY), **changes)
    (folder / "locks").mkdir()
    path = folder / "locks" / f"whole.{STUDY[:8]}.lock"
    path.write_text(json.dumps(vars(holder)))
    return holder


def test_a_lock_of_a_dead_process_is_broken(tmp_path):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    _left_behind(tmp_path, pid=dead.pid)
    assert holders(tmp_path) == []
    acquire(tmp_path, "", STUDY).release()


def test_a_process_number_that_is_used_again_does_not_count(tmp_path):
    _left_behind(tmp_path, started="1")
    acquire(tmp_path, "", STUDY).release()


def test_a_lock_of_another_host_goes_stale_by_the_file_servers_clock(tmp_path, monkeypatch):
    """This machine's clock is ten hours ahead: what counts is when the lock was touched, by the clock of the files."""
    _left_behind(tmp_path, host="elsewhere", boot="another")
    clock = locks.time.time
    monkeypatch.setattr(locks.time, "time", lambda: clock() + 36000)
    with pytest.raises(Busy, match=r"process \d+ on elsewhere"):
        acquire(tmp_path, "", STUDY)
    path = next((tmp_path / "locks").glob("*.lock"))
    old = path.stat().st_mtime - locks.STALE - 1
    os.utime(path, (old, old))
    acquire(tmp_path, "", STUDY).release()


def test_an_earlier_turn_of_the_same_job_gives_way(tmp_path, monkeypatch):
    _left_behind(tmp_path, host="elsewhere", boot="another", job="17", turn=0)
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    monkeypatch.setattr(locks, "_states", lambda jobs: {})
    with pytest.raises(Busy):
        acquire(tmp_path, "", STUDY)
    monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
    acquire(tmp_path, "", STUDY).release()


def test_of_slurms_word(tmp_path, monkeypatch):
    """A job that SLURM does not know is gone; a suspended one lives, however long its lock is untouched; the numbers
    and the jobs of other clusters and users say nothing."""
    for job, changes, state, old, busy in (
        ("17", {}, set(), False, False),
        ("17", {}, {"RUNNING"}, False, True),
        ("17", {}, {"RUNNING"}, True, False),
        ("17", {}, {"SUSPENDED"}, True, True),
        ("17", {"cluster": "other"}, set(), False, True),
        ("17", {"user": -1}, set(), False, True),
        ("", {}, set(), False, True),
    ):
        place = tmp_path / str(len(list(tmp_path.iterdir())))
        place.mkdir()
        _left_behind(place, host="elsewhere", boot="another", **{"job": job, "cluster": "here", **changes})
        monkeypatch.setenv("SLURM_CLUSTER_NAME", "here")
        monkeypatch.setattr(locks, "_states", lambda jobs, state=state: {job: state for job in jobs if job})
        path = next((place / "locks").glob("*.lock"))
        if old:
            then = path.stat().st_mtime - locks.STALE - 1
            os.utime(path, (then, then))
        if busy:
            with pytest.raises(Busy):
                acquire(place, "", STUDY)
        else:
            acquire(place, "", STUDY).release()


def test_slurm_is_asked_once_for_all(tmp_path, monkeypatch):
    squeue = tmp_path / "squeue"
    squeue.write_text(f"#!/bin/sh\necho asked >> {tmp_path}/asked\necho '17_3 RUNNING'; echo '18 SUSPENDED'\n")
    squeue.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    assert locks._states(["17_3", "18", "17_4", ""]) == {"17_3": {"RUNNING"}, "18": {"SUSPENDED"}, "17_4": set()}
    assert (tmp_path / "asked").read_text() == "asked\n"
    squeue.write_text("#!/bin/sh\nexit 1\n")
    assert locks._states(["17_3"]) == {}


def test_two_hosts_of_one_name_are_not_taken_for_one_that_was_started_anew(tmp_path):
    _left_behind(tmp_path, boot="another")
    with pytest.raises(Busy):
        acquire(tmp_path, "", STUDY)
    path = next((tmp_path / "locks").glob("*.lock"))
    then = path.stat().st_mtime - 4 * locks.BEAT
    os.utime(path, (then, then))
    acquire(tmp_path, "", STUDY).release()


def test_a_gate_that_was_opened_meanwhile_stays_closed(tmp_path):
    """Two find it stale; the first has opened it and gone in when the second comes to open it."""
    gate = tmp_path / "gate"
    gate.mkdir()
    old = gate.stat().st_mtime - locks.GATE_STALE - 1
    os.utime(gate, (old, old))
    seen = gate.stat()
    assert locks._open_left(gate, seen)
    gate.mkdir()
    assert not locks._open_left(gate, seen)
    assert gate.is_dir()
    assert list(tmp_path.iterdir()) == [gate]


def test_a_gate_left_closed_is_opened(tmp_path):
    gate = tmp_path / "locks" / "gate"
    gate.mkdir(parents=True)
    old = gate.stat().st_mtime - locks.GATE_STALE - 1
    os.utime(gate, (old, old))
    acquire(tmp_path, "", STUDY).release()


def test_a_lock_that_was_taken_is_noticed_and_left_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "BEAT", 0.02)
    lock = acquire(tmp_path, "", STUDY)
    lock.path.write_text(json.dumps(vars(myself("", STUDY))))
    lock._thread.join(timeout=5)
    assert lock.lost
    lock.release()
    assert lock.path.exists()


def test_a_sick_file_server_does_not_take_the_lock(tmp_path, monkeypatch):
    """What cannot be read for a while is not lost: the run goes on, and touches its lock when it can again."""
    monkeypatch.setattr(locks, "BEAT", 0.02)
    read, sick = locks.Path.read_text, threading.Event()

    def stale(path, **words):
        if sick.is_set() and path.suffix == ".lock":
            seen.release()
            raise OSError(116, "Stale file handle")
        return read(path, **words)

    seen = threading.Semaphore(0)
    monkeypatch.setattr(locks.Path, "read_text", stale)
    lock = acquire(tmp_path, "", STUDY)
    sick.set()
    assert all(seen.acquire(timeout=60) for _ in range(3))
    sick.clear()
    assert not lock.lost
    assert lock._thread.is_alive()
    lock.release()
    assert not lock.path.exists()


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CannotWrite, match="cannot write"):
        acquire(tmp_path / "file", "", STUDY)
