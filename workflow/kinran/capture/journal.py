"""The journal of a capture: append-only JSON lines, each with a CRC-32, synced to disk before it counts.

A copy of it stands beside it, made at the end of each group: what stands in the copy, the journal must have.
"""

import fcntl
import json
import os
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from kinran.base.files import InputError

Record = dict[str, Any]

JOURNAL = "journal.jsonl"
"""Name of the journal in the folder of a capture."""
COPY = "journal.copy.jsonl"
"""Name of its copy."""
_TORN = re.compile(rb"[^\n\0]*\0*")
"""A torn tail: the start of one line, as a killed write leaves it, and the NULs of a file system that had made the file
longer, but had not written the bytes, when the power failed (ext4 and XFS with delayed allocation)."""


def remedy(root: Path) -> str:
    """Return what to do when the journal of the capture in the folder `root` is damaged."""
    return f"run `kinran rig repair {root.resolve().name}`"


def line(record: Mapping[str, Any]) -> bytes:
    """Return one line of a journal: compact JSON, a blank, eight hexadecimal digits of CRC-32."""
    body = json.dumps(record, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    return body + b" %08x\n" % zlib.crc32(body)


def parse(text: bytes) -> Record | None:
    """Return the record of one line, line end included; None where the line is torn or damaged."""
    body, _, digits = text.removesuffix(b"\n").rpartition(b" ")
    if not body or not text.endswith(b"\n") or digits != b"%08x" % zlib.crc32(body):
        return None
    record = json.loads(body)
    return record if isinstance(record, dict) else None


def split(text: bytes) -> list[bytes]:
    """Return the lines of a journal with their ends; other signs that Python takes for line ends are none."""
    return re.findall(rb"[^\n]*\n|[^\n]+", text)


def read(path: Path) -> tuple[list[Record], int]:
    r"""Read the records of a journal, and the number of bytes that they take; a torn tail is left out.

    A torn tail is the start of one line without its end, with or without NULs after it. A damaged line that has its end
    was whole once: it and those after it may tell of frames that are nowhere else.

    Raises
    ------
    InputError
        The file cannot be read, or has a damaged line that is not a torn tail.
    """
    try:
        text = path.read_bytes() if path.exists() else b""
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the disk, then run it again") from None
    records: list[Record] = []
    good = 0
    for number, each in enumerate(split(text), 1):
        record = parse(each)
        if record is None and _TORN.fullmatch(each):
            break
        if record is None:
            raise InputError(f"{path}: line {number} is damaged; {remedy(path.parent)}")
        records.append(record)
        good += len(each)
    return records, good


def lock(path: Path) -> int:
    """Open a journal for appending, for this process alone, and return its descriptor; it is made if missing.

    Raises
    ------
    InputError
        Another process has it open, or it cannot be written to.
    """
    file = -1
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(file), path.stat()):
            return file
        strange: OSError = BlockingIOError("a repair has just put another file in its place")
    except OSError as error:
        strange = error
    if file >= 0:
        os.close(file)
    if isinstance(strange, BlockingIOError):
        raise InputError(f"{path}: another capture or repair of this fabric is running; wait for its end")
    raise InputError(f"{path}: cannot be written to ({strange.strerror}); choose another folder")


def running(path: Path) -> bool:
    """Return whether a process has a journal open for appending; nothing is changed."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


class Journal:
    """A journal open for appending, held by one process at a time.

    Attributes
    ----------
    records
        All records, oldest first.
    torn
        Bytes of a torn tail that were cut on opening.

    Raises
    ------
    InputError
        Another process has it open, it cannot be written to, or it is damaged before its tail.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = lock(path)
        try:
            self.records, good = read(path)
            self.torn = os.fstat(self._file).st_size - good
            if self.torn:  # else the next record would be glued to the torn one
                os.ftruncate(self._file, good)
                os.fsync(self._file)
        except BaseException:
            os.close(self._file)
            raise

    def append(self, *records: Record) -> None:
        """Append records and wait until the disk has them; a failed write leaves none of them."""
        size = os.fstat(self._file).st_size
        data = b"".join(line(record) for record in records)
        try:
            written = 0
            while written < len(data):
                written += os.write(self._file, data[written:])
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, size)
            raise
        self.records.extend(records)

    def copy(self) -> None:
        """Keep a copy of the journal beside it, unless there is one already."""
        path, text = self.path.with_name(COPY), self.path.read_bytes()
        if not path.exists() or path.read_bytes() != text:
            write_synced(path, text)

    def close(self) -> None:
        """Close the journal, so that others can open it."""
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def write_synced(path: Path, data: bytes) -> None:
    """Write a file that is there whole or not at all, and wait until the disk has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    with part.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    part.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the names in a folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
