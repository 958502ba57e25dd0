"""Compile the BSDF `kinran` for Mitsuba's scalar variants and its command `mitsuba`, against the installed wheel.

It is optional: the plugin in Python is the product, and renders as fast in the LLVM variants. A compiled plugin belongs
to the version of Mitsuba that it was compiled against; compile it again after an update. Compiling works on Linux for
x86-64 and needs g++ and the package nanobind, whose headers those of Mitsuba include.
"""

import argparse
import hashlib
import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent
FLAGS = (
    *("-std=c++17", "-O2", "-fPIC", "-shared", "-mavx2", "-mfma", "-mf16c", "-fno-strict-aliasing"),
    *("-DNDEBUG", "-DLITTLE_ENDIAN", "-DMI_ENABLE_LLVM=1", "-DMI_ENABLE_CUDA=1", "-DMI_ENABLE_EMBREE=1"),
    "-DMI_ENABLE_AUTODIFF=1",
)
"""Flags of the compiler. They are part of the wheel's ABI: without AVX2 vectors have another size, and scalar variants
crash."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments to a parser."""
    parser.add_argument("--out", type=Path, default=Path("native"), help="folder for plugins/kinran.so (native)")


def main(args: argparse.Namespace) -> None:
    """Compile the plugin, and print how to use it."""
    if reason := missing():
        raise SystemExit(f"kinran native: {reason}")
    try:
        library = build(args.out)
    except (RuntimeError, OSError) as error:
        raise SystemExit(f"kinran native: {error}") from None
    print(f"{library}: use it with `mitsuba -m scalar_rgb -a {args.out} SCENE.xml`", file=sys.stderr)


def missing() -> str:
    """Return what this machine lacks to compile the plugin; empty if nothing."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return f"has no recipe for {sys.platform} on {platform.machine()}; use the plugin in Python"
    if not shutil.which("g++"):
        return "needs g++: apt-get install g++"
    if find_spec("nanobind") is None:
        return "needs the headers of the Python package nanobind: pip install nanobind==2.14.0"
    return ""


def stamp() -> str:
    """Return a digest of the sources and the version of Mitsuba, which `build` writes into the plugin."""
    sources = b"".join((HERE / name).read_bytes() for name in ("kinran.cpp", "material.h", "models.h"))
    return f"kinran {hashlib.sha256(sources).hexdigest()[:16]} for Mitsuba {version('mitsuba')}"


def stale(library: Path) -> bool:
    """Return whether a compiled plugin is of other sources, or of another version of Mitsuba."""
    return stamp().encode() not in library.read_bytes()


def build(folder: Path) -> Path:
    """Compile to `folder`/plugins/kinran.so, which takes half a minute; return its path.

    Raises
    ------
    RuntimeError
        The compiler fails, or a package is missing; the message has the compiler's first error.
    """
    mitsuba, drjit, nanobind = (_package(name) for name in ("mitsuba", "drjit", "nanobind"))
    headers = mitsuba / "include", drjit / "include", nanobind / "include", nanobind / "ext" / "robin_map" / "include"
    library = folder / "plugins" / "kinran.so"
    library.parent.mkdir(parents=True, exist_ok=True)
    part = library.with_suffix(".part")
    command = ["g++", *FLAGS, f'-DKINRAN_STAMP="{stamp()}"', *(f"-I{path}" for path in headers)]
    command += [str(HERE / "kinran.cpp"), "-o", str(part), f"-L{mitsuba}", "-lmitsuba", f"-L{drjit}"]
    command += ["-ldrjit-core", "-ldrjit-extra", f"-Wl,-rpath,{mitsuba}:{drjit}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        part.unlink(missing_ok=True)
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[-200:])
        raise RuntimeError(f"kinran.cpp: does not compile against the installed Mitsuba ({first})")
    part.replace(library)
    return library


def _package(name: str) -> Path:
    spec = find_spec(name)
    if spec is None or not spec.origin:
        raise RuntimeError(f"{name}: is not installed")
    return Path(spec.origin).parent
