"""Merging on real brackets: patches of a chart in narrow bands against their measured spectra.

Data of bllanos/chromatic-aberration (Boost licence): 8-bit Bayer frames of a CCD, 7 exposures in each of 7 bands.
"""

import csv
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from kinran.bracket.estimator import estimate_rows
from kinran.bracket.exposures import measure, row_seconds
from kinran.bracket.noise import measure_noise
from kinran.calibrate import colour_chart
from kinran.data.calibration import MARGIN, Exposure, Response
from kinran.data.nominal_time import time_in_name

Array = NDArray[np.float64]

BANDS = (450, 500, 550, 600, 650, 700)
"""Middles of the bands that are merged, in nm."""
FRAMES = "hdr_llanos/demo_data/captured_images/images_filtered_light/color_checker"
CHECKER = "checker_llanos/demo_data"
LABELS = "colorChecker_labels/d2_colorChecker30cm_550nm_labels.png"
SPECTRA = "spectral_data/spectra_averaged.csv"
FIRST_PATCH = "dark skin"
SITES = {"R": ((1, 0),), "G": ((0, 0), (1, 1)), "B": ((0, 1),)}
"""Rows and columns of the colours in the Bayer pattern, which is GBRG."""
LEAST_PIXELS = 100
"""Fewest sites that a patch is read from. A choice."""
ROWS = np.repeat(np.arange(4), 6)
COLUMNS = np.tile(np.arange(6), 4)


def evaluate(data: Path) -> dict[str, Any]:
    """Residuals of the merged patches against the spectra, ratios of exposures, and leave-one-out ΔE00."""
    labels = np.asarray(imagecodecs.png_decode((data / CHECKER / LABELS).read_bytes()))
    spectra = _spectra(data / CHECKER / SPECTRA)
    bands = {band: merge_band(data / FRAMES, band) for band in BANDS}
    reading = np.stack([_patches(rate, sigma, labels, _channel(band)) for band, (rate, sigma, _) in bands.items()])
    true = np.stack([np.mean([spectra[nm] for nm in range(band - 10, band + 11)], 0) for band in BANDS])
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(reading / true)
    residual = logs - np.nanmedian(logs, 1, keepdims=True)
    residual -= _field(np.nanmedian(residual, 0))  # one light field for all bands
    relative = np.abs(np.expm1(residual))
    balanced = reading / np.exp(np.nanmedian(logs, 1, keepdims=True))
    rgb = np.stack([balanced[BANDS.index(band)] for band in (600, 550, 450)], -1)
    seen = np.isfinite(rgb).all(-1)
    rgb /= np.exp(_field(np.nanmedian(logs - np.nanmedian(logs, 1, keepdims=True), 0)))[:, None]
    reference = colour_chart.references()[seen]
    ratios = [e.seconds / e.prior_s for _, _, exposures in bands.values() for e in exposures[1:] if e.sites]
    return {
        "patches": int(np.isfinite(residual).sum()),
        "median_residual_percent": 100 * float(np.nanmedian(relative)),
        "worst_patch": int(np.nanargmax(np.nanmedian(relative, 0))),
        "worst_patch_residual_percent": 100 * float(np.nanmax(np.nanmedian(relative, 0))),
        "range": float(np.nanmax(reading) / np.nanmin(reading[reading > 0])),
        "times_over_nominal": [float(np.min(ratios)), float(np.median(ratios)), float(np.max(ratios))],
        "leave_one_out_delta_e": {
            "linear": float(colour_chart.leave_one_out(rgb[seen], reference, 1).mean()),
            "root polynomial": float(colour_chart.leave_one_out(rgb[seen], reference, 2).mean()),
            "patches": int(seen.sum()),
        },
    }


def merge_band(folder: Path, band: int) -> tuple[Array, Array, tuple[Exposure, ...]]:
    """Merged mosaic (y, x) of a band in counts a second, its σ, and the exposures; top row first."""
    paths = sorted(folder.glob(f"*_{band}nm_*.tif"), key=lambda path: -time_in_name(path.stem))
    times = [time_in_name(path.stem) for path in paths]
    frames = np.stack([tifffile.imread(path) for path in paths]).astype(np.uint16)
    planes = frames[:, None]
    black = np.zeros((len(times), 1, planes.shape[2]))
    rough = Response(254 / MARGIN, 0.01, 0.3)
    # as photographs are taken: the frames were scaled by their author, so that sites beside saturated ones mix
    three = np.repeat(planes, 3, 1)
    exposures = measure([three], [np.repeat(black, 3, 1)], times, times, rough)
    seconds = [e.seconds for e in exposures]
    rows = row_seconds(seconds, [()] * len(times), planes.shape[2])
    response = Response(rough.saturation, *measure_noise(planes, black, rows, rough.clip))
    merged = estimate_rows(planes, black, rows, response, 0, planes.shape[2])
    return merged.rate[0].astype(float), merged.sigma[0].astype(float), exposures


def _channel(band: int) -> str:
    """Colour of the sites that see most of a band."""
    return "B" if band < 490 else "G" if band < 590 else "R"


def _patches(rate: Array, sigma: Array, labels: NDArray[np.uint8], channel: str) -> Array:
    """Mean rate (24,) of each patch; NaN where it is saturated."""
    found = np.full(24, np.nan)
    for k in range(24):
        values, spreads = [], []
        for y, x in SITES[channel]:
            inside = labels[y::2, x::2] == k + 1
            values.append(rate[y::2, x::2][inside])
            spreads.append(sigma[y::2, x::2][inside])
        value, open_ = np.concatenate(values), np.isfinite(np.concatenate(spreads))
        if open_.sum() > LEAST_PIXELS and open_.mean() > 0.95:
            found[k] = value[open_].mean()
    return found


def _field(logs: Array) -> Array:
    """Smooth light field (24,) over the chart, a plane and a bowl, by least squares of the logarithms."""
    x, y = COLUMNS - 2.5, ROWS - 1.5
    basis = np.stack([np.ones(24), x, y, x * x, y * y, x * y], 1)
    use = np.isfinite(logs)
    solution = np.linalg.lstsq(basis[use], logs[use], rcond=None)[0]
    for _ in range(3):
        off = np.abs(logs - basis @ solution)
        kept = use & (off < 3 * np.median(off[use]) + 1e-9)
        solution = np.linalg.lstsq(basis[kept], logs[kept], rcond=None)[0]
    return np.asarray(basis @ solution)


def _spectra(path: Path) -> dict[int, Array]:
    """Reflectance (24,) of the patches at each whole nanometre."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    first = header.index(FIRST_PATCH)
    return {int(float(row[0])): np.array(row[first : first + 24], float) for row in rows}
