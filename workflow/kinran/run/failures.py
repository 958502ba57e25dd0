"""Fabrics that did not finish, each with the sentence that matters: what the overview says of them.

A run notes them in a file, which is an input of the overview: so a page that lists them is written anew once they are
cured. The file also names the run, so that it differs after each.
"""

import logging
import re
import subprocess
import sys
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from kinran.base.files import InputError, read_json, write_json
from kinran.run.fabrics import MESHES

FILE = Path("results", "failures.json")
"""Where the failures of a run are noted."""
CONFIG = "config"
"""What a fabric failed at whose row or settings are wrong."""
LEFT_OUT = "left_out"
"""Rule of the job that such a fabric gets."""
EXTRA = "chart"
"""How the logs begin of the jobs of a fabric that make nothing of what the overview shows."""

ERROR = re.compile(r"kinran [a-z-]+: |[\w.]*(Error|Exception|Exit|Interrupt)\b")
"""A line that tells of an error: that of a stage, or the last one of a traceback."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Failure:
    """Why a fabric did not finish.

    Attributes
    ----------
    fabric
        Its name.
    stage
        The rule that failed.
    says
        The sentence that matters.
    log
        Where more is said, from the working folder; empty where nowhere.
    """

    fabric: str
    stage: str
    says: str
    log: str


def forget(place: Path, left_out: dict[str, str]) -> None:
    """Begin the note of a run in the folder of results and logs: only the fabrics are in it whose rows are wrong."""
    path = place / FILE
    failures = [asdict(failure) for failure in _of_rows(left_out, place)]
    try:
        noted = read_json(path) if path.exists() else None
    except InputError:
        noted = None
    if not isinstance(noted, dict) or noted.get("failures") != failures:
        run = noted["run"] if isinstance(noted, dict) and "run" in noted else ""
        try:
            write_json(path, {"run": run, "failures": failures})
        except InputError as error:  # a dry run in a folder that is only read
            log.warning("%s", error)


class Watch(logging.Handler):
    """Notes the jobs that fail in a run, from what Snakemake logs, whatever of it is shown.

    Parameters
    ----------
    place
        Folder of results and logs.
    """

    def __init__(self, place: Path) -> None:
        super().__init__()
        self.logs = place / "logs"
        self.failed: dict[int, tuple[str, Path]] = {}
        """Rule and log of each job that failed, by its id."""

    def emit(self, record: logging.LogRecord) -> None:
        event, said = getattr(getattr(record, "event", None), "name", ""), vars(record)
        if event == "JOB_ERROR":
            self.failed[said["jobid"]] = said["rule_name"], Path(*said["log"][:1])
        elif event == "JOB_FINISHED":  # at a new attempt
            self.failed.pop(said["job_id"], None)

    def failures(self, meshes: Mapping[str, str]) -> list[Failure]:
        """Return a failure for each fabric that has one: the last, as jobs of a group are all reported with it.

        Parameters
        ----------
        meshes
            By the name of each fabric, that of its mesh: where that fails, all fabrics do that share it.
        """
        found: dict[str, tuple[float, Failure]] = {}
        for rule, path in self.failed.values():
            # (rules of a module may have other names)
            of = path.relative_to(self.logs).parts if path.is_relative_to(self.logs) else ()
            shared = of[1:2] if of[:1] == (MESHES,) else ()
            extra = len(of) < 2 or of[1].startswith(EXTRA)
            written = path.stat().st_mtime if path.is_file() else 0.0
            for fabric, mesh in meshes.items():
                failed = (mesh,) == shared or (fabric,) == of[:1]
                if failed and not extra and written >= found.get(fabric, (0.0,))[0]:
                    found[fabric] = written, Failure(fabric, rule, _last_sentence(path), str(path))
        return [failure for _, failure in found.values()]


def write_overview(
    run: str, failed: list[Failure], fabrics: Collection[str], left_out: dict[str, str], place: Path
) -> None:
    """Note the failures of a run that ended with some, and write the overview, as `kinran overview` does.

    Parameters
    ----------
    run
        Name of the run.
    failed
        The fabrics with a job that failed.
    fabrics
        Names of all fabrics that could have finished.
    left_out
        What is wrong with the rows of the others.
    place
        Folder of results and logs.
    """
    note = place / FILE
    names = {failure.fabric for failure in failed}
    files = {name: place / "results" / name / "evaluation.json" for name in fabrics if name not in names}
    missing = [name for name, path in files.items() if not (path.is_file() and path.with_name("report.html").is_file())]
    not_run = [Failure(name, "", "did not get to its report in this run", "") for name in missing]
    write_json(note, {"run": run, "failures": [*_of_rows(left_out, place), *failed, *not_run]})
    errors = [str(path) for name, path in files.items() if name not in missing]
    command = [sys.executable, "-m", "kinran", "overview", str(note.with_name("report.html"))]
    subprocess.run([*command, "--errors", *errors, "--failures", str(note)], check=False)


def _of_rows(left_out: dict[str, str], place: Path) -> list[Failure]:
    return [
        Failure(name, CONFIG, says, str(place / "logs" / name / f"{LEFT_OUT}.log")) for name, says in left_out.items()
    ]


def _last_sentence(path: Path) -> str:
    """Return the last line of a log; where it is no error, the job was ended from outside in the middle of its work."""
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    except OSError:
        lines = []
    last = next((line for line in reversed(lines) if line), "")
    if not last:
        return "said nothing: it was killed, or never began"
    return last if ERROR.match(last) else f"said no error, so it was killed, or Snakemake misses a file; last: {last}"
