"""What the fit was told that its scene needs, and whether the scene needs it still: before jobs are planned.

Another camera changes what a scene needs (`need.json`). The fit uses two things of that at most: how many texels can be
averaged to one, and which regions are shown. It has them from a file of its own (`fit/need.json`), whose job is asked
the same as before while they stay the same: so a fit stays where a look at the new scene finds what it was made with.

Snakemake's `ancient` cannot say this: of a job that it does not run for an ancient input it forgets all other reasons.
"""

import hashlib
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from kinran.base.files import InputError, read_json
from kinran.data.needed_regions import Need, read_need
from kinran.scene.template import need_key

FOLDER = Path(".snakemake") / "kinran"
"""Folder of the answers of looks at scenes, from the working folder."""


@dataclass(frozen=True)
class Uses:
    """Whether a fit uses how many texels can be averaged to one, and which regions are shown."""

    texels: bool
    regions: bool

    def of(self, need: Need) -> object:
        """Return what the fit uses of a need, to be compared."""
        return self.texels and need.footprint.coarsest_factor, self.regions and need.regions


def question(results: Path, template: Path, uses: Uses) -> str:
    """Return what the job for `fit/need.json` is asked: another question than before runs it, and the fit, again.

    Where nothing is there to compare, or a look at the scene fails, as the job then will, it is that of the template.
    """
    now, told = need_key(template), results / "fit" / "need.json"
    try:
        before = str(read_json(told)["asked"])
        same = before == now or uses.of(read_need(told)) == uses.of(_need(results, template))
    except (InputError, LookupError, TypeError, OSError, subprocess.CalledProcessError):
        return now
    return before if same else now


@cache
def _need(results: Path, template: Path) -> Need:
    """Return what a template needs of a fabric: as its results say, or as a look at the scene finds."""
    said, key = results / "need.json", need_key(template)
    if said.is_file() and read_json(said).get("asked") == key:
        return read_need(said)
    words = [key]
    for name in ("scene/mesh.ply", "labels.exr", "regions.json", "radiance.zarr/zarr.json"):
        status = (results / name).stat()
        words.append(f"{status.st_size} {status.st_mtime_ns}")
    answer = FOLDER / f"{results.name}.{hashlib.sha256(' '.join(words).encode()).hexdigest()[:12]}.json"
    if not answer.is_file():
        for old in FOLDER.glob(f"{results.name}.*.json"):
            old.unlink()
        stage = [sys.executable, "-m", "kinran", "need", str(answer), "--template", str(template)]
        of = ["--mesh", str(results / "scene" / "mesh.ply"), "--fabric", str(results)]
        subprocess.run([*stage, *of], capture_output=True, check=True)
    return read_need(answer)
