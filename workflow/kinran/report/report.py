"""Write the report of a fabric: one HTML page that needs nothing else."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric's results"]
    captures: Annotated[Path, "folder of the fabric's capture"]
    choice: Annotated[Path | None, "lobes that `kinran choice` chose (.json), if they were not given"] = None


def main(inputs: Inputs, out: Annotated[Path, "OUT", "page (.html)"]) -> None:
    """Gather the values of the report and write the page."""
    from kinran.base.page import write_page
    from kinran.report.contents import gather

    values = gather(inputs.fabric, inputs.captures, inputs.choice)
    write_page(out, Path(__file__).with_name("fabric.html"), values)
