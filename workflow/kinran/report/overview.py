"""Write the overview: all fabrics of a run on one HTML page."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from kinran.base.files import read_json
from kinran.base.page import embed_file, write_page


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    errors: Annotated[tuple[Path, ...], "evaluation.json of each fabric; its report and its render stand beside it"]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "page (.html)"]) -> None:
    """Gather the errors of the fabrics and write the page."""
    fabrics = [_fabric(path, out.parent) for path in inputs.errors]
    write_page(out, Path(__file__).with_name("overview.html"), {"title": "Fabrics", "fabrics": fabrics})


def _fabric(path: Path, folder: Path) -> dict[str, Any]:
    return {
        "errors": read_json(path),
        "link": os.path.relpath(path.with_name("report.html"), folder),
        "render": embed_file(path.with_name("render.png")),
    }
