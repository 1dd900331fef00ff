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


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CannotWrite, match="cannot write"):
        acquire(tmp_path / "file", "", STUDY)
