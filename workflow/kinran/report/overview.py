"""Write the overview: all fabrics of a run on one HTML page, and why some did not finish."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from kinran.base.files import InputError, read_as, read_json
from kinran.base.page import embed_file, write_page
from kinran.data.verdict import verdict


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    failures: Annotated[Path, "the fabrics that did not finish (.json)"]
    errors: Annotated[
        tuple[Path, ...], "evaluation.json of each fabric; its report and its render stand beside it"
    ] = ()


@dataclass(frozen=True)
class _Failures:
    """The note of a run, as `kinran.run.failures` writes it."""

    run: str
    failures: tuple[dict[str, str], ...]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "page (.html)"]) -> None:
    """Gather the errors of the fabrics and write the page.

    Raises
    ------
    InputError
        A fabric's files are damaged; the page is written, and lists it.
    """
    fabrics, damaged = [], {}
    for path in inputs.errors:
        try:
            fabrics.append(_fabric(path, out.parent))
        except InputError as error:
            damaged[path.parent.name] = str(error)
    failed = [
        _failure(failure, out.parent) for failure in read_as(inputs.failures, _Failures, "a note of failures").failures
    ]
    failed += [{"fabric": name, "stage": "overview", "says": says, "link": ""} for name, says in damaged.items()]
    values = {"title": "Fabrics", "fabrics": fabrics, "failed": failed}
    write_page(out, Path(__file__).with_name("overview.html"), values)
    if damaged:
        raise InputError("; ".join(damaged.values()))


def _fabric(path: Path, folder: Path) -> dict[str, Any]:
    errors = read_json(path)
    return {
        "errors": errors,
        "verdict": verdict(errors),
        "link": os.path.relpath(path.with_name("report.html"), folder),
        "render": embed_file(path.with_name("render.png")),
    }


def _failure(failure: dict[str, str], folder: Path) -> dict[str, str]:
    return {**failure, "link": os.path.relpath(failure["log"], folder) if failure["log"] else ""}
