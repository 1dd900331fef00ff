"""The store in memory and on disk: the same rows in, the same rows out."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import fakes
import pytest

from sweep import store
from sweep.point import Record
from sweep.store import CannotWrite, DiskStore, MemoryStore, OtherVersion, StoreError, settle


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
    part.close()
    again = DiskStore(tmp_path, "0", {"solver": "a"})
    again.append(record("third"))
    again.close()
    assert set(again.rows()) == {"first", "third"}


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
