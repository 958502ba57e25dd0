"""Merge of brackets: accuracy against the Cramér–Rao bound, speed, memory, and reading tiles from the stack.

CPU seconds are the process's own, so that other load on the machine does not count; ratios are within one run.
"""

import argparse
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from benchmarks import merge_accuracy, merge_black, merge_real
from benchmarks.merge_accuracy import BLACK, CLIP, RESPONSE, SECONDS, sixteen_bit
from kinran.base.exr import read_exr, write_rgb
from kinran.base.files import sha256, write_json
from kinran.bracket.estimator import estimate_rows
from kinran.bracket.shots import Bracket, Frame, Taken
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate.radiometry import to_radiance
from kinran.data.calibration import CalibratedCamera, Calibration, Exposure, write_calibration
from kinran.data.capture_plan import Group, Plan, PlanLight, Shot, write_plan
from kinran.data.flat_field import Flat
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, ShardWriter, Stack, write_metadata, write_shards
from kinran.data.raw import read_raw
from kinran.data.shards import SHARD
from kinran.virtual.dng import Tags, write_dng

REPEATS = 5
"""Runs of which the quickest counts. A choice."""
HOT_SITES = 5e-4
"""Share of the sites that are hot, as in the virtual camera."""
RATES = (25, 100, 250, 1000, 4000)
"""Shutter speeds of the paper's bracket, 1/s."""
TILE_LIGHTS, TILE_READ = 16, 200
"""Lights that are written, and the number to which the time is scaled."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--out", type=Path, help="results (.json)")
    parser.add_argument("--megapixels", type=float, default=10.08, help="megapixels of a frame")
    parser.add_argument("--sites", type=int, default=20_000, help="synthetic sites at each level of radiance")
    parser.add_argument("--data", type=Path, help="folder of the llanos sets, for real brackets")


def main(args: argparse.Namespace) -> None:
    """Measure, print the table, write the JSON."""
    rows, columns = _size(args.megapixels)
    results: dict[str, Any] = {"machine": machine(), "accuracy": merge_accuracy.measure(args.sites)}
    with tempfile.TemporaryDirectory(prefix="kinran-bench-", dir=Path.cwd()) as folder:
        results["black"] = merge_black.measure(Path(folder), rows, columns)
        results["speed"] = speed(Path(folder), rows, columns)
        results["memory"] = memory(Path(folder), rows, columns)
        results["tile"] = tile(Path(folder), rows // 2, columns // 2)
    if args.data:
        results["real"] = merge_real.evaluate(args.data)
    print(table(results))
    if args.out:
        write_json(args.out, results)


def machine() -> dict[str, Any]:
    """The machine that the benchmark ran on."""
    return {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()}


def _size(megapixels: float) -> tuple[int, int]:
    """Rows and columns of a frame of 2:3, in whole superpixels."""
    rows = 2 * round((megapixels * 1e6 / 1.5) ** 0.5 / 2)
    return rows, 2 * round(1.5 * rows / 2)


def cpu(action: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Least CPU seconds of an action."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        action()
        best = min(best, time.process_time() - start)
    return best


def scene(rows: int, columns: int) -> NDArray[np.float64]:
    """Electrons a second (rows, columns) of a cloth with highlights, over five decades."""
    rng = np.random.default_rng(0)
    patches = 10 ** rng.uniform(3.5, 8, (-(-rows // 32), -(-columns // 32)))
    return np.asarray(np.kron(patches, np.ones((32, 32)))[:rows, :columns], float)


def speed(folder: Path, rows: int, columns: int) -> dict[str, Any]:
    """CPU seconds of one light: of the estimator, of OpenCV's, and of the parts of a merge job."""
    sites = expose_fast(scene(rows, columns))
    planes = np.stack([sites[:, y::2, x::2] for y, x in ((0, 0), (0, 1), (1, 0), (1, 1))], 1)
    black, seconds = np.full((5, 4, rows // 2), float(BLACK)), np.repeat(SECONDS[:, None], rows // 2, 1)
    estimate_rows(planes[:, :, :4], black[..., :4], seconds[:, :4], RESPONSE, 0, 4)
    ours = cpu(lambda: estimate_rows(planes, black, seconds, RESPONSE, 0, rows // 2))
    samples = rows * columns / 1e6
    found: dict[str, Any] = {
        "megapixels": samples,
        "kinran_estimator_msample_per_cpu_s": samples / ours,
        "kinran_estimator_cpu_s": ours,
    }
    found |= _opencv(sites, samples, ours)
    return found | _job(folder, sites, planes)


def _job(folder: Path, sites: NDArray[np.uint16], planes: NDArray[np.uint16]) -> dict[str, Any]:
    """CPU seconds of the parts of a merge job, for one light."""
    rows, columns = sites.shape[1:]
    camera = bench_camera(rows, columns)
    frames = tuple(Frame(Path(f"{rate}.dng"), 1 / rate) for rate in RATES)
    shot = Taken("light", "light", 0, None, None, frames)
    nominal, black = np.array([1 / rate for rate in RATES]), np.full(5, float(BLACK))
    bracket = Bracket(shot, planes, np.repeat(black[:, None], 4, 1), None, None, nominal, 4095.0, 0, frames)
    picture = merge_bracket(bracket, camera)
    merging = cpu(lambda: merge_bracket(bracket, camera))
    files = {kind: [folder / f"{kind}_{k}.dng" for k in RATES] for kind in ("lossless", "plain")}
    for k, one in enumerate(sites):
        encoded = bytes(imagecodecs.ljpeg_encode(np.ascontiguousarray(one), bitspersample=12))
        _write(files["lossless"][k], one, Fraction(1, RATES[k]), encoded)  # as cameras write CR2
        _write(files["plain"][k], one, Fraction(1, RATES[k]))
    decoding = {kind: cpu(lambda paths=paths: [read_raw(path) for path in paths], 3) for kind, paths in files.items()}  # type: ignore[misc]

    def store() -> None:
        with ShardWriter(folder / "store.zarr", *picture.value.shape[:2]) as writer:
            for _ in range(SHARD):
                writer.add(picture)
            writer.write(0)

    return {
        "kinran_superpixels_cpu_s": merging,
        "decode_cpu_s": decoding["lossless"],
        "decode_uncompressed_cpu_s": decoding["plain"],
        "digest_cpu_s": cpu(lambda: [sha256(path) for path in files["lossless"]]),
        "digest_uncompressed_cpu_s": cpu(lambda: [sha256(path) for path in files["plain"]]),
        "merge_over_decode": merging / decoding["lossless"],
        "merge_over_decode_uncompressed": merging / decoding["plain"],
        "radiometry_cpu_s": cpu(lambda: to_radiance(picture, camera, 1.0, 10, 0)),
        "store_cpu_s": cpu(store, 1) / SHARD,
    }


def _opencv(sites: NDArray[np.uint16], samples: float, ours: float) -> dict[str, Any]:
    """CPU seconds of OpenCV's MergeDebevec on three channels of 16 bits, on one thread."""
    try:
        import cv2
    except ImportError:
        return {"opencv": "not installed"}
    cv2.setNumThreads(1)
    images = [np.ascontiguousarray(np.repeat(image[..., None], 3, -1)) for image in sixteen_bit(sites)]
    merger, seconds = cv2.createMergeDebevec(), SECONDS.astype(np.float32)
    theirs = cpu(lambda: merger.process(images, seconds), 3)
    return {
        "opencv": cv2.__version__,
        "opencv_cpu_s": theirs,
        "opencv_msample_per_cpu_s": 3 * samples / theirs,
        "speedup_per_sample": theirs / 3 / ours,
        "speedup_per_frame": theirs / ours,
    }


def expose_fast(rates: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Expose whole frames as `merge_accuracy.expose` does, with normal noise and in strips."""
    rng = np.random.default_rng(2)
    out = np.empty((len(SECONDS), *rates.shape), np.uint16)
    for k, seconds in enumerate(SECONDS):
        for first in range(0, len(rates), 256):
            mean = (rates[first : first + 256] * seconds).astype(np.float32)
            noise = rng.standard_normal(mean.shape, np.float32) * np.sqrt(mean + np.float32(400))
            counts = (mean + noise) / np.float32(12.1) + BLACK
            out[k, first : first + 256] = np.clip(counts + 0.5, 0, CLIP)
    return out


def bench_camera(rows: int, columns: int) -> CalibratedCamera:
    """The calibration of the synthetic camera, with the faults that a real one has: hot sites, glare, a flat field."""
    exposures = tuple(Exposure(1 / r, float(s), float(s), 1) for r, s in zip(RATES, SECONDS, strict=True))
    rng, count = np.random.default_rng(3), round(HOT_SITES * rows * columns)
    sites = rng.integers(0, [4, rows // 2, columns // 2], (count, 3))
    bad = tuple((int(plane), int(y), int(x)) for plane, y, x in sites)
    flat = Flat(0.0, 0.0, ((1.0, *[0.0] * 13, -0.05),) * 3)
    black, white = (float(BLACK),) * 4, (1e6, 1e6, 1e6)
    return CalibratedCamera(black, False, RESPONSE, exposures, bad, white, 1.0, glare=0.005, flats=(flat,))


def _write(path: Path, counts: NDArray[np.uint16], seconds: Fraction, encoded: bytes | None = None) -> None:
    write_dng(path, counts, Tags(seconds, 0, BLACK, 4095, "2000:01:01 00:00:00"), encoded)


def memory(folder: Path, rows: int, columns: int) -> dict[str, Any]:
    """Peak memory of a worker that merges a group of 8 lights, over that of one that only imports."""
    manifest, plan, calibration = _group(folder, rows, columns)
    files = ["--plan", str(plan), "--calibration", str(calibration), "--manifest", str(manifest)]
    whole = _peak([sys.executable, "-m", "kinran", "merge-group", *files, str(folder / "memory.zarr")])
    imports = "import kinran.radiance.merge_group, zarr, rawpy, kinran.bracket.superpixels"
    base = _peak([sys.executable, "-c", imports])
    return {"lights": SHARD, "base_mb": base, "peak_mb": whole, "over_base_mb": whole - base}


def _peak(command: Sequence[str]) -> float:
    """Peak resident memory (MB) of a command."""
    code = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stderr=subprocess.DEVNULL);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    done = subprocess.run([sys.executable, "-c", code, *command], check=True, capture_output=True, text=True)
    return float(done.stdout)


def _group(folder: Path, rows: int, columns: int) -> tuple[Path, Path, Path]:
    """Write a capture of 8 lights, all of one bracket, with θ = 0 in a shard of its own."""
    counts = expose_fast(scene(rows, columns))
    for rate, one in zip(RATES, counts, strict=True):
        _write(folder / f"{rate}.dng", one, Fraction(1, rate))
    lights = tuple(PlanLight(k, f"l{k}", 10.0, 40.0 * k, (0.0, 0.6, 0.8)) for k in range(SHARD + 1))
    shots = [Shot(light.name, "light", light.index, light.theta, light.phi) for light in lights]
    shots[-1] = Shot("monitor", "monitor", SHARD, 0.0, 0.0)
    group = Group("00", tuple(range(SHARD + 1)), tuple(shots))
    plan = Plan("bench", "grid", tuple(1 / r for r in RATES), lights, (group,))
    write_plan(folder / "plan.json", plan)
    frames = [{"file": f"{rate}.dng", "exposure_s": 1 / rate} for rate in RATES]
    taken = [
        {"shot": s.shot, "kind": s.kind, "light": s.light, "time_s": 1.0, "photodiode": 1.0, "frames": frames}
        for s in shots[:-1]
    ]
    (folder / "groups").mkdir()
    write_json(folder / "groups/00.json", {"plan_sha256": plan.sha256, "shots": taken})
    eye = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    camera = bench_camera(rows, columns)
    calibration = Calibration("bench", plan.sha256, rows // 2, columns // 2, "", "", camera, "camera RGB", eye, ())
    write_calibration(folder / "calibration.json", calibration)
    return folder / "groups/00.json", folder / "plan.json", folder / "calibration.json"


def tile(folder: Path, height: int, width: int) -> dict[str, Any]:
    """Seconds to read 64 × 64 texels under 200 lights from the stack and from EXR files, none in the page cache."""
    rng = np.random.default_rng(0)
    stack = folder / "tile.zarr"
    for first in range(0, TILE_LIGHTS, SHARD):
        radiance = rng.gamma(2.0, 0.2, (SHARD, height, width, 3)).astype(np.float32)
        write_shards(stack, first, Radiance.unflagged(radiance))
        for k in range(SHARD):
            write_rgb(folder / f"light_{first + k}.exr", radiance[k].astype(np.float16).astype(np.float32))
    lights = tuple(Light(f"l{k}", (0.0, 0.0, 1.0)) for k in range(TILE_LIGHTS))
    write_metadata(stack, Metadata(lights, height, width, None, "", "", "camera", np.eye(3), {}))
    y, x = height // 128 * 64, width // 128 * 64
    side = min(64, height, width)
    opened = Stack.open(stack)
    opened.read_tile(0, 1, 0, 1)

    def from_stack() -> Any:
        return opened.read_tile(y, y + side, x, x + side).value

    def from_exr() -> Any:
        files = [read_exr(folder / f"light_{k}.exr") for k in range(TILE_LIGHTS)]
        return np.stack([np.stack([f[c][y : y + side, x : x + side] for c in "RGB"], -1) for f in files])

    times = {}
    for name, read in (("stack", from_stack), ("exr", from_exr)):
        _forget(folder)
        start, clock = time.perf_counter(), time.process_time()
        values = read()
        scale = TILE_READ / TILE_LIGHTS
        times[f"{name}_wall_s"] = (time.perf_counter() - start) * scale
        times[f"{name}_cpu_s"] = (time.process_time() - clock) * scale
        if name == "stack":
            first_values = values
    if not np.array_equal(first_values, values):
        raise AssertionError("the stack and the EXR files differ")
    ratio = {
        "wall_ratio": times["exr_wall_s"] / times["stack_wall_s"],
        "cpu_ratio": times["exr_cpu_s"] / times["stack_cpu_s"],
    }
    return {"lights": TILE_READ, "measured_lights": TILE_LIGHTS, **times, **ratio}


def _forget(folder: Path) -> None:
    """Ask the system to drop the files of a folder from its page cache."""
    for path in folder.rglob("*"):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY)
            os.fsync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)


def table(results: dict[str, Any]) -> str:
    """Table of the results, for people."""
    estimators = results["accuracy"]["estimators"]
    decades = list(estimators["crb"])
    lines = ["worst bias % / RMSE over the bound / z-rms, per decade of electrons a second", ""]
    lines.append(f"{'':30}" + "".join(f"{d:>24}" for d in decades))
    lines.append(f"{'bound, %':30}" + "".join(f"{estimators['crb'][d]['percent']:>24.3f}" for d in decades))
    for name, found in estimators.items():
        if name != "crb":
            lines.append(f"{name:30}" + "".join(f"{_cell(found[d]):>24}" for d in decades))
    lines += [f"{name}: {note}" for name, note in results["accuracy"]["left_out"].items()]
    lines += ["", *merge_black.table(results["black"])]
    for part in ("speed", "memory", "tile", "real"):
        if part in results:
            lines += ["", part, *(f"  {key:38} {_text(value)}" for key, value in results[part].items())]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return "\n".join([*lines, "", f"peak memory of the benchmark itself {peak:.0f} MB"])


def _cell(found: dict[str, float]) -> str:
    z = f" / {found['z_rms']:.3f}" if "z_rms" in found else ""
    return f"{found['worst_bias_percent']:.3g} / {found['rmse_over_crb']:.3f}{z}"


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
