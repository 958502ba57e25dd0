"""Number of runs in which a material was fitted: no value of the material depends on it.

It is kept beside the material, in a file that is no output of the job which writes it: Snakemake removes outputs before
the job runs, and the job, which is planned anew on another machine, has to find the number that it was planned with.
"""

from pathlib import Path

from kinran.base.files import InputError, read_json, write_json

RUNS = ".runs.json"
"""End of the name of such a file, which begins with a dot and the name of the material."""


def write_runs(material: Path, runs: int, of: str) -> None:
    """Note in how many runs a material was fitted, and of which settings they were."""
    write_json(_path(material), {"runs": runs, "of": of})


def read_runs(material: Path, of: str, asked: int) -> int:
    """Return in how many runs a material was fitted; how many are asked for where it was not, or of other settings."""
    path = _path(material)
    try:
        noted = read_json(path) if path.is_file() else {}
        return int(noted["runs"]) if noted.get("of") == of else asked
    except (InputError, AttributeError, LookupError, TypeError, ValueError):
        return asked


def _path(material: Path) -> Path:
    return material.with_name(f".{material.stem}{RUNS}")
