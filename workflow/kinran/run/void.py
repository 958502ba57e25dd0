"""Void files: those that say that another one is there which is gone.

No rule can name the shards of a group: they are no function of its name. So Snakemake sees the receipt of a merge job,
and `zarr.json`, which completes a stack, and not that a shard is gone. Nor can a rule name the number of runs in which
a material was fitted (`kinran.data.fit_runs`). The rules ask here before jobs are planned.
"""

import logging
from collections.abc import Iterable
from pathlib import Path

from kinran.base.files import InputError, read_json
from kinran.data.fit_runs import RUNS
from kinran.data.shards import NAMES, SHARD, read_receipt, shard_path

log = logging.getLogger(__name__)


def remove_void(results: Path) -> None:
    """Remove the void files of a fabric's folder, so that the jobs that wrote them run again, and say so."""
    for path, gone in void(results):
        log.warning("%s: is gone; %s, which says that it is there, is removed, and its job runs again", gone, path)
        try:
            path.unlink()
        except OSError as error:
            log.warning("%s: cannot be removed (%s)", path, error.strerror)


def void(results: Path) -> list[tuple[Path, Path]]:
    """Return the void files of a fabric's folder, each with a file that is gone.

    They are receipts of merge jobs, and the ``zarr.json`` of stacks: without the latter Snakemake would not miss a
    receipt, as what is made from it is there. Damaged files are left to the stages that read them. The number of runs
    is void with its material, so that a new fit is divided as the config asks.
    """
    stack, coarse = results / "radiance.zarr", results / "needed" / "radiance.zarr"
    found: list[tuple[Path, Path]] = []
    for path in sorted((results / "merged").glob("*.json")):
        try:
            shards = read_receipt(path).shards
        except InputError:
            continue
        found += [(path, gone) for gone in _gone(stack, shards)[:1]]
    for folder in (stack, coarse):
        found += [(folder / "zarr.json", gone) for gone in _gone(folder, range(_shards(folder)))[:1]]
    for path in sorted((results / "fit").glob(f".*{RUNS}")):
        material = path.with_name(path.name.removeprefix(".").removesuffix(RUNS) + ".exr")
        found += [(path, material)] if not material.is_file() else []
    return found


def _gone(stack: Path, shards: Iterable[int]) -> list[Path]:
    paths = (shard_path(stack, name, shard) for shard in shards for name in NAMES)
    return [path for path in paths if not path.is_file()]


def _shards(stack: Path) -> int:
    """Return the number of shards that a complete stack has; none where it is not complete."""
    if not (stack / "zarr.json").is_file():
        return 0
    try:
        return -(-int(read_json(stack / NAMES[0] / "zarr.json")["shape"][0]) // SHARD)
    except (InputError, KeyError, IndexError, TypeError):
        return 0
