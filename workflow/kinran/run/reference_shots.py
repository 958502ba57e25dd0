"""What is photographed beside a fabric, under the same lights: a colour chart, and a white card."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from kinran.data.photographs import is_picture


@dataclass(frozen=True)
class ChartShot:
    """A photograph of a colour chart.

    Attributes
    ----------
    file
        None on the rig, which shoots it itself, and where there is none.
    corners, lamp
        Options ``--chart-corners`` and ``--lamp`` of `kinran calibrate`.
    """

    file: Path | None = None
    corners: str = ""
    lamp: str = ""

    @property
    def options(self) -> str:
        """Options of `kinran calibrate`."""
        file = f"--chart {shlex.quote(str(self.file))} " if self.file else ""
        return f"{file}--chart-corners={shlex.quote(self.corners)} --lamp={shlex.quote(self.lamp)}"


@dataclass(frozen=True)
class CardShots:
    """Photographs of a white card, one or a bracket for each light.

    Attributes
    ----------
    folder
        None on the rig, which shoots a plate itself, and where there are none.
    """

    folder: Path | None = None

    @property
    def options(self) -> str:
        """Options of `kinran calibrate`."""
        return f"--flat {shlex.quote(str(self.folder))}" if self.folder else ""

    @property
    def files(self) -> list[str]:
        """Photographs, from which the calibration follows."""
        found = self.folder.rglob("*") if self.folder else ()
        return sorted(str(path) for path in found if is_picture(path))
