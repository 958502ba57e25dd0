"""The description of a camera from its brackets alone, without calibration shots."""

import logging
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding, parse
from kinran.base.files import InputError
from kinran.bracket.black_level import fitted_black, masked_border, site_black
from kinran.bracket.estimator import guarded
from kinran.bracket.exposures import discrepancy, measure, row_seconds, third_stop
from kinran.bracket.noise import measure_noise
from kinran.bracket.response_curve import CODES, Curve, recover
from kinran.bracket.shots import FULL, MISLABELLED, Bracket, check_kind, read_codes
from kinran.bracket.superpixels import mislabelled
from kinran.data.calibration import MARGIN, CalibratedCamera, Exposure, Response
from kinran.data.photographs import CLIPPED, Crop

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

PILED = 2e-4
"""Share of sites at nearly one count that shows that they are full: a choice."""
LEAST_PILED = 100
"""Fewest sites at nearly one count from which saturation is measured: a choice."""
WARNED = 0.02
"""Relative difference of a measured time from its third stop above which the user is warned: a choice."""
LEAST_SITES = 200
"""Fewest pixels, well exposed twice, on which an encoding is tried: a choice."""
MOST_PIXELS, STRIP = 1_000_000, 32
"""Number of pixels on which an encoding is tried, at most about, and rows of a strip of them."""
LEAST_CODE = 8 / 255
"""Least code that an encoding is tried on: lower ones are mostly rounding in 8 bits."""
STEADY_LAMP = 0.04
"""Change of the logarithm of an exposure ratio that lamp and shutter explain: a choice."""
UNSTEADY = 0.05
"""Unsteadiness above which an encoding is not that of the photographs: a choice."""
RECOVERED = "recovered"
"""Name of the encoding without a formula: the response curve that is recovered from the bracket."""


def describe(brackets: Sequence[Bracket]) -> CalibratedCamera:
    """Measure saturation, noise and shutter times of a camera on brackets of still scenes.

    Parameters
    ----------
    brackets
        Brackets with the same exposures.

    Raises
    ------
    InputError
        An exposure is mislabelled, or something has moved.
    """
    first = brackets[0]
    planes = first.planes.shape[1]
    masked = masked_border(brackets)
    stated = tuple((np.zeros(planes) if masked else first.black.mean(0)).tolist())
    blacks = [site_black(bracket, stated, masked) for bracket in brackets]
    saturation = saturation_of(brackets)
    rough = Response(saturation, saturation / 30_000, max(1.0, 1e-4 * saturation))
    nominal = [float(value) for value in first.nominal_s]
    stops, counts = [third_stop(value) for value in nominal], [bracket.planes for bracket in brackets]
    exposures = measure(counts, blacks, nominal, stops, rough)
    if first.bayer and not masked:
        fitted = fitted_black(brackets, blacks, _row_seconds(exposures, first), rough.clip)
        if fitted is not None:
            stated = tuple(fitted.tolist())
            blacks = [site_black(bracket, stated, masked) for bracket in brackets]
            exposures = measure(counts, blacks, nominal, stops, rough)
    for k in range(len(exposures) - 1):
        off = discrepancy(exposures, k)
        if abs(off) > MISLABELLED:
            raise mislabelled(first, blacks[0], k, 1 / (1 + off))
        if abs(off) > WARNED:
            log.warning(
                "%g s is %.3f times what its name says beside %g s; the pictures are believed",
                nominal[k],
                1 + off,
                nominal[k + 1],
            )
    rows = _row_seconds(exposures, first)
    noises = [measure_noise(b.planes, black, rows, rough.clip) for b, black in zip(brackets[:4], blacks, strict=False)]
    gain, read, coding = (float(np.median(part)) for part in zip(*noises, strict=True))
    return CalibratedCamera(stated, masked, Response(saturation, gain, read, coding), exposures, bad=())


def _row_seconds(exposures: Sequence[Exposure], bracket: Bracket) -> Array:
    """Return the true times (exposure, y) of the rows of a bracket."""
    return row_seconds([e.seconds for e in exposures], [e.curtain for e in exposures], bracket.planes.shape[2])


def saturation_of(brackets: Sequence[Bracket]) -> float:
    """Return the saturation in counts over black: where sites pile up, or the file's where none do.

    The file's level is often wrong: files of 12 bits in 16, sensors that are full before the converter is.
    """
    first = brackets[0]
    black = float(first.black.mean())
    full = 1.0 if first.bayer else MARGIN  # a photograph's white is where its codes end, with no spread
    stated = first.white - black
    if not first.bayer and np.count_nonzero(np.bincount(first.planes[0].ravel())) <= CODES:
        return stated / full  # 8 bits end at their last code
    tops, piles = zip(*(_pile(bracket.planes[0]) for bracket in brackets), strict=True)
    measured = [pile - black for pile in piles if pile > max(0.97 * max(tops), 2 * black)]
    return float(min([stated, *measured]) / full)


def _pile(counts: NDArray[np.uint16]) -> tuple[int, int]:
    """Return the highest count but for one site in 100,000, and the count from which sites pile up; 0 if none do."""
    histogram = np.bincount(counts.ravel(), minlength=2)
    from_top = np.cumsum(histogram[::-1])
    top = len(histogram) - 1 - int(np.argmax(from_top > 1e-5 * counts.size))
    near, under = max(int(0.99 * top), 1), int(0.96 * top)
    piled, below = int(histogram[near : top + 1].sum()), histogram[under:near].sum() / 3
    if piled < max(PILED * counts.size, LEAST_PILED) or piled < 5 * below:
        return top, 0
    share = np.cumsum(histogram[near : top + 1]) / piled
    return top, near + int(np.searchsorted(share, 0.2))


def decoder_of(
    name: str, paths: Sequence[Path], seconds: Sequence[float], crop: Crop | None, doubted: bool = False
) -> tuple[str, Encoding | Curve]:
    """Return name and decoder of the encoding of photographs, by its name or from their bracket.

    Parameters
    ----------
    name
        ``srgb``, ``linear``, ``gamma:EXPONENT``, ``recovered`` (response curve of Debevec1997), or empty for the one
        of linear and sRGB under which exposure ratios do not depend on the level, else ``recovered``. Without usable
        pixels it is sRGB for 8 bits, linear for more.
    paths, seconds
        Files and nominal times in seconds of one bracket.
    crop
        Part to use; None for all.
    doubted
        Whether a given name is replaced where the bracket contradicts it.

    Raises
    ------
    InputError
        No encoding makes the bracket consistent, or the frames differ in kind, size or depth.
    """
    check_kind(paths)
    if name not in ("", RECOVERED) and not doubted:
        return name, parse(name)
    order = np.argsort(-np.asarray(seconds), kind="stable")
    codes = _some_codes([paths[k] for k in order], crop)
    eight = _eight_bits(codes, [paths[k] for k in order])
    top = float(codes.max())
    if not eight and top < 0.9 and (codes[0] > 0.999 * top).mean() > PILED:  # 12 bits in 16
        codes = codes / np.float32(top)
    times = np.asarray(seconds, float)[order]
    usual = "srgb" if eight else "linear"
    if len(paths) == 1 or math.isnan(unsteadiness(codes, parse("linear"), times)):
        chosen = usual if name == "" else name
        return (chosen, parse(chosen)) if chosen != RECOVERED else _unknown(paths[0])
    if name != RECOVERED:
        found = {tried: unsteadiness(codes, parse(tried), times) for tried in ([name] if name else ["linear", "srgb"])}
        if name and found[name] >= UNSTEADY:
            found = {tried: unsteadiness(codes, parse(tried), times) for tried in ("linear", "srgb")}
        best = min(found, key=lambda tried: found[tried])
        if found[best] < UNSTEADY:
            return best, parse(best)
    curve = recover(np.round(codes[..., 1].reshape(len(codes), -1) * 255).astype(np.uint8), times)
    if unsteadiness(codes, curve, times) > 2 * UNSTEADY:
        _unknown(paths[0])
    return RECOVERED, curve


def _some_codes(paths: Sequence[Path], crop: Crop | None) -> NDArray[np.float32]:
    """Read the codes (exposure, y, x, 3) of strips of all frames, to save memory."""
    parts: list[NDArray[np.float32]] = []
    shape: tuple[int, ...] = ()
    for path in paths:
        whole = read_codes(path, crop)
        shape = shape or whole.shape
        if whole.shape != shape:
            raise InputError(f"{path}: has another size than the other frames of its bracket; use one size")
        height, width, _ = shape
        strips = MOST_PIXELS // (STRIP * width) + 1
        starts = np.linspace(0, max(height - STRIP, 0), strips).astype(int)
        rows = (starts[:, None] + np.arange(STRIP)).ravel() if strips * STRIP < height else slice(None)
        parts.append(whole[rows])
    return np.stack(parts)


def _eight_bits(codes: NDArray[np.float32], paths: Sequence[Path]) -> bool:
    """Return whether photographs have 8 bits; frames of black and white alone are ignored."""
    telling = [k for k, code in enumerate(codes) if ((code > 0) & (code < 1)).any()]
    eight = [bool(np.allclose(codes[k] * 255, np.round(codes[k] * 255), atol=1e-3)) for k in telling]
    for k, one in zip(telling, eight, strict=True):
        if one != eight[0]:
            raise InputError(
                f"{paths[k]}: has {8 if one else 16} bits but {paths[telling[0]].name} {16 if one else 8}; merge frames"
                " of one depth"
            )
    return all(eight)


def unsteadiness(codes: NDArray[np.float32], decoder: Encoding | Curve, seconds: Array) -> float:
    """Return how much exposure ratios vary with the level of green: the rms of their logarithms' spread.

    A ratio's mean error beyond `STEADY_LAMP` adds to it, since a wrong gamma can keep ratios even.

    Parameters
    ----------
    codes : (exposure, y, x, 3) float32
        Encoded values in [0, 1], longest exposure first.
    decoder
        Encoding or curve that is tried.
    seconds : (exposure,) float
        Nominal times in seconds.

    Returns
    -------
    float
        Unsteadiness; NaN where too few pixels are well exposed twice.
    """
    spread = []
    for k in range(len(codes) - 1):
        longer, shorter = codes[k, ..., 1], codes[k + 1, ..., 1]
        clean = guarded((longer * FULL).astype(np.uint16), 0.97 * CLIPPED * FULL) > 0
        a, b = decoder.decode(longer), decoder.decode(shorter)
        # chosen by the longer one alone: a choice by noisy counts themselves would bias them
        lit = a * np.float32(seconds[k + 1] / seconds[k]) > float(decoder.decode(LEAST_CODE))
        use = clean & lit & (longer > 1.5 * LEAST_CODE)
        if use.sum() < LEAST_SITES:
            continue
        a, b = a[use], b[use]
        parts = np.array_split(np.argsort(a, kind="stable"), 8)
        logs = [np.log(a[part].sum(dtype=float) / max(b[part].sum(dtype=float), 1e-9)) for part in parts]
        off = abs(float(np.mean(logs)) - np.log(seconds[k] / seconds[k + 1]))
        spread.append(float(np.hypot(np.std(logs), max(off - STEADY_LAMP, 0.0))))
    return float(np.sqrt(np.mean(np.square(spread)))) if spread else math.nan


def _unknown(path: Path) -> tuple[str, Encoding | Curve]:
    raise InputError(
        f"{path}: no response makes its bracket consistent; check the times and that nothing moved, or give --encoding"
    )
