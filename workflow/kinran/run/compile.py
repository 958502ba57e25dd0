"""Compile what stages run, once for an installation and a kind of processor; else the first job of each stage waits.

Numba keeps compiled functions beside their sources, or where ``NUMBA_CACHE_DIR`` says, by the name of the processor. So
on a cluster whose nodes differ, this runs once on each kind of node. Where that folder cannot be written, each user has
one in the home folder.
"""

import logging
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import yaml
from numba import config

from kinran.base.digest import PACKAGES
from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.fit import solver

SINGLE = 1
"""Frames of a light in most sets of photographs."""

log = logging.getLogger(__name__)


def main() -> None:
    """Compile, and remove what was compiled of sources that have changed.

    Raises
    ------
    InputError
        Something cannot be compiled.
    """
    for path in stale(PACKAGES["kinran"], Path(config.CACHE_DIR).name):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()
    exposures = {SINGLE, len(_shipped()["rig"]["exposures"])}
    command = [sys.executable, "-m", "kinran.bracket.entries", *map(str, sorted(exposures))]
    with subprocess.Popen(command) as merge:
        solver.prepare()
    if merge.returncode:
        raise InputError("the merge cannot be compiled; the messages above say why")
    log.info("compiled in %s", config.CACHE_DIR)


def _shipped() -> "dict[str, dict[str, list[float]]]":
    shipped: dict[str, dict[str, list[float]]] = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    return shipped


def stale(package: Path, solver_now: str) -> Iterator[Path]:
    """Yield the compiled files beside a package's sources that nothing loads any more.

    They are the folders of other versions of the solver, and files older than the source that they were compiled from.
    """
    for path in sorted(package.glob("fit/solver/__pycache__/*/")):
        if path.name != solver_now:
            yield path
    for path in sorted(package.glob("**/__pycache__/*.nb[ic]")):
        source = path.parent.parent / f"{path.name.split('.')[0]}.py"
        if not source.exists() or path.stat().st_mtime < source.stat().st_mtime:
            yield path
