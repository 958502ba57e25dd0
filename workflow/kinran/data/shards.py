"""Shards: the files of a radiance stack, each of a few neighbouring lights, so that a merge job writes whole files.

The job's receipt names them with their SHA-256.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError, read_as, sha256

SHARD = 8
"""Lights in one shard."""
NAMES = ("radiance", "flags")
"""Arrays of a stack, which have the same shards."""


def shard_path(folder: Path, name: str, shard: int) -> Path:
    """Return the file of a shard of the array ``radiance`` or ``flags``."""
    return folder / name / "c" / str(shard) / "0" / "0" / "0"


def group_shards(lights: Sequence[int], last: int | None) -> list[int]:
    """Return the indices of the shards that a group's merge writes: all but the one with the light at θ = 0.

    The light at θ = 0 has shots in all groups, so that its shard is written when the stack is completed.

    Parameters
    ----------
    lights
        Indices of the group's lights.
    last
        Index of the light at θ = 0; None for photographs.
    """
    shards = sorted({index // SHARD for index in lights})
    return [shard for shard in shards if last is None or shard != last // SHARD]


@dataclass(frozen=True)
class Receipt:
    """What a merge job wrote.

    Attributes
    ----------
    shards
        Indices of its shards.
    sha256
        SHA-256 of the shards' files, by their paths within the stack; None where an earlier version merged them.
    """

    shards: tuple[int, ...]
    sha256: dict[str, str] | None = None


def read_receipt(path: Path) -> Receipt:
    """Read the receipt of a merge job.

    Raises
    ------
    InputError
        The file is missing, damaged, or no receipt.
    """
    return read_as(path, Receipt, "the receipt of a merge", "merge the group again")


def check_receipt(path: Path, stack: Path) -> None:
    """Check the shards of a receipt by their digests.

    Raises
    ------
    InputError
        A shard is missing or is not the one that was merged, or the receipt has no digests.
    """
    digests = read_receipt(path).sha256
    if digests is None:
        raise InputError(f"{path}: an earlier version merged its group, without checksums; merge it again")
    for name, digest in digests.items():
        if not (stack / name).is_file():
            raise InputError(f"{stack / name}: is missing; merge its group again")
        if sha256(stack / name) != digest:
            raise InputError(
                f"{stack / name}: is not the shard that {path} has the digest of; delete it, and merge its group again"
            )
