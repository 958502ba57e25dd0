"""Costs of a method: processor time, memory, and the floor that reading the samples once sets."""

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

R = TypeVar("R")

PROC = Path("/proc/self")
REPEAT_UNDER = 0.5
"""Seconds under which a method is timed three times; the least time counts. A choice."""


@dataclass(frozen=True)
class Cost:
    """Seconds of processor time, MiB of memory above that held before (-1 if unknown), and peak MiB of the process."""

    seconds: float
    memory: float
    peak: float


def measure(work: Callable[[], R]) -> tuple[R, Cost]:
    """Do a piece of work, and return its result and its cost."""
    before = _resident("VmRSS") if _reset_peak() else -1.0
    start = time.process_time()
    result = work()
    seconds = time.process_time() - start
    peak = _resident("VmHWM")
    memory = max(peak - before, 0.0) if before >= 0 else -1.0
    for _ in range(2 if seconds < REPEAT_UNDER else 0):
        start = time.process_time()
        work()
        seconds = min(seconds, time.process_time() - start)
    return result, Cost(seconds, memory, peak)


def bandwidth(megabytes: int = 256) -> float:
    """Bytes a second that one core reads from memory, the best of five."""
    block = np.ones(megabytes << 18, np.float32)
    best = np.inf
    for _ in range(5):
        start = time.process_time()
        np.dot(block, block)
        best = min(best, time.process_time() - start)
    return float(block.nbytes / max(best, 1e-9))


def _reset_peak() -> bool:
    """Let the peak of resident memory start from now; False where the kernel has no such thing."""
    try:
        ctypes.CDLL(None).malloc_trim(0)  # what was freed before must not be had for nothing
    except (AttributeError, OSError, TypeError):  # no glibc
        return False
    try:
        (PROC / "clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _resident(name: str) -> float:
    """VmRSS or VmHWM of this process, MiB."""
    lines = (PROC / "status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith(name))
