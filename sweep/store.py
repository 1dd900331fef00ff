"""Rows on disk and in memory: one append-only journal for each writer, one ``results.nc`` made by ``merge``.

A journal is JSON lines: a header (solver version, packages, git state, study), then one row for each point.
Lines are flushed as they are written and synced each 20 rows or each second: a killed run loses what was
in flight and no more. Nobody but its writer writes a journal; nobody but ``merge`` writes ``results.nc``.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import xarray as xr

from .config import Study, load_study
from .dataset import assemble
from .plan import Plan, make_plan, read_plan, write_plan
from .point import Record
from .space import designs

SYNC_ROWS = 20
SYNC_SECONDS = 1.0
UNTRUSTED = frozenset(  # metrics, no trust
    {"UNRESOLVED", "COARSE_STEP", "ENERGY_OPEN", "FEW_HARMONICS", "UNSTABLE", "ROD_NEEDED"}
)

log = logging.getLogger(__name__)


class StoreError(RuntimeError):
    """The study's folder cannot be read or written; the text says what to do."""


class CannotWrite(StoreError):
    """A file cannot be written; ``resumable`` where that may pass (no space, a sick disk)."""

    def __init__(self, path: Path, error: OSError) -> None:
        self.resumable = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
        cure = "put that right, and run the same command again" if self.resumable else "choose another folder"
        super().__init__(
            f"cannot write {path}: {error.strerror or error}; {cure}. Rows written so far are safe."
        )


class OtherVersion(StoreError):
    """The folder holds rows of another solver version."""


def outcome(status: str) -> str:
    """``trusted``, ``untrusted`` (metrics without trust), ``failed`` (no metrics) or ``missing``."""
    if status == "OK":
        return "trusted"
    if status == "MISSING":
        return "missing"
    return "untrusted" if status in UNTRUSTED else "failed"


class Store(Protocol):
    """Where rows go, and where a resumed run finds them."""

    def append(self, record: Record) -> None: ...
    def rows(self) -> dict[str, Record]: ...
    def close(self) -> None: ...


def settle(records: Iterable[Record]) -> dict[str, Record]:
    """One row for each key: of duplicates the last trusted one, or the last one when none is."""
    kept: dict[str, Record] = {}
    for record in records:
        if record.trusted or not (record.key in kept and kept[record.key].trusted):
            kept[record.key] = record
    return kept


# --------------------------------------------------------------------------------------------- lines


def _plain(value: Any) -> Any:
    """JSON has no NaN and no infinity: null, "inf" and "-inf" stand for them."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return value


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def to_line(record: Record, at: float) -> bytes:
    """A row of the journal; ``at`` is the time of writing, which orders duplicates from several journals."""
    row = _plain(record.as_dict() | {"at": at})
    return json.dumps(row, allow_nan=False, separators=(",", ":")).encode() + b"\n"


_FLOATS = [f.name for f in fields(Record) if f.type == "float"]
_NAMES = [f.name for f in fields(Record)]


def from_row(row: Mapping[str, Any]) -> Record:
    """The record that ``to_line`` wrote."""
    known = {name: row[name] for name in _NAMES if name in row}
    known |= {name: _number(row[name]) for name in _FLOATS if name in row}
    for table in ("values", "metrics"):
        known[table] = {name: _number(value) for name, value in row.get(table, {}).items()}
    return Record(**known)


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """The complete lines of a journal, headers too; a torn last line is left out, a spoilt one is skipped."""
    with path.open("rb") as stream:
        for number, line in enumerate(stream, 1):
            if not line.endswith(b"\n"):
                return
            try:
                row = json.loads(line)
            except ValueError:
                log.warning("%s: line %d is not a row and is left out", path, number)
                continue
            yield row


# --------------------------------------------------------------------------------------------- stores


class MemoryStore:
    """Rows in a list, for notebooks and tests."""

    def __init__(self) -> None:
        self._records: list[Record] = []

    def append(self, record: Record) -> None:
        self._records.append(record)

    def rows(self) -> dict[str, Record]:
        return settle(self._records)

    def close(self) -> None:
        pass


class DiskStore:
    """A study's folder; rows are appended to the journal of ``writer``, and read from everybody's."""

    def __init__(
        self,
        directory: Path,
        writer: str = "0",
        header: Mapping[str, Any] | None = None,
        *,
        any_version: bool = False,
    ) -> None:
        self.directory = Path(directory)
        self.path = self.directory / "parts" / f"journal-{writer}.jsonl"
        self._header = dict(header or {})
        self._stream: BinaryIO | None = None
        self._unsynced, self._synced = 0, time.monotonic()
        if not any_version:
            self._same_version()

    def append(self, record: Record) -> None:
        """Write a row; once this returns, a killed process does not lose it."""
        self._write(to_line(record, time.time()))

    def rows(self) -> dict[str, Record]:
        return settle(read_records(self.directory))

    def close(self) -> None:
        if self._stream is not None:
            stream, self._stream = self._stream, None
            with complaint(self.path):
                try:
                    os.fsync(stream.fileno())
                finally:
                    stream.close()

    def open(self) -> None:
        """Lock the journal, cut a torn last line back, and say who writes from here on."""
        with complaint(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            stream = self.path.open("ab", buffering=0)
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                stream.close()
                raise StoreError(f"{self.path} is being written by another run: wait for it") from None
            except OSError:
                log.warning("%s: this file system has no locks; do not start the same run twice", self.path)
            _cut_torn_line(self.path)
            self._stream = stream
        headers = [row["header"] for row in read_journal(self.path) if "header" in row]
        header = _plain(self._header)
        if not headers or headers[-1] != header:
            self._write(json.dumps({"header": header}, separators=(",", ":")).encode() + b"\n")

    def _write(self, line: bytes) -> None:
        if self._stream is None:
            self.open()
        assert self._stream is not None
        with complaint(self.path):
            written = self._stream.write(line)
            if written != len(line):  # a full disk takes what it can; the next start cuts the torn line back
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            self._unsynced += 1
            if self._unsynced >= SYNC_ROWS or time.monotonic() - self._synced >= SYNC_SECONDS:
                os.fsync(self._stream.fileno())
                self._unsynced, self._synced = 0, time.monotonic()

    def _same_version(self) -> None:
        mine = self._header.get("solver")
        others = {header.get("solver") for header in read_headers(self.directory)} - {mine}
        if mine and others:
            raise OtherVersion(
                f"{self.directory} holds rows of another version of the solvers "
                f"({', '.join(sorted(map(str, others)))}; this one is {mine}). "
                "Use another folder, or add --force-version to mix them."
            )


@contextmanager
def complaint(path: Path) -> Iterator[None]:
    """Turn an OSError into a StoreError with the file, the reason and what to do."""
    try:
        yield
    except OSError as error:
        raise CannotWrite(path, error) from error


def open_store(
    directory: str | Path | None,
    writer: str = "0",
    header: Mapping[str, Any] | None = None,
    *,
    any_version: bool = False,
) -> MemoryStore | DiskStore:
    """A folder's store, or one in memory when ``directory`` is None."""
    if directory is None:
        return MemoryStore()
    return DiskStore(Path(directory), writer, header, any_version=any_version)


def _cut_torn_line(path: Path) -> None:
    if not path.is_file():
        return
    with path.open("r+b") as stream:
        size = end = stream.seek(0, os.SEEK_END)
        while end > 0:
            begin = max(0, end - 4096)
            stream.seek(begin)
            found = stream.read(end - begin).rfind(b"\n")
            end = begin + found + 1 if found >= 0 else begin
            if found >= 0:
                break
        if end < size:
            log.warning("%s: its last line was torn by a kill and is cut back", path)
            stream.truncate(end)


def pace(directory: str | Path) -> tuple[float, float]:
    """Rows per second over the last ten minutes, and how long ago the last row was written [s]."""
    now = time.time()
    times = [row["at"] for path in journals(Path(directory)) for row in read_journal(path) if "at" in row]
    recent = [at for at in times if at > now - 600]
    span = max(recent, default=now) - min(recent, default=now)
    return (len(recent) - 1) / span if span > 0 else 0.0, now - max(times, default=-float("inf"))


def journals(directory: Path) -> list[Path]:
    return sorted(Path(directory).glob("parts/journal-*.jsonl"))


def read_headers(directory: Path) -> list[dict[str, Any]]:
    """The headers of all journals, in the order of the files."""
    return [row["header"] for path in journals(directory) for row in read_journal(path) if "header" in row]


def read_records(directory: Path) -> list[Record]:
    """The rows of all journals in the order of their writing."""
    rows = [row for path in journals(directory) for row in read_journal(path) if "key" in row]
    rows.sort(key=lambda row: row.get("at", 0.0))
    return [from_row(row) for row in rows]


def write_whole(path: Path, write: Callable[[Path], object]) -> Path:
    """Call ``write(temporary path)``, sync, and put the file in place at once: nobody sees half of it."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with complaint(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write(temporary)
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            os.replace(temporary, path)
        finally:
            with suppress(FileNotFoundError):
                temporary.unlink()
    return path


# --------------------------------------------------------------------------------------------- folders


def study_of(directory: str | Path) -> Study:
    """The study that a folder holds."""
    path = Path(directory) / "study.yaml"
    if not path.is_file():
        what = "is no results folder: it has no study.yaml" if Path(directory).is_dir() else "does not exist"
        raise StoreError(f"{directory} {what}. `sweep run STUDY.yaml --out {directory}` makes one.")
    return load_study(path)


def prepare(study: Study, directory: str | Path, limit: int | None = None) -> Plan:
    """The folder's plan; written, with the study beside it, when new, longer, or of a changed study."""
    directory = Path(directory)
    path = directory / "plan.json"
    count = len(designs(study, limit))
    if path.is_file():
        known = read_plan(path)
        if known.text == study.text and len(known.designs) >= count:
            return known
        if known.text != study.text:
            log.warning("%s is of an earlier form of this study; points that did not change are kept", path)
    plan = make_plan(study, limit)
    write_whole(directory / "study.yaml", lambda place: place.write_text(study.text, encoding="utf-8"))
    write_whole(path, lambda place: write_plan(plan, place))
    return plan


def dataset_of(directory: str | Path) -> xr.Dataset:
    """The dataset of a folder's journals as they are now."""
    directory = Path(directory)
    study = study_of(directory)
    rows = settle(read_records(directory))
    return assemble(study, read_plan(directory / "plan.json"), rows, read_headers(directory))


def merge(directory: str | Path) -> Path:
    """Make ``results.nc`` of the journals and return its path."""
    dataset = dataset_of(directory)
    return write_whole(
        Path(directory) / "results.nc", lambda place: dataset.to_netcdf(place, engine="netcdf4")
    )


def open_study(directory: str | Path) -> xr.Dataset:
    """The results of a study's folder: ``results.nc``, or the journals where they are newer."""
    path = Path(directory) / "results.nc"
    parts = [part.stat().st_mtime for part in journals(Path(directory))]
    if not path.is_file() or any(part > path.stat().st_mtime for part in parts):
        return dataset_of(directory)
    with xr.open_dataset(path, engine="netcdf4") as dataset:
        return dataset.load()
