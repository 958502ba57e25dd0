"""The journal of a capture: append-only JSON lines, each with a CRC-32, synced to disk before it counts."""

import fcntl
import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from kinran.base.files import InputError

Record = dict[str, Any]


def line(record: Mapping[str, Any]) -> bytes:
    """Return one line of a journal: compact JSON, a blank, eight hexadecimal digits of CRC-32."""
    body = json.dumps(record, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
    return body + b" %08x\n" % zlib.crc32(body)


def parse(text: bytes) -> Record | None:
    """Return the record of one line, line end included; None where the line is torn or damaged."""
    body, _, digits = text.removesuffix(b"\n").rpartition(b" ")
    if not text.endswith(b"\n") or digits != b"%08x" % zlib.crc32(body):
        return None
    record = json.loads(body)
    return record if isinstance(record, dict) else None


def read(path: Path) -> tuple[list[Record], int]:
    """Read the records of a journal, and the number of bytes that they take; a torn tail is left out.

    Raises
    ------
    InputError
        A line is damaged and sound ones follow it, so that it is not a torn tail.
    """
    records: list[Record] = []
    good = 0
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    for number, text in enumerate(lines, 1):
        record = parse(text)
        if record is None:
            if any(parse(later) is not None for later in lines[number:]):
                raise InputError(f"{path}: line {number} is damaged; restore the journal from a copy")
            break
        records.append(record)
        good += len(text)
    return records, good


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
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise InputError(f"{path}: cannot be written to ({error.strerror}); choose another folder") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.records, good = read(path)
        except BlockingIOError:
            os.close(self._file)
            raise InputError(f"{path}: another capture of this fabric is running; wait for its end") from None
        except BaseException:
            os.close(self._file)
            raise
        self.torn = os.fstat(self._file).st_size - good
        if self.torn:  # else the next record would be glued to the torn one
            os.ftruncate(self._file, good)
            os.fsync(self._file)

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

    def close(self) -> None:
        """Close the journal, so that others can open it."""
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
