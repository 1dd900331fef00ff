"""The store in memory and on disk: the same rows in, the same rows out."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import fakes
import numpy as np
import pytest
import xarray as xr
import yaml

from sweep import open_study, store
from sweep.config import parse_study
from sweep.plan import Keys
from sweep.point import Record
from sweep.store import CannotWrite, DiskStore, MemoryStore, OtherVersion, Replay, StoreError, prepare, settle

TINY = Path(__file__).with_name("tiny.yaml")


@pytest.fixture(params=["memory", "disk"])
def rows(request, tmp_path):
    """A store, closed at the end."""
    made = MemoryStore() if request.param == "memory" else DiskStore(tmp_path, "0", {"solver": "a"})
    yield made
    made.close()


def record(key="k", status="OK", **metrics) -> Record:
    return replace(fakes.evaluate(fakes.make(1)), key=key, status=status, metrics=metrics)


def same(a: Record, b: Record) -> bool:
    """Equal, with NaN equal to NaN."""
    return repr(a) == repr(b)


def test_rows_come_back_as_they_went_in(rows):
    went = record("k", a=1 / 3, b=math.nan, c=math.inf, d=-math.inf, e=1e-320, f=-0.0)
    rows.append(went)
    assert same(rows.rows()["k"], went)


@pytest.mark.parametrize(
    ("statuses", "wins"),
    [
        ("ERROR OK", 1),
        ("OK ERROR", 0),
        ("OK OK", 1),
        ("ERROR TIMEOUT", 1),
        ("OK ENERGY_OPEN", 0),
        ("ERROR OK TIMEOUT", 1),
    ],
)
def test_of_duplicates_the_last_trusted_wins(rows, statuses, wins):
    for i, status in enumerate(statuses.split()):
        rows.append(record("k", status, a=float(i)))
    assert rows.rows()["k"].metrics["a"] == wins


def test_an_empty_store_has_no_rows(rows):
    assert rows.rows() == {}


def test_duplicates_from_several_journals_are_ordered_by_time(tmp_path):
    for writer, value in (("1", 1.0), ("0", 2.0)):
        part = DiskStore(tmp_path, writer)
        part.append(record("k", a=value))
        part.close()
    assert DiskStore(tmp_path, "2").rows()["k"].metrics["a"] == 2.0


def test_a_journal_is_strict_json_with_one_header(tmp_path):
    for _ in range(2):
        part = DiskStore(tmp_path, "0", {"solver": "a"})
        part.append(record("k", a=math.nan))
        part.close()
    lines = (tmp_path / "parts/journal-0.jsonl").read_text().splitlines()

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    read = [json.loads(line, parse_constant=refuse) for line in lines]
    assert [next(iter(row)) for row in read] == ["header", "start", "key", "start", "key"]
    assert [row["start"]["turn"] for row in read if "start" in row] == [1, 2]


@pytest.mark.parametrize("torn", [b"", b'{"key": "x", "des', b"\xff" * 9000])
def test_a_torn_last_line_is_cut_back_before_appending(tmp_path, torn):
    part = DiskStore(tmp_path, "0", {"solver": "a"})
    part.append(record("first"))
    part.close()
    with part.path.open("ab") as stream:
        stream.write(torn)
    assert set(part.rows()) == {"first"}
    again = DiskStore(tmp_path, "0", {"solver": "a"})
    again.append(record("second"))
    again.close()
    assert set(again.rows()) == {"first", "second"}


def test_a_spoilt_line_costs_its_row_only(tmp_path):
    part = DiskStore(tmp_path, "0")
    part.append(record("first"))
    with part.path.open("ab") as stream:
        stream.write(b"\x00\x00\x00\n")
    part.append(record("second"))
    part.close()
    assert set(part.rows()) == {"first", "second"}


def test_another_solver_version_is_refused_unless_told(tmp_path):
    part = DiskStore(tmp_path, "0", {"solver": "a"})
    part.append(record("k"))
    part.close()
    with pytest.raises(OtherVersion, match=r"another version.*--force-version"):
        DiskStore(tmp_path, "0", {"solver": "b"})
    DiskStore(tmp_path, "0", {"solver": "b"}, any_version=True).close()


def test_one_journal_has_one_writer(tmp_path):
    part = DiskStore(tmp_path, "0")
    part.append(record("k"))
    with pytest.raises(StoreError, match="another run"):
        DiskStore(tmp_path, "0").append(record("k"))
    part.close()


def test_a_full_disk_is_a_sentence_and_costs_one_row(tmp_path):
    part = DiskStore(tmp_path, "0", {"solver": "a"})
    part.append(record("first"))
    with (
        fakes.full_disk(part.path.stat().st_size + 50),
        pytest.raises(CannotWrite, match="cannot write") as caught,
    ):
        part.append(record("second"))
    assert caught.value.resumable
    assert part.path.read_bytes().endswith(b"}\n")  # and so the next line stands on its own
    part.append(record("room again"))
    part.close()
    again = DiskStore(tmp_path, "0", {"solver": "a"})
    again.append(record("third"))
    again.close()
    assert set(again.rows()) == {"first", "room again", "third"}


def test_rows_are_synced_though_no_other_follows(tmp_path, monkeypatch):
    """A short point's row does not wait for that of the long point after it."""
    part = DiskStore(tmp_path, "0")
    part.append(record("first"))
    part.append(record("second"))
    assert part._unsynced
    part.tick()
    assert part._unsynced
    monkeypatch.setattr(store, "SYNC_SECONDS", 0.0)
    part.tick()
    assert not part._unsynced
    part.close()


def test_turns_order_duplicates_where_clocks_differ(tmp_path, monkeypatch):
    """The second run's node is a day behind: its row is the later one all the same."""
    clock = store.time.time
    for writer, value, behind in (("0", 1.0, 0), ("1", 2.0, 86400)):
        monkeypatch.setattr(store.time, "time", lambda behind=behind: clock() - behind)
        part = DiskStore(tmp_path, writer)
        part.append(record("00", "TIMEOUT", a=value))
        part.close()
    assert DiskStore(tmp_path, "2").rows()["00"].metrics["a"] == 2.0
    assert next(Replay(tmp_path, Keys.of(["00"])).records([0])).metrics["a"] == 2.0


def test_a_journal_that_cannot_be_read_is_said(tmp_path):
    (tmp_path / "parts" / "journal-0.jsonl").mkdir(parents=True)
    with pytest.raises(StoreError, match=r"cannot read .*journal-0\.jsonl"):
        Replay(tmp_path, Keys.of(["00"]))


def test_a_week_of_requeued_arrays_has_many_turns(tmp_path):
    for turn, value in ((70_000, 1.0), (70_001, 2.0)):
        part = DiskStore(tmp_path, "0", turn=turn)
        part.append(record("00", "TIMEOUT", a=value))
        part.close()
    replay = Replay(tmp_path, Keys.of(["00"]))
    assert (replay.turn, next(replay.records([0])).metrics["a"]) == (70_001, 2.0)


@pytest.mark.parametrize(
    "statuses", ["ERROR OK", "OK ERROR", "OK OK", "ERROR TIMEOUT", "OK ENERGY_OPEN", "ERROR OK TIMEOUT"]
)
def test_a_replay_settles_as_a_store_does(tmp_path, statuses):
    part = DiskStore(tmp_path, "0")
    for i, status in enumerate(statuses.split()):
        part.append(record("0b", status, a=float(i)))
        part.append(record(f"{i:02d}", "OK", a=-1.0))
    part.close()
    replay = Replay(tmp_path, Keys.of(["aa", "0b", "00"]))
    assert [replay.names[code] for code in replay.status] == ["MISSING", part.rows()["0b"].status, "OK"]
    assert same(replay.table(slice(1, 2))["0b"], part.rows()["0b"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Forty points of a study in three journals, the second run's row trusted where the first one's was not."""
    out = tmp_path_factory.mktemp("folder")
    whole = parse_study(yaml.safe_load(TINY.read_text().replace("n: 6,", "n: 40,")))
    plan = prepare(whole, out)
    header = {"solver": "a"}
    for writer in range(3):
        part = DiskStore(out, str(writer), header, turn=1)
        part.open()
        for i in range(writer, 40, 3):
            part.append(_row(plan, i, "TIMEOUT" if i % 7 == 0 else "OK"))
        part.close()
    part = DiskStore(out, "0", header, turn=2)
    for i in range(0, 40, 7):
        part.append(_row(plan, i, "OK"))
    part.close()
    return whole, plan, out


def _row(plan, i, status):
    order = plan.order(i)
    metrics = {"delta": i / 3, "gamma": math.nan if status != "OK" else 0.5, "odd_spread": float(i)}
    return Record(key=order.key, design=i, environment=0, values=order.values, status=status, metrics=metrics)


def test_a_journal_torn_at_any_byte_is_made_good(folder, tmp_path):
    """200 cuts at random bytes, half of them with a tail of zeros: lost rows run again, and the file is the same."""
    _, plan, out = folder
    truth = store.dataset_of(out)
    rows = repr(sorted(Replay(out, plan.keys).table(slice(None)).items()))
    rng = np.random.default_rng(7)
    text = (out / "parts/journal-0.jsonl").read_bytes()
    shutil.copytree(out, tmp_path / "torn")
    torn = tmp_path / "torn"
    path = torn / "parts/journal-0.jsonl"
    lost = []
    for n, cut in enumerate(rng.integers(0, len(text), 200)):
        path.write_bytes(text[:cut] + bytes(64) * (n % 2))
        replay = Replay(torn, plan.keys)
        missing = [int(i) for i in np.flatnonzero([replay.names[code] != "OK" for code in replay.status])]
        lost.append(len(missing))
        part = DiskStore(torn, "0", {"solver": "a"})
        for i in missing:
            part.append(_row(plan, i, "OK"))
        part.close()
        again = Replay(torn, plan.keys)
        assert repr(sorted(again.table(slice(None)).items())) == rows
        if n % 20 == 0:
            xr.testing.assert_identical(store.dataset_of(torn), truth)
    assert max(lost) == 18  # 14 of the first journal, and the four others whose first row was not trusted
    assert min(lost) == 1  # no cut leaves the last row whole


def test_results_made_in_pieces_are_the_same(folder, monkeypatch):
    _, _, out = folder
    whole = open_study(out).copy(deep=True)
    for piece in (4096, 7, 1):
        monkeypatch.setattr(store, "PIECE", piece)
        with xr.open_dataset(store.merge(out)) as made:
            xr.testing.assert_identical(made.load(), whole)


@pytest.fixture
def copy(folder, tmp_path):
    """The folder's study and plan, and a copy of it without results."""
    whole, plan, out = folder
    shutil.copytree(out, tmp_path / "copy")
    (tmp_path / "copy" / "results.nc").unlink(missing_ok=True)
    return whole, plan, tmp_path / "copy"


def _rows_while_it_is_made(monkeypatch, do) -> None:
    """Let something happen once, after a merge has read the journals and before it writes."""
    stream, left = store._stream, [do]

    def slow(*words):
        if left:
            left.pop()()
        stream(*words)

    monkeypatch.setattr(store, "_stream", slow)


def test_rows_that_come_during_a_merge_are_not_hidden_by_its_file(copy, monkeypatch):
    _, plan, out = copy

    _rows_while_it_is_made(monkeypatch, lambda: _late_row(plan, out))
    store.merge(out)
    with xr.open_dataset(out / "results.nc") as made:
        assert made["delta"].values[3] == 1.0
    assert open_study(out)["delta"].values[3] == -5.0


def _changed(plan, i):
    return replace(_row(plan, i, "OK"), metrics={"delta": -5.0})


def _late_row(plan, out):
    part = DiskStore(out, "9", {"solver": "a"})
    part.append(_changed(plan, 3))
    part.close()


def test_a_slow_merge_does_not_replace_the_file_of_a_later_one(copy, monkeypatch):
    _, plan, out = copy

    def overtake():
        _late_row(plan, out)
        store.merge(out)

    _rows_while_it_is_made(monkeypatch, overtake)
    store.merge(out)
    with xr.open_dataset(out / "results.nc") as made:
        assert made["delta"].values[3] == -5.0
    assert [path.name for path in out.glob(".*")] == []


def test_a_plan_that_is_newer_than_the_results_counts(copy):
    """A changed study that was stopped before its first row."""
    _, _, out = copy
    store.merge(out)
    prepare(parse_study(yaml.safe_load(TINY.read_text())), out)
    assert open_study(out).sizes["point"] == 6


def test_a_study_and_a_plan_of_another_are_not_taken_together(copy):
    """Killed between the two files; the next run puts it right, whichever of the studies it has."""
    whole, _, out = copy
    other = parse_study(yaml.safe_load(TINY.read_text()))
    (out / "study.yaml").write_text(other.text)
    with pytest.raises(StoreError, match=r"plan\.json is not of study\.yaml"):
        store.merge(out)
    prepare(whole, out)
    assert store.contents(out)[0].text == whole.text


def test_what_killed_merges_leave_is_removed(copy):
    _, _, out = copy
    for name, age in ((".results.nc.elsewhere.7", 2 * store.ABANDONED), (".results.nc.elsewhere.8", 0.0)):
        (out / name).touch()
        then = (out / name).stat().st_mtime - age
        store.os.utime(out / name, (then, then))
    store.merge(out)
    assert [path.name for path in out.glob(".*")] == [".results.nc.elsewhere.8"]


def test_write_whole_leaves_the_old_file_where_the_new_one_fails(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")

    def fail(place):
        place.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(CannotWrite):
        store.write_whole(path, fail)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert path.read_text() == "old"


def test_settle_keeps_the_first_place_of_a_key():
    assert list(settle([record("b"), record("a"), record("b")])) == ["b", "a"]
