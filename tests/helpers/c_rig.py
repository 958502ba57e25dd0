"""The firmware in C, compiled with the system's compiler around a simulated rig, and driven through ctypes."""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import get_args

import pytest
from rig_scenarios import Event

FIRMWARE = Path(__file__).parents[2] / "firmware"
SOURCES = ("kinran_rig.c", "host/simulated_rig.c")
STRICT = (
    *("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror"),
    *("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"),
)
"""Flags of every compilation; what C leaves undefined ends the process."""
EVENTS = (
    "door_open", "door_closed", "limit_switch", "blocked", "lamp_out", "overheated", "x_sync_out", "x_sync_in",
    "exposure", "power_cycle",
)  # fmt: skip
"""Events in the order of `enum happening` in firmware/host/simulated_rig.h."""
assert set(EVENTS) == set(get_args(Event))


def compiler() -> str:
    """Return the system's C compiler, or skip the test."""
    found = shutil.which("cc")
    if not found:
        pytest.skip("needs a C compiler: apt-get install gcc")
    return found


def compile_c(*arguments: str) -> None:
    """Compile strictly; a warning is an error, and an error fails the test with the compiler's words."""
    command = [compiler(), *STRICT, f"-I{FIRMWARE}", f"-I{FIRMWARE / 'host'}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def build(folder: Path, firmware: Path = FIRMWARE) -> ctypes.CDLL:
    """Compile the firmware and its simulated rig in a folder, and load them."""
    library = folder / "simulated_rig.so"
    sources = [str(firmware / name) for name in SOURCES]
    compile_c("-O1", "-fPIC", "-shared", *sources, "-lm", "-o", str(library))
    return load(library)


def load(library: Path) -> ctypes.CDLL:
    """Load a compiled simulated rig."""
    c = ctypes.CDLL(str(library))
    rig, data, size = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t
    c.simulation_create.argtypes, c.simulation_create.restype = [ctypes.c_uint32], rig
    c.simulation_destroy.argtypes, c.simulation_destroy.restype = [rig], None
    c.simulation_write.argtypes, c.simulation_write.restype = [rig, data, size], None
    c.simulation_read.argtypes, c.simulation_read.restype = [rig, data], ctypes.c_bool
    c.simulation_get_feature.argtypes = [rig, ctypes.c_uint8, data]
    c.simulation_get_feature.restype = ctypes.c_bool
    c.simulation_set_feature.argtypes, c.simulation_set_feature.restype = [rig, data, size], ctypes.c_bool
    c.simulation_advance.argtypes, c.simulation_advance.restype = [rig, ctypes.c_uint32], None
    c.simulation_happen.argtypes, c.simulation_happen.restype = [rig, ctypes.c_int, ctypes.c_uint8], None
    c.simulation_descriptor.argtypes = [ctypes.POINTER(size)]
    c.simulation_descriptor.restype = ctypes.POINTER(ctypes.c_uint8)
    return c


class CDevice:
    """The firmware in C (`rig_conformance.Device`)."""

    def __init__(self, library: ctypes.CDLL, seed: int = 1) -> None:
        self._c = library
        self._rig = library.simulation_create(seed)
        self._ms = 0.0
        self._told_ms = 0

    def __del__(self) -> None:
        self._c.simulation_destroy(self._rig)

    def write(self, data: bytes) -> None:
        self._c.simulation_write(self._rig, data, len(data))

    def read(self, replies: int) -> list[bytes]:
        reports = []
        report = ctypes.create_string_buffer(64)
        while self._c.simulation_read(self._rig, report):
            reports.append(report.raw)
        return reports

    def get_feature(self, report: int) -> bytes | None:
        data = ctypes.create_string_buffer(64)
        return data.raw if self._c.simulation_get_feature(self._rig, report, data) else None

    def set_feature(self, data: bytes) -> bool:
        return bool(self._c.simulation_set_feature(self._rig, data, len(data)))

    def wait(self, seconds: float) -> None:
        self._ms += 1000 * seconds
        ticks = round(self._ms) - self._told_ms
        self._told_ms += ticks
        self._c.simulation_advance(self._rig, ticks)

    def happen(self, event: Event, axis: int) -> None:
        self._c.simulation_happen(self._rig, EVENTS.index(event), axis)

    def descriptor(self) -> bytes:
        """Return the HID report descriptor."""
        length = ctypes.c_size_t()
        data = self._c.simulation_descriptor(ctypes.byref(length))
        return bytes(data[: length.value])
