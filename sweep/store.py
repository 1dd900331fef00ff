"""Rows on disk and in memory: one append-only journal for each writer, one ``results.nc`` made by ``merge``.

A journal is JSON lines: a header (solver version, packages, git state, study), a line for each start (turn, host,
job), then one row for each point. Lines are flushed as they are written and synced each 20 rows or each second: a
killed run loses what was in flight and no more. Nobody but its writer writes a journal; nobody but ``merge`` writes
``results.nc``. Rows of a point are ordered by turn, which every start of a run raises, and only within a turn by
clock: clocks of nodes differ. Reading keeps places of rows, not rows: some 30 bytes for each point.
"""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import math
import os
import socket
import threading
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

import numpy as np

from .config import Study, load_study
from .plan import Keys, Plan, make_plan, read_plan, write_plan
from .point import Record
from .space import count_designs

if TYPE_CHECKING:
    import xarray as xr

SYNC_ROWS = 20
SYNC_SECONDS = 1.0
PIECE = 4096  # points of results.nc made at a time
OPEN_FILES = 64  # journals held open while rows are collected
ABANDONED = 3600.0  # a temporary file that nobody has written to for so long is a killed run's [s]
SEARCH = "optimise.json"  # what `sweep optimise` keeps beside the plan
RECENT = 600.0  # span over which a journal's pace is taken [s]
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


class CannotRead(StoreError):
    """A file cannot be read; ``resumable`` where that may pass."""

    def __init__(self, path: Path, error: OSError) -> None:
        self.resumable = error.errno in (errno.ESTALE, errno.EIO)
        super().__init__(f"cannot read {path}: {error.strerror or error}")


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

    def open(self) -> None: ...
    def append(self, record: Record) -> None: ...
    def tick(self) -> None: ...
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
_NEEDED = {"key", "design", "environment", "status"}


def from_row(row: Mapping[str, Any]) -> Record:
    """The record that ``to_line`` wrote."""
    known = {name: row[name] for name in _NAMES if name in row}
    known |= {name: _number(row[name]) for name in _FLOATS if name in row}
    for table in ("values", "metrics"):
        known[table] = {name: _number(value) for name, value in row.get(table, {}).items()}
    return Record(**known)


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """The complete lines of a journal, headers too; a torn last line is left out, a spoilt one is skipped."""
    return (row for _, row in _lines(path))


def _lines(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Each complete line with the byte at which it begins."""
    place = 0
    with path.open("rb") as stream:
        for number, line in enumerate(stream, 1):
            if not line.endswith(b"\n"):
                return
            row = _row(line)
            if row is None:
                log.warning("%s: line %d is not a row and is left out", path, number)
            else:
                yield place, row
            place += len(line)


def _row(line: bytes) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    if not isinstance(row, dict) or not (row.keys() & {"header", "start"} or row.keys() >= _NEEDED):
        return None
    return row


# --------------------------------------------------------------------------------------------- stores


class MemoryStore:
    """Rows in a list, for notebooks and tests."""

    def __init__(self) -> None:
        self._records: list[Record] = []

    def open(self) -> None:
        pass

    def append(self, record: Record) -> None:
        self._records.append(record)

    def tick(self) -> None:
        pass

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
        turn: int | None = None,
    ) -> None:
        self.directory = Path(directory)
        self.turn = turn  # of this run; None takes the one after the last
        self.path = self.directory / "parts" / f"journal-{writer}.jsonl"
        self._header = dict(header or {})
        self._stream: BinaryIO | None = None
        self._unsynced, self._synced = 0, time.monotonic()
        self._syncing: threading.Thread | None = None
        self._failure: OSError | None = None
        if not any_version:
            same_version(self.directory, self._header.get("solver"), read_headers(self.directory))

    def append(self, record: Record) -> None:
        """Write a row; once this returns, a killed process does not lose it."""
        self._write(to_line(record, time.time()))

    def rows(self) -> dict[str, Record]:
        return settle(read_records(self.directory))

    def close(self) -> None:
        if self._stream is not None:
            stream, self._stream = self._stream, None
            if self._syncing is not None:
                self._syncing.join()
            with complaint(self.path):
                try:
                    if self._failure is not None:
                        raise self._failure
                    os.fsync(stream.fileno())
                finally:
                    stream.close()

    def open(self) -> None:
        """Lock the journal, cut a torn last line back, and say who writes from here on."""
        with complaint(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            new = not self.path.exists()
            stream = self.path.open("ab", buffering=0)
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                stream.close()
                raise StoreError(f"{self.path} is being written by another run: wait for it") from None
            except OSError:
                log.warning("%s: this file system has no locks; do not start the same run twice", self.path)
            _cut_torn_line(self.path)
            if new:
                _sync_folder(self.path.parent)
            self._stream = stream
        headers = [row["header"] for line in _beginning(self.path, b'{"header"') if (row := _row(line))]
        header = _plain(self._header)
        if not headers or headers[-1] != header:
            self._write(_line({"header": header}))
        turn = 1 + last_turn(self.directory) if self.turn is None else self.turn
        start = {"turn": turn, "host": socket.gethostname(), "job": job_name(), "at": time.time()}
        self._write(_line({"start": start}))

    def _write(self, line: bytes) -> None:
        if self._stream is None:
            self.open()
        assert self._stream is not None
        with complaint(self.path):
            end = self._stream.seek(0, os.SEEK_END)
            rest = memoryview(line)
            try:
                while rest:  # a full disk, or a network's, takes what it can
                    rest = rest[self._stream.write(rest) or 0 :]
            except OSError:
                with suppress(OSError):  # else the next line would be glued to a torn one; a killed run's is cut back
                    self._stream.truncate(end)
                raise
            self._unsynced += 1
            self.tick()

    def tick(self) -> None:
        """Sync what was written, if it is time."""
        if self._unsynced >= SYNC_ROWS or (self._unsynced and time.monotonic() - self._synced >= SYNC_SECONDS):
            with complaint(self.path):
                self._sync()

    def _sync(self) -> None:
        """Sync aside: a busy disk takes long over it, and the worker would wait. What fails is said at the next row."""
        if self._syncing is not None:
            if self._syncing.is_alive():
                return
            self._syncing = None
            if self._failure is not None:
                raise self._failure
        assert self._stream is not None
        self._unsynced, self._synced = 0, time.monotonic()
        self._syncing = threading.Thread(target=self._sync_now, args=(self._stream.fileno(),), name="sync")
        self._syncing.start()

    def _sync_now(self, handle: int) -> None:
        try:
            os.fsync(handle)
        except OSError as error:
            self._failure = error


def same_version(directory: Path, mine: str | None, headers: Iterable[Mapping[str, Any]]) -> None:
    """Raise OtherVersion where rows are of other solvers than ``mine``."""
    others = {header.get("solver") for header in headers} - {mine}
    if mine and others:
        raise OtherVersion(
            f"{directory} holds rows of another version of the solvers "
            f"({', '.join(sorted(map(str, others)))}; this one is {mine}). "
            "Use another folder, or add --force-version to mix them."
        )


def job_name() -> str:
    """The SLURM job that this process belongs to: ``17``, ``17_3`` for an array task, nothing outside SLURM."""
    array, task = os.environ.get("SLURM_ARRAY_JOB_ID"), os.environ.get("SLURM_ARRAY_TASK_ID")
    return f"{array}_{task}" if array and task else os.environ.get("SLURM_JOB_ID", "")


def _line(row: Mapping[str, Any]) -> bytes:
    return json.dumps(row, separators=(",", ":")).encode() + b"\n"


def _beginning(path: Path, start: bytes) -> Iterator[bytes]:
    """Complete lines of a journal that begin so; much faster than reading all of them."""
    with path.open("rb") as stream:
        yield from (line for line in stream if line.startswith(start) and line.endswith(b"}\n"))


def _sync_folder(folder: Path) -> None:
    """Make a new name in a folder last; file systems that cannot are left alone."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


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
    turn: int | None = None,
) -> MemoryStore | DiskStore:
    """A folder's store, or one in memory when ``directory`` is None."""
    if directory is None:
        return MemoryStore()
    return DiskStore(Path(directory), writer, header, any_version=any_version, turn=turn)


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


def journals(directory: Path) -> list[Path]:
    return sorted(Path(directory).glob("parts/journal-*.jsonl"))


def read_headers(directory: Path) -> list[dict[str, Any]]:
    """The distinct headers of all journals, in the order of the files."""
    lines = dict.fromkeys(line for path in journals(directory) for line in _beginning(path, b'{"header"'))
    rows = [_row(line) for line in lines]
    return [row["header"] for row in rows if row]


def last_turn(directory: Path) -> int:
    """The turn of the latest start in any journal."""
    rows = [_row(line) for path in journals(directory) for line in _beginning(path, b'{"start"')]
    return max((int(row["start"]["turn"]) for row in rows if row), default=0)


def jobs_begun(directory: Path) -> set[str]:
    """The jobs that have written to any journal."""
    rows = [_row(line) for path in journals(directory) for line in _beginning(path, b'{"start"')]
    return {str(row["start"]["job"]) for row in rows if row}


def read_records(directory: Path) -> list[Record]:
    """The rows of all journals in the order of their writing."""
    rows = []
    for path in journals(directory):
        turn = 0
        for row in read_journal(path):
            turn = row["start"]["turn"] if "start" in row else turn
            if "key" in row:
                rows.append((turn, row.get("at", 0.0), row))
    rows.sort(key=lambda found: found[:2])
    return [from_row(row) for _, _, row in rows]


# --------------------------------------------------------------------------------------------- replay


@dataclass
class Journal:
    """What one writer has done."""

    writer: str  # rank, with the slice before it: 3, part2of8-0
    host: str = ""
    job: str = ""
    turn: int = 0
    fruitful: int = 0  # turn of the last row
    idle: list[int] = field(default_factory=list)  # turns begun since
    rows: int = 0
    failed: int = 0
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=256))  # when the last rows were written
    touched: float = 0.0  # when the file was, by the clock that stamps files

    @property
    def pace(self) -> float:
        """Rows per second by the writer's own clock, over its last ten minutes of work."""
        last = self.recent[-1] if self.recent else 0.0
        times = [at for at in self.recent if at > last - RECENT]
        span = max(times, default=0.0) - min(times, default=0.0)
        return (len(times) - 1) / span if span > 0 else 0.0


class Replay:
    """Which row of which journal counts for each point of a plan: of several the last trusted, or the last.

    Holds 29 bytes for each point. Equal keys share their first place.
    """

    def __init__(self, directory: str | Path, keys: Keys) -> None:
        n = len(keys)
        self.directory, self.keys = Path(directory), keys
        self.paths = journals(self.directory)
        self.journals: list[Journal] = []
        self.names = ["MISSING"]  # of statuses
        self.status = np.zeros(n, dtype=np.uint8)  # index into names
        self.metrics: set[str] = set()
        self.began: dict[str, int] = {}  # the turn in which a job wrote first
        headers: dict[str, dict[str, Any]] = {}
        self._where = np.zeros(n, dtype=np.int64)  # journal << 40 | byte
        self.turns = np.zeros(n, dtype=np.uint32)  # of the rows; a week of requeued arrays has many
        self._at = np.zeros(n)
        for number, path in enumerate(self.paths):
            try:
                self._read(number, path, headers)
            except OSError as error:
                raise CannotRead(path, error) from error
        self.headers = list(headers.values())

    def _read(self, number: int, path: Path, headers: dict[str, dict[str, Any]]) -> None:
        journal = Journal(writer=path.stem.removeprefix("journal-"), touched=path.stat().st_mtime)
        self.journals.append(journal)
        codes = {name: code for code, name in enumerate(self.names)}
        for byte, row in _lines(path):
            if "start" in row:
                start = row["start"]
                journal.host, journal.job, journal.turn = start["host"], start["job"], start["turn"]
                journal.idle.append(journal.turn)
                self.began[journal.job] = min(journal.turn, self.began.get(journal.job, journal.turn))
            if "header" in row:
                headers.setdefault(json.dumps(row["header"]), row["header"])
            if "key" not in row:
                continue
            status, at = row["status"], row.get("at", 0.0)
            journal.rows += 1
            journal.fruitful, journal.idle = journal.turn, []
            journal.failed += outcome(status) == "failed"
            journal.recent.append(at)
            place = self.place(row["key"])
            if place is None:
                continue
            if status not in codes:
                codes[status] = len(self.names)
                self.names.append(status)
            old = self.names[self.status[place]]
            latest = (journal.turn, at) >= (self.turns[place], self._at[place])
            if old == "MISSING" or (status == "OK" and old != "OK") or (latest and (status == "OK" or old != "OK")):
                self.status[place], self._where[place] = codes[status], number << 40 | byte
                self.turns[place], self._at[place] = journal.turn, at
                self.metrics.update(row.get("metrics", ()))

    def place(self, key: str) -> int | None:
        """First place of a key in the plan."""
        try:
            number = np.uint64(int(key, 16))
        except (ValueError, OverflowError):
            return None
        i = int(np.searchsorted(self.keys.numbers, number, sorter=self.keys.order))
        if i == len(self.keys.order) or self.keys.numbers[self.keys.order[i]] != number:
            return None
        return int(self.keys.order[i])

    @property
    def turn(self) -> int:
        """The latest turn."""
        return max((journal.turn for journal in self.journals), default=0)

    def firsts(self, places: slice) -> np.ndarray:
        """For each place of a stretch, the first place with the same key."""
        numbers = self.keys.numbers[places]
        found = self.keys.order[np.searchsorted(self.keys.numbers, numbers, sorter=self.keys.order)]
        return np.asarray(found)

    def records(self, places: Iterable[int]) -> Iterator[Record]:
        """The rows of places that have one, in the order of the files."""
        wanted = sorted({int(self._where[i]) for i in places if self.status[i]})
        files: OrderedDict[int, BinaryIO] = OrderedDict()
        try:
            for where in wanted:
                number, byte = where >> 40, where & ((1 << 40) - 1)
                if number not in files:
                    if len(files) >= OPEN_FILES:
                        files.popitem(last=False)[1].close()
                    files[number] = self.paths[number].open("rb")
                files[number].seek(byte)
                row = _row(files[number].readline())
                if row is None:
                    raise StoreError(f"{self.paths[number]} has changed while it was read: run the command again")
                yield from_row(row)
        finally:
            for stream in files.values():
                stream.close()

    def table(self, places: slice) -> dict[str, Record]:
        """The rows of a stretch of the plan, by key."""
        return {record.key: record for record in self.records(self.firsts(places))}


def write_whole(path: Path, write: Callable[[Path], object]) -> Path:
    """Call ``write(temporary path)``, sync, and put the file in place at once: nobody sees half of it.

    A ``write`` that returns False has thought better of it, and the file stays as it was.
    """
    temporary = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}")
    with complaint(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            wanted = write(temporary)
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            _forget_abandoned(path, temporary)
            if wanted is not False:
                os.replace(temporary, path)
                _sync_folder(path.parent)
        except RuntimeError as error:  # netCDF's word for a full or sick disk
            raise OSError(errno.EIO, str(error)) from error
        finally:
            with suppress(FileNotFoundError):
                temporary.unlink()
    return path


def _forget_abandoned(path: Path, temporary: Path) -> None:
    """Remove what killed runs left of a file that they were writing."""
    now = temporary.stat().st_mtime
    for other in path.parent.glob(f".{path.name}.*"):
        with suppress(OSError):  # another may do the same at this moment
            if other != temporary and now - other.stat().st_mtime > ABANDONED:
                other.unlink()


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
    if searched(directory):
        raise StoreError(f"{directory} is of `sweep optimise`, which plans its own designs: use another folder")
    if path.is_file():
        known = read_plan(path)
        if known.text == study.text and len(known.designs) >= min(count_designs(study), limit or math.inf):
            text = directory / "study.yaml"
            if not text.is_file() or text.read_text(encoding="utf-8") != study.text:
                write_whole(text, lambda place: place.write_text(study.text, encoding="utf-8"))
            return known
        if known.text != study.text:
            log.warning("%s is of an earlier form of this study; points that did not change are kept", path)
    plan = make_plan(study, limit)
    keep_plan(study, plan, directory)
    return plan


def contents(directory: str | Path) -> tuple[Study, Plan]:
    """A folder's study and its plan, which are of one another."""
    study = study_of(directory)
    plan = read_plan(Path(directory) / "plan.json")
    if plan.text != study.text:
        raise StoreError(
            f"{directory}: plan.json is not of study.yaml, which was edited, or a run was killed as it took up a new "
            f"one. `sweep run {directory}/study.yaml --out {directory}` plans it anew; rows that fit are kept."
        )
    return study, plan


def searched(directory: str | Path) -> bool:
    """Whether a folder is of `sweep optimise`."""
    return (Path(directory) / SEARCH).is_file()


def keep_plan(study: Study, plan: Plan, directory: Path) -> None:
    """Write a plan, and the study beside it."""
    write_whole(directory / "study.yaml", lambda place: place.write_text(study.text, encoding="utf-8"))
    write_whole(directory / "plan.json", lambda place: write_plan(plan, place))


def dataset_of(directory: str | Path) -> xr.Dataset:
    """The dataset of a folder's journals as they are now."""
    from .dataset import assemble  # xarray takes half a second that ranks do not need, here and below

    study, plan = contents(directory)
    replay = Replay(directory, plan.keys)
    return assemble(study, plan, replay.table(slice(None)), replay.headers)


def merge(directory: str | Path) -> Path:
    """Make ``results.nc`` of the journals, piece by piece, and return its path.

    The file's time is when reading began, by the file server's clock: rows may be written meanwhile, and are newer.
    """
    path = Path(directory) / "results.nc"

    def when() -> int:
        return path.stat().st_mtime_ns if path.is_file() else 0

    def make(place: Path) -> bool:
        place.touch()
        began, before = place.stat().st_mtime_ns, when()
        study, plan = contents(directory)
        _stream(study, plan, Replay(directory, plan.keys), place)
        os.utime(place, ns=(began, began))
        return when() == before or when() < began  # else another merge has begun later and is done

    return write_whole(path, make)


def _stream(study: Study, plan: Plan, replay: Replay, place: Path) -> None:
    """Write the dataset, PIECE points at a time: xarray writes the first, the others are appended to its variables."""
    import netCDF4

    from .dataset import assemble

    m = len(plan.environments)
    step = max(1, PIECE // m)
    several = len(plan.designs) > step
    for begin in range(0, max(len(plan.designs), 1), step):
        part = slice(begin, begin + step)
        rows = replay.table(slice(begin * m, (begin + step) * m))
        piece = assemble(study, plan, rows, replay.headers, metrics=replay.metrics, designs=part)
        index = "design" if m > 1 else "point"
        if begin == 0:
            piece.to_netcdf(place, engine="netcdf4", unlimited_dims=[index] if several else None)
            continue
        with netCDF4.Dataset(place, "a") as file:
            for name in map(str, piece.variables):
                if index in piece[name].dims:
                    file.variables[name][begin : begin + piece.sizes[index]] = piece[name].values


def open_study(directory: str | Path) -> xr.Dataset:
    """The results of a study's folder: ``results.nc``, or the journals where they or the plan are newer."""
    import xarray as xr

    path = Path(directory) / "results.nc"
    parts = [*journals(Path(directory)), *Path(directory).glob("plan.json")]
    if not path.is_file() or any(part.stat().st_mtime_ns >= path.stat().st_mtime_ns for part in parts):
        return dataset_of(directory)
    with xr.open_dataset(path, engine="netcdf4") as dataset:
        return dataset.load()
