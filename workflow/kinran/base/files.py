"""Files on disk are the interface between stages: written to a temporary name, then renamed."""

import contextlib
import errno
import hashlib
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from kinran.base.checksums import comment_damaged, json_damaged, json_line

T = TypeVar("T")

NAME = re.compile(r"[a-z0-9][a-z0-9_-]*")
"""Pattern of names that are safe as paths, as words of a shell and in HTML."""


DISK = {
    errno.ENOSPC: "the disk is full (no space left); free some space",
    errno.EDQUOT: "the disk is full (no space left in its quota); free some space",
    errno.EIO: "the disk fails (input/output error); check it, or copy the folder to another one,",
    errno.EROFS: "the disk can only be read, often after an error of its own; check it, mount it again",
}
"""What is wrong with a disk that gives an error of this number, and what to do about it."""


class InputError(Exception):
    """Input of the user that cannot be used; the message is one sentence: file, value, remedy."""


def disk_fault(error: BaseException) -> str:
    """Return what is wrong with the disk where it caused an error, also one that a C library tells of in words.

    Returns
    -------
    str
        The fault and its remedy; empty for an error with another cause.
    """
    found = (DISK[n] for n in DISK if getattr(error, "errno", None) == n or os.strerror(n) in str(error))
    return next(found, "")


@contextmanager
def on_disk(path: Path, does: str = "cannot be written") -> Iterator[None]:
    """Name `path` in an error of the disk in the block.

    Raises
    ------
    InputError
        The disk is full, fails, or can only be read.
    """
    try:
        yield
    except (OSError, RuntimeError) as error:
        if fault := disk_fault(error):
            raise InputError(f"{path}: {does}: {fault} and run it again") from None
        raise


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, which takes its place when the block ends without an error.

    Parameters
    ----------
    path
        Final name. Its folder is made if missing.

    Yields
    ------
    Path
        Name to write to; same suffix, so that writers that look at suffixes work.

    Raises
    ------
    InputError
        The folder cannot be written to, or the disk is full or fails.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch()
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot be written to ({error.strerror}); choose another output folder"
        ) from None
    try:
        with on_disk(path):
            yield temporary
            temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_json(path: Path, value: Any) -> None:
    """Write `value`, which may hold dataclasses, as indented JSON, atomically; NaN and infinity are refused.

    Its last line is the checksum of `kinran.base.checksums`.
    """
    body = (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False, default=asdict) + "\n").encode()
    with atomic(path) as temporary:
        temporary.write_bytes(body + json_line(body))


def read_bytes(path: Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    InputError
        The disk fails.
    OSError
        The file is missing, or cannot be opened.
    """
    with on_disk(path, "cannot be read"):
        return path.read_bytes()


def read_json(path: Path) -> Any:
    """Read a JSON file, and check its checksum where it has one.

    Raises
    ------
    InputError
        The file is missing, is not JSON, or does not match its checksum.
    """
    try:
        data = read_bytes(path)
        if json_damaged(data):
            raise InputError(
                f"{path}: does not match its checksum; restore it or make it again, or delete its last line, which is"
                " blank, if it was edited on purpose"
            )
        return json.loads(data.decode("utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is not valid JSON ({error}); make it again") from None


def check_comment(path: Path) -> None:
    """Check a text file or a PLY against the checksum in its comment (`kinran.base.checksums`), where it has one.

    Raises
    ------
    InputError
        The file does not match it.
    """
    if comment_damaged(read_bytes(path)):
        raise InputError(
            f"{path}: does not match its checksum; restore it or make it again, or delete the line with kinran:crc32 if"
            " it was edited on purpose"
        )


def read_as(path: Path, kind: type[T], what: str, remedy: str = "make it again") -> T:
    """Read a JSON file as a dataclass, or as a list or dict of them; unknown keys are ignored.

    Parameters
    ----------
    path
        The file.
    kind
        Type that its content must fit.
    what
        Name of the content for the error, such as "a plan".
    remedy
        Remedy for the error.

    Raises
    ------
    InputError
        The file is missing, is not JSON, or a field is missing or of another type.
    """
    return fitted(path, read_json(path), kind, what, remedy)


def fitted(path: Path, value: Any, kind: type[T], what: str, remedy: str = "make it again") -> T:
    """Convert the content of a JSON file to a dataclass; parameters and errors as in `read_as`."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        reason, _, field = str(error).partition(" - at `$")
        field = field.strip("`.")
        raise InputError(f"{path}: is not {what} ({field and field + ': '}{reason}); {remedy}") from None


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes in hexadecimal.

    Raises
    ------
    OSError
        The file cannot be read; the error names it.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        error.filename = str(path)
        raise


def check_name(name: str, what: str) -> str:
    """Return `name` if it can safely become a path, a shell word and HTML.

    Raises
    ------
    InputError
        The name has other characters than a-z, 0-9, ``_`` and ``-``, or starts with one of the last two.
    """
    if not NAME.fullmatch(name):
        raise InputError(f"{what} '{name}': use only a-z, 0-9, _ and -, starting with a letter or digit")
    return name
