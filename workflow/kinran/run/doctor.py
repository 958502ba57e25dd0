"""Check this machine: libraries, Python packages, cores, memory and disk; name a remedy for each check that fails."""

import importlib
import importlib.metadata
import importlib.util
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError
from kinran.base.probes import LIBRARIES, PYMESHLAB_PLUGINS, pymeshlab_fault, variant_fault
from kinran.base.project import ROOT

LEAST_MEMORY_GB, LEAST_DISK_GB = 4, 3
"""Least memory and disk space for the demo. Its files take 0.15 GB and the packages of .venv 2 GB; no measurement
stands behind the memory."""
PACKAGES = (
    "mitsuba", "drjit", "snakemake", "OpenEXR", "colour-science", "hidapi", "libigl", "numba", "zarr",
    "rawpy", "kinran-bsdf",
)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """Result of a check: whether all is well, what was found, and what to do if not."""

    well: bool
    found: str
    remedy: str = ""


def main() -> None:
    """Print one line for each check.

    Raises
    ------
    InputError
        Something is missing that the pipeline needs.
    """
    failed = 0
    for name, check in CHECKS.items():
        finding = check()
        failed += not finding.well
        print(f"{'ok  ' if finding.well else 'FAIL'}  {name:<18} {finding.found}", flush=True)
        if not finding.well:
            print(f"{'':24} {finding.remedy}", flush=True)
    if failed:
        raise InputError(f"{failed} of {len(CHECKS)} checks failed; each line above says what to do")


def python() -> Finding:
    """Version of Python."""
    version = ".".join(str(part) for part in sys.version_info[:3])
    return Finding(sys.version_info >= (3, 11), f"{version} in {sys.prefix}", "install Python 3.11 or newer")


def packages() -> Finding:
    """Python packages that the pipeline imports."""
    found, missing = [], []
    for name in PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    remedy = f"missing: {', '.join(missing)}; remove .venv and call ./kinran again"
    return Finding(not missing, ", ".join(found), remedy)


def llvm() -> Finding:
    """Whether Dr.Jit can compile."""
    if fault := variant_fault():
        return Finding(False, f"LLVM: {fault}", f"Mitsuba 3.9 needs LLVM 17 or newer: {LIBRARIES}; 15 and 16 abort")
    return Finding(True, os.environ.get("DRJIT_LIBLLVM_PATH", "the system's libLLVM works with Dr.Jit"))


def meshlab() -> Finding:
    """Whether pymeshlab has all its plugins: without libOpenGL it loses the reading of meshes."""
    fault = pymeshlab_fault()
    return Finding(not fault, fault or f"{PYMESHLAB_PLUGINS} plugins", LIBRARIES)


def compiled() -> Finding:
    """Whether the compiled plugin, where there is one, is that of these sources and this Mitsuba."""
    from kinran_bsdf import native

    library = ROOT / "native" / "plugins" / "kinran.so"
    if not library.exists():
        return Finding(True, "none; optional")
    return Finding(
        not native.stale(library), str(library), "compiled from other sources or for another Mitsuba: kinran native"
    )


def pycolmap() -> Finding:
    """Whether side views can be registered; nothing else needs pycolmap."""
    try:
        return Finding(True, importlib.metadata.version("pycolmap"))
    except importlib.metadata.PackageNotFoundError:
        return Finding(True, "none; optional: kinran register needs it, pip install 'pycolmap>=4.2'")


def hid() -> Finding:
    """Whether the module `hid` is that of hidapi: another package of that name hides it."""
    for name in ("hidraw", "hid"):
        if importlib.util.find_spec(name) is None:
            continue
        try:
            module = importlib.import_module(name)
        except ImportError as error:
            return Finding(False, f"{name}: {error}", "apt-get install libusb-1.0-0 libudev1")
        if hasattr(module, "device") and hasattr(module, "version_str"):
            return Finding(True, f"{name}, hidapi {module.version_str()}")
    remedy = "pip uninstall hid; pip install --force-reinstall hidapi"
    return Finding(False, "another package named 'hid' stands before hidapi", remedy)


def cores() -> Finding:
    """Processors that may be used."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Finding(True, f"{count}")


def memory() -> Finding:
    """Memory of the machine."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return Finding(total >= LEAST_MEMORY_GB, f"{total:.1f} GB", f"{LEAST_MEMORY_GB} GB are needed for the demo")


def disk() -> Finding:
    """Free space where results go."""
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    return Finding(free >= LEAST_DISK_GB, f"{free:.1f} GB free in {Path.cwd()}", f"make room: {LEAST_DISK_GB} GB")


def writable() -> Finding:
    """Whether results can be written."""
    return Finding(os.access(Path.cwd(), os.W_OK), str(Path.cwd()), "work in a folder that you may write to")


def snakefile() -> Finding:
    """Whether the workflow is where the library expects it."""
    return Finding((ROOT / "Snakefile").is_file(), str(ROOT), "work in a clone of the project")


CHECKS: dict[str, Callable[[], Finding]] = {
    "Python": python,
    "packages": packages,
    "LLVM for Mitsuba": llvm,
    "compiled plugin": compiled,
    "pymeshlab": meshlab,
    "pycolmap": pycolmap,
    "hidapi": hid,
    "cores": cores,
    "memory": memory,
    "disk": disk,
    "output folder": writable,
    "workflow": snakefile,
}
