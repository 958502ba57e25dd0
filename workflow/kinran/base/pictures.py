"""Pictures for people: maps and radiance as 8-bit images, upright."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from kinran.base.encoding import parse
from kinran.base.files import InputError, atomic

Picture = NDArray[np.uint8]

SRGB = parse("srgb")
LABEL_COLOURS = np.array(
    [[214, 162, 52], [178, 34, 34], [46, 94, 170], [230, 226, 215], [58, 125, 68], [122, 74, 140]], np.uint8
)
"""Colours of regions that do not look apart by their own."""
HEAT = np.array([[0, 0, 0], [60, 15, 110], [180, 40, 90], [250, 130, 20], [255, 240, 150]], float)
"""Colours of `heat` at 0, ¼, ½, ¾ and 1, of growing lightness, so that they read in grey as well."""


def check_png(path: Path) -> None:
    """Check a PNG by the CRC-32 of its parts.

    Raises
    ------
    InputError
        The file is missing, damaged, or no PNG.
    """
    try:
        with Image.open(path, formats=["PNG"]) as image:
            image.verify()
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: is missing, damaged or no PNG ({error}); make it again") from None


def photograph(light: ArrayLike, exposure: float = 1.0) -> Picture:
    """Return linear RGB (y, x, 3), row 0 at the bottom, as an upright sRGB picture."""
    return upright(SRGB.encode(np.nan_to_num(np.asarray(light, np.float32) * np.float32(exposure))) * 255 + 0.5)


def auto_exposure(light: ArrayLike) -> float:
    """Return the factor that brings the 97th percentile of the brightest channel of RGB (..., 3) to 0.8: a choice."""
    level = float(np.percentile(np.nan_to_num(np.asarray(light, np.float32)).max(-1), 97))
    return 0.8 / level if level > 0 else 1.0


def upright(values: ArrayLike) -> Picture:
    """Return values (y, x, ...) in [0, 256), row 0 at the bottom, as 8-bit with the top row first."""
    return np.ascontiguousarray(np.clip(np.asarray(values), 0, 255).astype(np.uint8)[::-1])


def heat(values: ArrayLike, high: float) -> Picture:
    """Return a scalar map (y, x), row 0 at the bottom, in colours from black (0) to pale yellow (`high`)."""
    x = np.clip(np.nan_to_num(np.asarray(values, float)) / max(high, 1e-12), 0, 1) * (len(HEAT) - 1)
    low = np.minimum(x.astype(int), len(HEAT) - 2)
    part = (x - low)[..., None]
    return upright(HEAT[low] * (1 - part) + HEAT[low + 1] * part)


def region_colours(colours: NDArray[np.float64]) -> Picture:
    """Return 8-bit colours (region, 3) for a label map: linear `colours`, or `LABEL_COLOURS` where two look alike."""
    light = np.clip(colours, 0, None)
    own = SRGB.encode(light / np.maximum(light.max(1, keepdims=True), 1e-6) * 0.8) * 255
    apart = np.linalg.norm(own[:, None] - own[None], axis=-1) + 1e3 * np.eye(len(own))
    if apart.min() < 60:
        return LABEL_COLOURS[np.arange(len(own)) % len(LABEL_COLOURS)]
    return own.astype(np.uint8)


def label_map(labels: NDArray[np.integer], colours: Picture) -> Picture:
    """Return a label map (y, x), row 0 at the bottom, as a picture in the colours (region, 3)."""
    return upright(colours[labels])


def directions_map(x: ArrayLike, y: ArrayLike, scale: float = 0.6) -> Picture:
    """Return slopes (y, x) as colours: hue is their direction, saturation their size (full at `scale`)."""
    x, y = np.asarray(x, float) / scale, np.asarray(y, float) / scale
    strength = np.clip(np.hypot(x, y), 0, 1)
    angle = np.arctan2(y, x)
    rgb = np.stack([0.5 + 0.5 * np.cos(angle - k * 2 * np.pi / 3) for k in range(3)], -1)
    return upright(255 * (0.5 + (rgb - 0.5) * strength[..., None]))


def enlarge(picture: Picture, width: int) -> Picture:
    """Enlarge a picture by a whole factor to about `width` pixels, without smoothing."""
    factor = max(1, round(width / picture.shape[1]))
    return picture.repeat(factor, 0).repeat(factor, 1)


def sheet(rows: list[list[tuple[str, Picture]]], gap: int = 8) -> Picture:
    """Return a contact sheet of rows of pictures, with a caption over each and `gap` pixels between them."""
    height = max(p.shape[0] for row in rows for _, p in row)
    width = max(p.shape[1] for row in rows for _, p in row)
    head = 18
    canvas = Image.new(
        "RGB",
        (len(max(rows, key=len)) * (width + gap) + gap, len(rows) * (height + head + gap) + gap),
        (250, 249, 246),
    )
    draw = ImageDraw.Draw(canvas)
    for j, row in enumerate(rows):
        for i, (caption, picture) in enumerate(row):
            x, y = gap + i * (width + gap), gap + j * (height + head + gap)
            draw.text((x, y + 2), caption, fill=(40, 40, 40))
            canvas.paste(Image.fromarray(picture), (x, y + head))
    return np.asarray(canvas)


def write_png(path: Path, picture: Picture) -> None:
    """Write an 8-bit picture, atomically."""
    with atomic(path) as temporary:
        Image.fromarray(picture).save(temporary, "PNG", optimize=True)
