"""Shards: the files of a radiance stack, each of a few neighbouring lights, so that a merge job writes whole files."""

from collections.abc import Sequence
from pathlib import Path

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
