"""Finished tiles of a fit, kept beside the result so that a run that was stopped goes on where it was."""

import hashlib
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, atomic
from kinran.base.npz import read_npz
from kinran.data.radiance_stack import Box

Arrays = dict[str, NDArray[np.floating]]


def content_key(options: list[str], files: list[Path], stack: Path) -> str:
    """Digest of the options, of the content of the files, and of the names, sizes and times of a stack's files."""
    whole = hashlib.sha256("\0".join(options).encode())
    for path in files:
        whole.update(path.read_bytes())
    for path in sorted(path for path in stack.rglob("*") if path.is_file()):
        status = path.stat()
        whole.update(f"{path.relative_to(stack)} {status.st_size} {status.st_mtime_ns}".encode())
    return whole.hexdigest()[:16]


@dataclass(frozen=True)
class Finished:
    """Finished tiles of one run, in a folder that bears the key of its inputs."""

    folder: Path

    @classmethod
    def of(cls, out: Path, key: str) -> "Finished":
        """Finished tiles of the run that writes `out`; tiles of another key are removed."""
        parent = out.with_name(f".{out.name}.tiles")
        for other in parent.glob("*"):
            if other.name != key:
                shutil.rmtree(other)
        return cls(parent / key)

    def has(self, box: Box) -> bool:
        """Whether a tile is finished and its file is whole."""
        try:
            read_npz(self.path(box))
        except InputError:
            return False
        return True

    def keep(self, box: Box, arrays: Arrays) -> None:
        """Keep the arrays of a tile."""
        with atomic(self.path(box)) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    def read(self, box: Box) -> Arrays:
        """Arrays of a finished tile."""
        return read_npz(self.path(box))

    def clear(self) -> None:
        """Remove all tiles, once the result is written."""
        shutil.rmtree(self.folder.parent, ignore_errors=True)

    def path(self, box: Box) -> Path:
        """File of a tile."""
        return self.folder / f"{box[0]}_{box[2]}.npz"
