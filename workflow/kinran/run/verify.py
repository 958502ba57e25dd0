"""Verify the files of fabrics against their checksums, and say what to run where one is damaged."""

import logging
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from kinran.base.files import NAME, InputError, check_name
from kinran.base.log import progress
from kinran.run.damage import Checked, Fault, check_capture, check_results
from kinran.run.fabrics import MESHES

log = logging.getLogger(__name__)


def main(fabrics: Annotated[tuple[str, ...], "FABRIC", "names of fabrics (default: all that are here)"] = ()) -> None:
    """Check captures and results in the current folder.

    Raises
    ------
    InputError
        A file is damaged or missing, or there is nothing to check.
    """
    names = [check_name(name, "fabric") for name in fabrics] or _here()
    if not names:
        raise InputError(f"{Path.cwd()}: has no captures and no results; run this in the folder of the run")
    if Path("results", MESHES).is_dir():  # of which fabrics have copies
        names.append(MESHES)
    faults = [fault for name in names for fault in _verify(name)]
    if faults:
        if command := remedy(faults):
            log.error("to make them again:\n  %s", command)
        raise InputError(f"{len(faults)} files are damaged; the lines above name each")


def _here() -> list[str]:
    """Return the names of all captures and results in the current folder."""
    found = {path.name for folder in ("captures", "results") for path in Path(folder).glob("*") if path.is_dir()}
    return sorted(name for name in found if NAME.fullmatch(name))


def _verify(name: str) -> list[Fault]:
    """Check the files of a fabric, say what is wrong, and return it."""
    folders = [Path("captures", name), Path("results", name)]
    if not any(folder.is_dir() for folder in folders):
        raise InputError(f"{folders[0]}: no such folder, and no {folders[1]}; give the name of a fabric")
    found: dict[Path, Checked] = {}
    for checked in _with_progress(name, folders):
        if checked.path not in found or checked.fault:
            found[checked.path] = checked
    faults = list({checked.fault.says: checked.fault for checked in found.values() if checked.fault}.values())
    for fault in faults:
        log.error("%s", fault.says)
    bare = sorted({path.name for path, checked in found.items() if not checked.has_checksum and not checked.fault})
    without = f"; without a checksum: {', '.join(bare)}" if bare else ""
    log.info("%s: %d files checked, %d damaged%s", name, len(found), len(faults), without)
    return faults


def _with_progress(name: str, folders: list[Path]) -> Iterator[Checked]:
    for folder, check in zip(folders, (check_capture, check_results), strict=True):
        total = sum(path.is_file() for path in folder.rglob("*"))
        yield from progress(check(folder), f"{name}: {folder.parent}", "files", total)


def remedy(faults: list[Fault]) -> str:
    """Return the command that makes the damaged files again; empty where no job makes any of them."""
    removed = sorted({fault.removed.as_posix() for fault in faults if fault.removed})
    forced = sorted({fault.forced.as_posix() for fault in faults if fault.forced})
    parts = [f"rm {shlex.join(removed)}"] if removed else []
    parts += [f"snakemake --forcerun {shlex.join(forced)}" if forced else "snakemake"] if removed or forced else []
    return " && ".join(parts)
