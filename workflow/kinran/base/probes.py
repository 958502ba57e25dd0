"""Probes of Mitsuba and pymeshlab on this machine, each in a process of its own: a wrong library aborts it."""

import subprocess
import sys

LIBRARIES = "apt-get install --no-install-recommends libgl1 libopengl0 libatomic1 libllvm19"
"""Command that installs the system libraries that both need."""
PYMESHLAB_PLUGINS = 58
"""Plugins of pymeshlab 2025.7 when libGL and libOpenGL are both there; without the second it cannot read PLY."""

VARIANT = (
    "import sys, mitsuba as mi, drjit as dr; mi.set_variant(sys.argv[1]);"
    "dr.eval(dr.maximum(dr.opaque(mi.Float, 1.0), 2))"
)
"""Program that compiles a maximum, at which LLVM 15 and 16 abort; Dr.Jit would evaluate one of literals itself."""
PLUGINS = "import pymeshlab; print(pymeshlab.plugin_number())"
"""Program that prints the number of pymeshlab's plugins."""


def variant_fault(variant: str = "llvm_ad_rgb") -> str:
    """Return why a variant of Mitsuba cannot be used on this machine; empty where it can."""
    status, _, error = _run(VARIANT, variant)
    if status < 0:
        return f"it aborts the process (signal {-status})"
    return (error or f"exit status {status}") if status else ""


def pymeshlab_fault() -> str:
    """Return why pymeshlab cannot be used on this machine; empty where it can."""
    status, number, error = _run(PLUGINS)
    if status:
        return error or f"exit status {status}"
    return f"{number} of {PYMESHLAB_PLUGINS} plugins" if int(number) < PYMESHLAB_PLUGINS else ""


def _run(code: str, *words: str) -> tuple[int, str, str]:
    """Run a program in Python; return its exit status, its output and the last line of its errors."""
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)
    return run.returncode, run.stdout.strip(), (run.stderr.strip().splitlines() or [""])[-1]
