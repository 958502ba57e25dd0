"""RAW frames, as the planes of the sensor's colour filter array."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.data.orientation import OF_LIBRAW, UPRIGHT, shown_size, upright
from kinran.data.sensor_border import read_border

DNG_VERSION = 50706
BLACK_TAGS = BLACK_REPEAT, BLACK_LEVEL, BLACK_DELTA_H, BLACK_DELTA_V, ACTIVE_AREA = 50713, 50714, 50715, 50716, 50829
"""Tags of DNG (1.7, ch. 4)."""
EXIF, MOST_ISO = 34665, 65535
"""Tag of the directory of EXIF, and the ISO that stands for a larger one, which is elsewhere (EXIF 2.32, 4.6.5)."""
CUT_OFF = {"Input/output": "it is cut off", "Unsupported": "it is cut off, or of no camera that LibRaw knows"}
"""What LibRaw's errors on a RAW file mean: those whose directory is at their end, such as CRW, have none if cut off."""
APART = 1 / 64
"""Share of the range by which the black level of a DNG's tags may differ from LibRaw's: a choice. LibRaw's are whole
numbers, and one for all rows; more than that, and one of both has read the file wrongly."""
REC709_TO_XYZ = np.array(
    [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]]
)
"""Linear Rec. 709 to CIE XYZ under D65 (ITU-R BT.709)."""


@dataclass(frozen=True)
class RawFrame:
    """One RAW frame.

    Attributes
    ----------
    planes
        (4, y, x) uint16 counts of the sites R, G1 (in R's rows), G2 (in B's rows) and B; row 0 is v = 0.
    black : (4,) float
        Black level of R, G1, G2, B in counts, as the file states it: a DNG's to a fraction, else LibRaw's.
    mask : (4,) float or None
        Mean of each kind of site in counts under the border of the sensor, which may not be masked; None without one.
    drift : (4, y) float or None
        What the level under the border differs by in each row; None without one, and of planes whose rows were columns.
    white
        Saturation level in counts of the file, which is often wrong.
    seconds
        Nominal shutter time of EXIF in seconds; 0 if it is missing.
    iso, aperture
        ISO and aperture (f-number) of EXIF; 0 if they are missing.
    orientation
        How the picture is shown, as in EXIF. The planes lie as the sensor does, unless they are turned `upright`.
    """

    planes: NDArray[np.uint16]
    black: NDArray[np.float64]
    mask: NDArray[np.float64] | None
    drift: NDArray[np.float64] | None
    white: float
    seconds: float
    iso: float = 0.0
    aperture: float = 0.0
    orientation: int = UPRIGHT

    def upright(self) -> "RawFrame":
        """Return the frame with planes that lie as the picture is shown."""

        def shown(planes: NDArray[Any]) -> NDArray[Any]:
            top_first = planes[:, ::-1].transpose(1, 2, 0)
            return np.ascontiguousarray(upright(top_first, self.orientation)[::-1].transpose(2, 0, 1))

        drift = None if self.drift is None else shown(self.drift[..., None])
        drift = drift[..., 0] if drift is not None and drift.shape[2] == 1 else None
        return replace(self, planes=shown(self.planes), drift=drift, orientation=UPRIGHT)


def raw_size(path: Path) -> tuple[int, int]:
    """Return width and height of the planes of a RAW file as it is shown, from its header.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with _opened(path, header=True) as raw:
        _, _, height, width = _window(raw.sizes)
        return shown_size(width // 2, height // 2, OF_LIBRAW[raw.sizes.flip & 7])


def raw_orientation(path: Path) -> int:
    """Return how a RAW file is shown, as in EXIF, from its header.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with _opened(path, header=True) as raw:
        return OF_LIBRAW[raw.sizes.flip & 7]


def raw_exposure(path: Path) -> tuple[float, float, float]:
    """Return shutter time in seconds, ISO and aperture of a RAW file; 0 for what is missing.

    They come from its EXIF where it is a kind of TIFF, as most are. LibRaw knows them of all files, but rawpy decodes a
    file before it tells.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    seconds, iso, aperture = _exif_exposure(path)
    if seconds and iso:
        return seconds, iso, aperture
    with _opened(path, header=True) as raw:
        return float(raw.other.shutter_speed), float(raw.other.iso_speed), float(raw.other.aperture)


def camera_matrix(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the daylight white and the colour matrix that a RAW file states for its camera.

    Returns
    -------
    white : (3,) float
        R, G, B of daylight (D65), relative to G.
    to_rec709 : (3, 3) float
        Matrix from R, G, B relative to `white` to linear Rec. 709; the identity where the file states none.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with _opened(path, header=True) as raw:
        from_xyz = np.array(raw.rgb_xyz_matrix[:3], float)
    if not from_xyz.any():
        return np.ones(3), np.eye(3)
    camera = from_xyz @ REC709_TO_XYZ
    white = camera.sum(1)
    return white / white[1], np.linalg.inv(camera / white[:, None])


def read_raw(path: Path) -> RawFrame:
    """Read a Bayer RAW file, neither demosaiced nor scaled, cut to the picture that the camera's maker shows.

    Raises
    ------
    InputError
        The file is missing, cut off, or not of a Bayer sensor.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; put it back or take it off the list")
    with _opened(path) as raw:
        if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
            raise InputError(f"{path}: is not of a Bayer sensor; give RAW frames of one")
        sizes, full = raw.sizes, raw.raw_image
        top, left, height, width = _window(sizes)
        sites = _sites(raw, top, left)
        planes = np.empty((4, height // 2, width // 2), np.uint16)
        for plane, (row, column) in enumerate(sites):
            planes[plane] = full[top + row : top + height : 2, left + column : left + width : 2][::-1]
        kinds = [((top + row) % 2, (left + column) % 2) for row, column in sites]
        border = read_border(full, (sizes.top_margin, sizes.left_margin), (top, height), kinds)
        return RawFrame(
            planes,
            _stated_black(path, raw, (top, left), sites),
            border.levels if border else None,
            np.stack([border.drift[row::2][::-1] for row, _ in sites]) if border else None,
            float(raw.white_level),
            raw.other.shutter_speed,
            raw.other.iso_speed,
            raw.other.aperture,
            OF_LIBRAW[sizes.flip & 7],
        )


def _window(sizes: Any) -> tuple[int, int, int, int]:
    """Return top, left, height and width, both even, of the picture on the sensor: the maker's crop, if it states one.

    Without one it is all that LibRaw takes for lit. The crop begins at a whole cell of the colour filter array.
    """
    top, left, height, width = sizes.top_margin, sizes.left_margin, sizes.height, sizes.width
    if sizes.crop_width and sizes.crop_height:
        down, right = sizes.crop_top_margin - top, sizes.crop_left_margin - left
        if 0 <= down <= height - sizes.crop_height and 0 <= right <= width - sizes.crop_width:
            inner_top, inner_left = top + down + down % 2, left + right + right % 2
            height, width = sizes.crop_height - down % 2, sizes.crop_width - right % 2
            top, left = inner_top, inner_left
    return top, left, height // 2 * 2, width // 2 * 2


def _sites(raw: Any, top: int, left: int) -> list[tuple[int, int]]:
    """Return row and column in a cell of the sites R, G1 (in R's rows), G2 (in B's rows) and B, from a corner of cells.

    Raises
    ------
    InputError
        The four sites are not R, two G and B.
    """
    names = raw.color_desc.decode()
    cell = [[names[raw.raw_color(top + row, left + column)] for column in (0, 1)] for row in (0, 1)]
    found = {}
    for row, colours in enumerate(cell):
        for column, name in enumerate(colours):
            found["G1" if name == "G" and "R" in colours else "G2" if name == "G" else name] = (row, column)
    return [found[name] for name in ("R", "G1", "G2", "B")]


def _stated_black(
    path: Path, raw: Any, corner: tuple[int, int], sites: Sequence[tuple[int, int]]
) -> NDArray[np.float64]:
    """Return the black level of each kind of site that the file states: a DNG's own, which LibRaw rounds down.

    Raises
    ------
    InputError
        They are far from each other.
    """
    levels = raw.black_level_per_channel
    whole = np.array([levels[raw.raw_color(corner[0] + row, corner[1] + column)] for row, column in sites], float)
    exact = dng_black(path, corner, sites)
    if exact is None:
        return whole
    if np.abs(exact - whole).max() > APART * (raw.white_level - whole.mean()):
        raise InputError(
            f"{path}: its tags state black levels of {np.round(exact, 1).tolist()} counts, but LibRaw reads"
            f" {whole.tolist()}; convert it to DNG again, or give the camera's own files"
        )
    return exact


def dng_black(path: Path, corner: tuple[int, int], sites: Sequence[tuple[int, int]]) -> NDArray[np.float64] | None:
    """Return the black levels that a DNG states, with their fractions and means over its rows and columns.

    Parameters
    ----------
    path
        A RAW file of any kind.
    corner
        Row and column on the sensor of a corner of its colour filter array's cells.
    sites
        Row and column in a cell of each kind of site.

    Returns
    -------
    (site,) float or None
        BlackLevel, repeated from the corner of ActiveArea, and the means of BlackLevelDeltaV and BlackLevelDeltaH over
        rows and columns of each kind (DNG 1.7, ch. 4); None where the file is no DNG, or its black repeats otherwise
        than its colours.
    """
    tags = _dng_tags(path)
    rows, columns = (int(part) for part in np.broadcast_to(tags.get(BLACK_REPEAT, 1), 2))
    if BLACK_LEVEL not in tags or tags[BLACK_LEVEL].size != rows * columns or not {rows, columns} <= {1, 2}:
        return None
    levels = tags[BLACK_LEVEL].reshape(rows, columns)
    top, left = tags.get(ACTIVE_AREA, np.zeros(4))[:2].astype(int)
    found = []
    for row, column in sites:
        down, right = corner[0] + row - top, corner[1] + column - left
        deltas = [
            tags[tag][parity::2].mean()
            for tag, parity in ((BLACK_DELTA_V, down % 2), (BLACK_DELTA_H, right % 2))
            if tag in tags
        ]
        found.append(levels[down % rows, right % columns] + sum(deltas))
    return np.array(found)


def _dng_tags(path: Path) -> dict[int, NDArray[np.float64]]:
    """Return the numbers of a DNG's tags on its black level, fractions divided; none where the file is no DNG."""
    try:
        with tifffile.TiffFile(path) as file:
            if DNG_VERSION not in file.pages[0].tags:
                return {}
            pages = [page for first in file.pages for page in (first, *(first.pages or ()))]
            tags: Any = next((page.tags for page in pages if BLACK_LEVEL in page.tags), {})
            return {number: _numbers(tags[number]) for number in BLACK_TAGS if number in tags}
    except (OSError, ValueError, tifffile.TiffFileError):
        return {}


def _exif_exposure(path: Path) -> tuple[float, float, float]:
    """Return shutter time, ISO and aperture of the EXIF of a kind of TIFF; 0 for what it does not say."""
    try:
        with tifffile.TiffFile(path) as file:
            tags = file.pages[0].tags
            said = {**{tag.name: tag.value for tag in tags.values()}, **(tags.valueof(EXIF) or {})}
    except (OSError, ValueError, TypeError, KeyError, IndexError, tifffile.TiffFileError):
        return 0.0, 0.0, 0.0
    sensitivity: Any = said.get("ISOSpeedRatings", said.get("PhotographicSensitivity"))
    iso = _number(np.ravel(sensitivity)[:1])  # some say it twice, and two numbers are a fraction
    return _number(said.get("ExposureTime")), iso if iso < MOST_ISO else 0.0, _number(said.get("FNumber"))


def _number(value: Any) -> float:
    """Return a number of EXIF, a fraction divided, or the first of several; 0 for what is none."""
    try:
        return float(value[0] / value[1] if isinstance(value, tuple) and len(value) == 2 else np.ravel(value)[0])
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return 0.0


def _numbers(tag: Any) -> NDArray[np.float64]:
    """Return the values of a TIFF tag, which may be numerators and denominators in turn."""
    values = np.atleast_1d(np.array(tag.value, float))
    rational = tag.dtype in (tifffile.DATATYPE.RATIONAL, tifffile.DATATYPE.SRATIONAL)
    return values[::2] / np.maximum(values[1::2], 1) if rational else values


@contextmanager
def _opened(path: Path, header: bool = False) -> Iterator[Any]:
    """Open a file with LibRaw, whose errors become `InputError`s that name the file; its header alone if asked."""
    import rawpy

    try:
        with rawpy.RawPy() as raw:
            raw.open_file(str(path))
            if not header:
                raw.unpack()
            yield raw
    except (rawpy.LibRawError, KeyError) as error:
        message = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        said = next((words for part, words in CUT_OFF.items() if part in str(message)), message)
        raise InputError(f"{path}: cannot be read as RAW ({said}); copy it from the camera again") from None
