"""Results that runs and users share: files in a folder, each named by all that its content follows from.

The variable ``KINRAN_CACHE`` names the folder; without it nothing is shared. A stage calls `made` with the values that
its result follows from, the files that it writes and the function that writes them. The same values, code, locked
packages and kind of processor give the same name, on whatever path, for whatever fabric: the files are then copied from
the folder, and the function is not called.

An entry is one file, an uncompressed ZIP with the SHA-256 of each part. It is written under another name and renamed,
so that none is ever seen half written, and of two writers at once the last one's stays: both are right. Each use sets
its time stamp, so that `find -mtime` finds what nobody uses any more. A folder that cannot be read or written, and an
entry that is damaged, are told, and fail no stage.
"""

import functools
import hashlib
import json
import logging
import os
import platform
import sys
import uuid
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from kinran.base.digest import digest
from kinran.base.files import atomic, sha256
from kinran.base.project import ROOT

T = TypeVar("T")

VARIABLE = "KINRAN_CACHE"
"""Variable that names the folder. It is no setting of a run, since it changes no result."""
INDEX = "index.json"
"""Part of an entry that has the value of the function, and the digests of the other parts."""
READ_AND_WRITE = 0o666
"""Rights that an entry takes from its folder: who may write there may say that it is in use, whatever the umask was."""
PIECE = 1 << 20
"""Bytes that are copied at a time. A choice."""

log = logging.getLogger(__name__)


class _DamagedError(Exception):
    """An entry is not what was written."""


def made(what: str, code: str, follows: Callable[[], Any], files: Mapping[str, Path], make: Callable[[], T]) -> T:
    """Put files in place from the shared folder; where it does not have them, make them, and share them.

    Parameters
    ----------
    what
        Name of the result, for messages.
    code
        Module whose code makes it (`kinran.base.digest`).
    follows
        Function that returns all else that it follows from, as `key` takes it: contents, not names of files. It is not
        called where nothing is shared.
    files
        Files that `make` writes, by their names in the entry.
    make
        Function that writes the files, and checks them. Its value is shared with them: JSON, or None.

    Returns
    -------
    T
        Value of `make`, now or when the entry was written.

    Raises
    ------
    InputError
        A file cannot be written; and whatever `make` raises, after which nothing is shared.
    """
    folder = _folder()
    if folder is None:
        return make()
    entry = folder / f"{code.rpartition('.')[2]}-{key(code, follows())}.zip"
    try:
        value: T = _take(entry, files)
    except FileNotFoundError:
        pass
    except _DamagedError as error:
        log.warning("%s: is damaged (%s); it is made anew", entry, error)
    except PermissionError as error:
        _say_once(logging.WARNING, f"{folder}: cannot be read ({error.strerror}); what is there is made again")
    else:
        _say_once(logging.INFO, what, f"{what}: taken from the cache, {entry}")
        return value
    value = make()
    _keep(entry, files, value)
    return value


def key(code: str, follows: Any) -> str:
    """Return 32 hexadecimal digits that change with the values, the code, the packages or the kind of processor.

    Parameters
    ----------
    code
        Module of the project.
    follows
        Arrays, texts, numbers, None, and dataclasses, dicts, lists and tuples of them.

    Raises
    ------
    TypeError
        A value is of another type, such as a path, whose content is not its name.
    """
    whole = hashlib.sha256()
    for part in _bytes((code, digest(code), environment(), follows)):
        whole.update(part)
    return whole.hexdigest()[:32]


@functools.cache
def environment() -> tuple[str, ...]:
    """Return what results follow from beside code and input: the locked packages, Python, and the kind of processor.

    Compiled code is that of a processor: another one sums in another order, which changes last digits.
    """
    import llvmlite.binding as llvm  # 0.1 s, for those who share alone

    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    processor = (platform.machine(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    return (sha256(ROOT / "requirements.txt"), python, *processor)


def _bytes(value: Any) -> Iterator[bytes | memoryview]:
    """Yield the bytes of a value, which no other value has."""
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield np.ascontiguousarray(value).reshape(-1).view(np.uint8).data
    elif is_dataclass(value) and not isinstance(value, type):
        yield from _bytes({field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)};".encode()
        for name in sorted(value):
            yield from _bytes(name)
            yield from _bytes(value[name])
    elif isinstance(value, list | tuple):
        yield f"sequence {len(value)};".encode()
        for item in value:
            yield from _bytes(item)
    elif value is None or isinstance(value, bool | int | float | str):
        text = repr(value).encode()
        yield f"{type(value).__name__} {len(text)};".encode() + text
    else:
        raise TypeError(f"{type(value).__name__}: has no content that a key could hold")


def _folder() -> Path | None:
    """Return the shared folder; None where there is none."""
    folder = os.environ.get(VARIABLE)
    if folder and not os.path.isdir(folder):  # noqa: PTH112 (which raises where it may not look)
        _say_once(logging.WARNING, f"{VARIABLE}={folder}: is no folder; make it, and results are shared there")
        return None
    return Path(folder) if folder else None


def _take(entry: Path, files: Mapping[str, Path]) -> Any:
    """Copy the files of an entry into place, each whole or not at all, and return its value.

    Raises
    ------
    FileNotFoundError, PermissionError
        There is no such entry, or it may not be read.
    _DamagedError
        It is damaged.
    """
    with entry.open("rb") as file:
        archive = _undamaged(lambda: zipfile.ZipFile(file))
        index = _undamaged(lambda: json.loads(archive.read(INDEX)))
        value = _undamaged(lambda: index["value"])
        for name, path in files.items():
            with atomic(path) as temporary, temporary.open("wb") as out:
                for piece in _pieces(archive, name, index):
                    out.write(piece)
    with suppress(OSError):  # another user's
        os.utime(entry)
    return value


def _pieces(archive: zipfile.ZipFile, name: str, index: Any) -> Iterator[bytes]:
    """Yield a part of an entry, and raise `_DamagedError` before its end if it is not what was written."""
    whole = hashlib.sha256()
    part = _undamaged(lambda: archive.open(name))
    while piece := _undamaged(lambda: part.read(PIECE)):
        whole.update(piece)
        yield piece
    if _undamaged(lambda: index["sha256"][name]) != whole.hexdigest():
        raise _DamagedError(f"{name} has another SHA-256")


def _undamaged(read: Callable[[], T]) -> T:
    try:
        return read()
    except Exception as error:  # zipfile and json raise errors of many kinds on a broken file
        raise _DamagedError(str(error)) from None


def _keep(entry: Path, files: Mapping[str, Path], value: Any) -> None:
    """Write an entry, or say why it cannot be written."""
    temporary = entry.with_name(f".{uuid.uuid4().hex}.part")
    try:
        index = {"value": value, "sha256": {name: sha256(path) for name, path in files.items()}}
        with zipfile.ZipFile(temporary, "x", strict_timestamps=False) as archive:
            for name, path in files.items():
                archive.write(path, name)
            archive.writestr(INDEX, json.dumps(index, allow_nan=False))
        temporary.chmod(entry.parent.stat().st_mode & READ_AND_WRITE)
        temporary.replace(entry)
    except OSError as error:
        _say_once(logging.WARNING, f"{entry.parent}: cannot be written to ({error.strerror}); nothing new is shared")
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


_said: set[str] = set()


def _say_once(level: int, about: str, message: str = "") -> None:
    """Log a message, which is `about` itself if not given, once in this process."""
    if about not in _said:
        _said.add(about)
        log.log(level, "%s", message or about)
