"""Rows of the chart's table, and its file."""

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

from kinran.base.files import InputError, atomic

MEASURES = (
    "relative_error",
    "log_error",
    "texel_median",
    "texel_p95",
    "texels_above_1",
    "psnr_linear",
    "psnr_display",
    "ssim_linear",
    "ssim_display",
    "microseconds",
    "bytes",
    "memory_mb",
    "peak_mb",
    "aic",
    "bic",
    "accuracy",
)
KEYS = ("fabric", "experiment", "setting", "method", "family", "lights")


@dataclass(frozen=True)
class Row:
    """One method in one setting of one experiment.

    Attributes
    ----------
    experiment
        ``all`` (every training light), ``directions``, ``exposures``, ``theta``, ``ring``, ``extrapolation``,
        ``region``; ``floor`` holds the time that reading the samples once takes, ``segmentation`` how many labels
        are right.
    setting
        Number of directions or exposures, band of θ, name of the region, or kind of texels; empty for ``all``. For
        ``floor`` it is the measure that the front is judged by.
    family
        ``baseline``, ``paper``, ``kinran``, or ``default`` for the material that the pipeline wrote.
    lights
        Number of training lights.
    values
        Values of those `MEASURES` that apply, by name.
    """

    fabric: str
    experiment: str
    setting: str
    method: str
    family: str
    lights: int
    values: dict[str, float] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        return self.values.get(name, math.nan)


def write(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV; measures that do not apply are empty."""
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow([*KEYS, *MEASURES])
        for row in rows:
            numbers = ["" if math.isnan(row[name]) else f"{row[name]:.6g}" for name in MEASURES]
            table.writerow([*(getattr(row, key) for key in KEYS), *numbers])


def read(path: Path) -> list[Row]:
    """Read the rows of a table.

    Raises
    ------
    InputError
        The file is missing or is no table of a chart.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [
                Row(
                    line["fabric"],
                    line["experiment"],
                    line["setting"],
                    line["method"],
                    line["family"],
                    int(line["lights"]),
                    {name: float(line[name]) for name in MEASURES if line.get(name)},
                )
                for line in csv.DictReader(file)
            ]
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: is no table of a chart ({error}); make it again with `kinran chart`") from None
