"""Accuracy of merging RAW files of known light under the black levels that cameras have: by site, row and fraction.

Files of the virtual sensor go the whole way of ``kinran merge``. All cases of a depth have the same photons and the
same read noise, so that what a case adds to the bias of the clean one is its black level's alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.merge import read, timed
from kinran.bracket.superpixels import merge_sites
from kinran.bracket.uncalibrated import describe
from kinran.virtual.dng import Tags, write_dng
from kinran.virtual.sensor import BORDER, CROSSTALK, Sensor

Array = NDArray[np.float64]

RATES = (25, 100, 250, 1000, 4000)
"""Shutter speeds of the paper's bracket, 1/s."""
SECONDS = 2.0 ** (-np.array([14, 20, 24, 30, 36]) / 3)
"""Their times, as third stops."""
LEVELS = np.logspace(3, 7.9, 24)
"""Electrons a second at a site that sees unit light in all channels of the camera. Choices."""
LEAST_SNR = 10
"""Signal over noise of a sample from which its bias counts."""
IDEAL = {"prnu": 0.0, "hot": 0.0, "dark": 0.0, "flicker": 0.0, "black_drift": 0.0, "columns": 42}
"""What both sensors have: nothing but photons, read noise and rounding, so that a bias is that of merging. 42 masked
columns are those of the EOS Kiss Digital X."""
TWELVE = Sensor(full_well=3470 * 12.1, gain=12.1, read=20.0, black=256, **IDEAL)  # type: ignore[arg-type]
"""The synthetic camera of `merge_accuracy`."""
FOURTEEN = Sensor(full_well=62_000.0, gain=4.76, read=14.0, black=2048, **IDEAL)  # type: ignore[arg-type]
"""A sensor of 14 bits; its numbers are made up."""


@dataclass(frozen=True)
class Case:
    """A camera, and what its files say.

    Attributes
    ----------
    sensor
        The camera.
    stated
        Black level that files state.
    border
        ``masked`` for a dark border, ``none``, or ``lit`` for rows of the picture that files call a border.
    clean
        Case of the same camera without a fault.
    """

    sensor: Sensor
    stated: float | tuple[float, float, float, float]
    border: str = "masked"
    clean: str = "14 bit"


def _of(sensor: Sensor, stated: float | tuple[float, float, float, float], border: str = "none", **faults: Any) -> Case:
    clean = "12 bit" if sensor is TWELVE else "14 bit"
    return Case(replace(sensor, **faults), stated, border, clean)


SITES = (-3.0, 0.0, 0.0, 5.0)
"""What the levels of R, G1, G2 and B differ by, in counts, as in a file that was found."""
CASES = {
    "12 bit": _of(TWELVE, 256, "masked"),
    "12 bit, 63.4 stated": _of(TWELVE, 63.4, black=63.4),
    "12 bit, 63 stated for 63.4": _of(TWELVE, 63, black=63.4),
    "12 bit, each frame 0.3 off, masked": _of(TWELVE, 256, "masked", black_drift=0.3),
    "14 bit": _of(FOURTEEN, 2048, "masked"),
    "14 bit, 2045, 2048, 2048, 2053 stated": _of(FOURTEEN, (2045, 2048, 2048, 2053), site_black=SITES),
    "14 bit, the same, 2048 stated": _of(FOURTEEN, 2048, site_black=SITES),
    "14 bit, the same, masked": _of(FOURTEEN, 2048, "masked", site_black=SITES),
    "14 bit, rows of G2 and B 3 higher, masked": _of(FOURTEEN, 2048, "masked", site_black=(0, 0, 3, 3)),
    "14 bit, rows drift by 2, masked": _of(FOURTEEN, 2048, "masked", row_drift=2.0),
    "14 bit, rows drift by 2 and jump by 0.5, masked": _of(FOURTEEN, 2048, "masked", row_drift=2.0, row_noise=0.5),
    "14 bit, border lit": _of(FOURTEEN, 2048, "lit"),
}
"""Cameras by what they are."""


def measure(folder: Path, rows: int, columns: int) -> dict[str, Any]:
    """Bias and σ of each case.

    Parameters
    ----------
    folder
        Folder for the files.
    rows, columns
        Size of the picture in sites.

    Returns
    -------
    dict
        By case: the worst bias of a level with a signal over noise of ten (%), its standard error (%), the worst
        change of such a bias from that of the clean sensor (%), z-rms, and the worst error of a ratio of times (%).
    """
    found: dict[str, Any] = {}
    biases: dict[str, Array] = {}
    for name, case in CASES.items():
        try:
            bias, error, snr, z, ratios = _merged(folder, case, rows // 2, columns // 2)
        except InputError as refused:
            found[name] = {"refused": str(refused)}
            continue
        biases[name] = bias
        use = np.flatnonzero(snr.ravel() >= LEAST_SNR)
        worst = use[np.argmax(np.abs(bias.ravel()[use]))]
        change = np.abs(bias - biases[case.clean]).ravel()[use]
        found[name] = {
            "worst_bias_percent": 100 * float(bias.ravel()[worst]),
            "standard_error_percent": 100 * float(error.ravel()[worst]),
            "worst_change_percent": 100 * float(change.max()),
            "mean_bias_percent": 100 * float(bias.ravel()[use].mean()),
            "z_rms": z,
            "worst_ratio_percent": 100 * ratios,
        }
    return found


def _merged(folder: Path, case: Case, height: int, width: int) -> tuple[Array, Array, Array, float, float]:
    """Relative bias, its standard error and signal over noise (level, channel); z-rms; worst error of a time ratio."""
    bars = np.repeat(LEVELS, -(-width // len(LEVELS)))[:width]
    even = np.linalg.inv(CROSSTALK).sum(1)  # light that all channels of the camera see alike
    radiance = (even * (bars / case.sensor.rate)[None, :, None]).astype(np.float32)
    radiance = np.broadcast_to(radiance, (height, width, 3))
    frames = timed(_files(folder, case, radiance), "")
    bracket, _ = read(frames, "")
    camera = describe([bracket])
    merged = merge_sites(bracket, camera)
    assert merged.sigma is not None
    seconds = np.array([exposure.seconds for exposure in camera.exposures])
    ratios = np.abs(seconds[:-1] / seconds[1:] / (SECONDS[:-1] / SECONDS[1:]) - 1).max()
    truth = bars / case.sensor.gain
    relative = merged.value / truth[:, None] - 1
    relative = np.where(np.isfinite(merged.sigma), relative, np.nan)
    z = float(np.sqrt(np.nanmean((relative * truth[:, None] / merged.sigma) ** 2)))
    of = [relative[:, bars == level] for level in np.unique(bars)]
    bias = np.array([np.nanmean(one, (0, 1)) for one in of])
    spread = np.array([np.nanstd(one, (0, 1)) for one in of])
    count = np.array([np.isfinite(one).sum((0, 1)) for one in of])
    return bias, spread / np.sqrt(count), 1 / spread, z, float(ratios)


def _files(folder: Path, case: Case, radiance: NDArray[np.float32]) -> Sequence[Path]:
    """Write the frames of a case."""
    paths = []
    bits = 4095 if case.clean == "12 bit" else 16383
    for k, (rate, seconds) in enumerate(zip(RATES, SECONDS, strict=True)):
        counts = case.sensor.expose(radiance, float(seconds), 1.0, 0, np.array([k], np.uint64))
        columns, border = case.sensor.columns, BORDER
        if case.border != "masked":
            counts, columns, border = counts[BORDER:, columns:], 0, BORDER if case.border == "lit" else 0
        path = folder / f"black_{rate}.dng"
        said = Tags(Fraction(1, rate), border, case.stated, bits, "2000:01:01 00:00:00", columns=columns)
        write_dng(path, np.ascontiguousarray(counts), said)
        paths.append(path)
    return paths


def table(found: dict[str, Any]) -> list[str]:
    """Lines of a table of the cases, for people."""
    lines = [
        f"RAW files of known light: bias where a sample has {LEAST_SNR} times its noise, %",
        f"{'':50}{'worst ± error':>20}{'from clean':>12}{'mean':>9}{'z-rms':>8}{'time ratio':>12}",
    ]
    for name, row in found.items():
        if "refused" in row:
            lines.append(f"{name:50}  refused: {row['refused']}")
            continue
        worst = f"{row['worst_bias_percent']:+.3f} ± {row['standard_error_percent']:.3f}"
        lines.append(
            f"{name:50}{worst:>20}{row['worst_change_percent']:>12.3f}{row['mean_bias_percent']:>+9.3f}"
            f"{row['z_rms']:>8.3f}{row['worst_ratio_percent']:>12.4f}"
        )
    return lines
