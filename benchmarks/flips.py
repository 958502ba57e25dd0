"""Flipped bits in the files of a finished run: which are errors that name the file, which are harmless, which silent.

Each flip changes one bit of one file, reads the file as the stages of the workflow do, and puts the bit back. A flip is
harmless where what is read is the same to the bit. Flips of a kind of file are spread evenly over its bits.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinran.base.exr import read_exr
from kinran.base.files import InputError, read_json, write_json
from kinran.base.log import progress
from kinran.bracket.shots import read_bracket, read_manifest
from kinran.data.capture_plan import read_plan
from kinran.data.labels import read_labels, read_second
from kinran.data.radiance_stack import Stack
from kinran.run.damage import check_capture
from kinran.scene.mesh import check_scan
from kinran.scene.placement import uv_size
from kinran_bsdf import read_material

OUTCOMES = ("named", "harmless", "verify", "unnamed", "silent")
"""Error that names the file; read as before; seen by `kinran verify` alone; error that names no file; other values."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--run", type=Path, default=Path(), help="folder of a finished run, with captures and results")
    parser.add_argument("--flips", type=int, default=1000, help="number of flipped bits (1000)")
    parser.add_argument("--seed", type=int, default=0, help="other bits")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON.

    Raises
    ------
    InputError
        The run has no files of a kind.
    """
    with copied(args.run) as run:
        counts, silent = campaign(run, args.flips, args.seed)
    print(table(counts))
    for line in silent:
        print(line)
    write_json(args.out, {"flips": args.flips, "seed": args.seed, "kinds": counts, "silent": silent})


@contextmanager
def copied(run: Path) -> Iterator[Path]:
    """Give a copy of a run's captures and results, whose bits may be flipped."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("captures", "results"):
            shutil.copytree(run / name, Path(folder) / name)
        yield Path(folder)


def campaign(run: Path, flips: int, seed: int) -> tuple[dict[str, dict[str, int]], list[str]]:
    """Flip bits of a run, as many in each kind of file.

    Returns
    -------
    dict
        For each kind the number of flips of each outcome.
    list of str
        File and bit of each flip that was silent, or an error without a name.
    """
    rng = np.random.default_rng(seed)
    counts: dict[str, dict[str, int]] = {}
    silent = []
    everything = sorted(path for path in run.rglob("*") if path.is_file())
    for k, (name, read) in enumerate(READERS.items()):
        files = [path for path in everything if kind_of(path.relative_to(run)) == name]
        if not files:
            raise InputError(f"{run}: has no files of {name}; give a finished run")
        sizes = np.cumsum([path.stat().st_size for path in files])
        bits = rng.integers(0, 8 * sizes[-1], (flips + k) // len(READERS))
        sound: dict[Path, bytes] = {}
        counts[name] = dict.fromkeys(OUTCOMES, 0)
        for bit in progress(bits.tolist(), name, "flips"):
            index = int(np.searchsorted(sizes, bit // 8, "right"))
            path, place = files[index], bit - 8 * int(sizes[index - 1] if index else 0)
            if path not in sound:
                sound[path] = as_bytes(read(path))
            outcome = flip(path, place, read, sound[path])
            counts[name][outcome] += 1
            if outcome in ("silent", "unnamed"):
                silent.append(f"{outcome}: {path.relative_to(run)} bit {place}")
    return counts, silent


def kind_of(path: Path) -> str:
    """Return the kind of a file of a run, by its path in it; empty where no stage reads it."""
    if any(part.endswith(".zarr") for part in path.parts):
        return "stack"
    if "frames" in path.parts:
        return "frames"
    if path.suffix == ".exr":
        fitted = path.parent.name == "fit" and not path.stem.endswith(".sigma")
        return "labels" if path.name == "labels.exr" else "material" if fitted or path.stem == "material" else "maps"
    return {".json": "json", ".ply": "meshes"}.get(path.suffix, "")


def flip(path: Path, bit: int, read: Callable[[Path], object], sound: bytes) -> str:
    """Flip a bit of a file, read the file, put the bit back, and return the outcome."""
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[bit // 8] ^= 1 << bit % 8
    path.write_bytes(flipped)
    try:
        if as_bytes(read(path)) == sound:
            return "harmless"
        capture = next((folder for folder in path.parents if folder.parent.name == "captures"), None)
        return "verify" if capture and any(c.fault for c in check_capture(capture)) else "silent"
    except (InputError, ValueError, OSError) as error:
        return "named" if str(path) in str(error) or f"{_stack(path)}: " in str(error) else "unnamed"
    finally:
        path.write_bytes(whole)


def as_bytes(value: object) -> bytes:
    """Return what was read as bytes that differ where it does."""
    if isinstance(value, np.ndarray):
        return repr((value.shape, value.dtype)).encode() + value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, dict):
        return b"{" + b",".join(repr(key).encode() + b":" + as_bytes(value[key]) for key in sorted(value)) + b"}"
    if isinstance(value, list | tuple):
        return b"[" + b",".join(map(as_bytes, value)) + b"]"
    return repr(value).encode()


def table(counts: dict[str, dict[str, int]]) -> str:
    """Return the counts as lines of text."""
    rows: list[tuple[str, ...]] = [("files", "flips", *OUTCOMES)]
    rows += [(name, *map(str, (sum(row.values()), *row.values()))) for name, row in counts.items()]
    total = [sum(row[outcome] for row in counts.values()) for outcome in OUTCOMES]
    rows.append(("all", *map(str, (sum(total), *total))))
    return "\n".join(f"{row[0]:10}" + "".join(f"{value:>10}" for value in row[1:]) for row in rows)


def _stack(path: Path) -> Path:
    """The stack that a file is in, or the file itself."""
    return next((folder for folder in path.parents if folder.suffix == ".zarr"), path)


def _read_shard(path: Path) -> object:
    """Read the lights of a shard, or all lights where the file is one of the metadata."""
    stack = Stack.open(_stack(path))
    metadata = {name: value for name, value in vars(stack).items() if name not in ("_arrays", "path")}
    use = range(len(stack.lights))
    if path.name != "zarr.json":
        use = range(8 * int(path.parts[-4]), min(8 * int(path.parts[-4]) + 8, len(stack.lights)))
    return metadata, stack.read_stored(0, stack.height, 0, stack.width, list(use))


def _read_labels(path: Path) -> object:
    labels = read_labels(path)
    return labels, read_second(path, labels)


def _read_frame(path: Path) -> object:
    """Read the shot of a frame, as the merge does."""
    capture = next(folder for folder in path.parents if folder.parent.name == "captures")
    plan = read_plan(capture / "plan.json")
    for manifest in sorted((capture / "groups").glob("*.json")):
        for shot in read_manifest(manifest, plan):
            if path in (frame.path for frame in shot.frames):
                return read_bracket(shot).planes
    raise InputError(f"{path}: stands in no manifest")


def _read_json(path: Path) -> Any:
    return read_json(path) if path.name != "plan.json" else read_plan(path)


def _read_mesh(path: Path) -> object:
    read = check_scan if path.name == "scan.ply" else uv_size
    return read(path), path.read_bytes()


READERS: dict[str, Callable[[Path], object]] = {
    "stack": _read_shard,
    "material": read_material,
    "labels": _read_labels,
    "maps": read_exr,
    "frames": _read_frame,
    "json": _read_json,
    "meshes": _read_mesh,
}
"""The kinds of files that stages read, and a function that returns all that a stage would see of one."""
