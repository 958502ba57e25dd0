"""Processor time of reading a tile of a stack from disk: the project's reader, and Zarr's."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, Stack, write_metadata, write_shards
from kinran.data.shards import NAMES

REPEATS = 5
"""Times that a tile is read; the least time counts."""


def measure(images: NDArray[np.float32], directions: NDArray[np.float64]) -> dict[str, float]:
    """CPU microseconds a texel to read a stack of one tile under all its lights.

    Parameters
    ----------
    images : (light, y, x, 3)
        Radiance.
    directions : (light, 3)
        Directions of the lights.
    """
    lights = tuple(Light(str(k), tuple(direction)) for k, direction in enumerate(directions.tolist()))
    height, width = images.shape[1:3]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_shards(folder, 0, Radiance.unflagged(images))
        write_metadata(folder, Metadata(lights, height, width, None, "", "", "camera", np.eye(3), {}))
        stack, arrays = Stack.open(folder), [zarr.open_array(folder / name, mode="r") for name in NAMES]
        calls: dict[str, Callable[[], Any]] = {
            "kinran": lambda: stack.read_stored(0, height, 0, width),
            "zarr": lambda: [array[:] for array in arrays],
        }
        return {name: round(1e6 * _least(call) / (height * width), 2) for name, call in calls.items()}


def _least(call: Callable[[], Any]) -> float:
    """Least CPU seconds of a call, in all threads."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)
