"""The shots that a manifest lists, and their frames as counts or as light."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.bracket import DARK_SIGMA, estimate, ratio_sums
from kinran.calibration import Calibration, Camera
from kinran.encoding import parse
from kinran.files import InputError, read_json
from kinran.photographs import parse_crop
from kinran.photographs import read as read_photograph
from kinran.plans import Plan
from kinran.raw import RawFrame, read_raw
from kinran.stack import DARK, HOT, SATURATED

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]

MISLABELLED = 0.10
"""An exposure that is further than this from its calibrated time is another one."""
FLICKER = 0.005
"""How well lamp and shutter repeat from frame to frame, relative."""
BLACK_ERROR = 0.05
"""How well the darkness of a frame is known, in counts."""


@dataclass(frozen=True)
class Frame:
    """A file, and its nominal shutter time (s); 0 for a photograph."""

    path: Path
    nominal_s: float


@dataclass(frozen=True)
class Taken:
    """A shot that was taken; attributes as in the manifest."""

    shot: str
    kind: str
    light: int | None
    time_s: float | None
    photodiode: float | None
    frames: tuple[Frame, ...]


@dataclass(frozen=True)
class Bracket:
    """The RAW frames of a shot, longest exposure first.

    Attributes
    ----------
    planes
        (exposure, 4, y, x) uint16 counts of R, G1, G2, B; row 0 is v = 0.
    black
        (exposure,) counts of darkness, as measured under the mask or as the file says.
    nominal_s
        (exposure,) float.
    """

    shot: Taken
    planes: NDArray[np.uint16]
    black: NDArray[np.float64]
    masked: bool
    nominal_s: NDArray[np.float64]
    white: float


def read_manifest(path: Path, plan: Plan) -> list[Taken]:
    """Shots of a group's manifest, in the order in which they were taken.

    Raises
    ------
    InputError
        It is missing, broken, or belongs to another plan.
    """
    value = read_json(path)
    try:
        if value["plan_sha256"] != plan.sha256:
            raise InputError(f"{path}: belongs to another plan; capture the group again")
        return [
            Taken(
                shot["shot"],
                shot["kind"],
                shot["light"],
                shot.get("time_s"),
                shot.get("photodiode") or None,
                tuple(
                    Frame(path.parent.parent / frame["file"], float(frame["exposure_s"] or 0))
                    for frame in shot["frames"]
                ),
            )
            for shot in value["shots"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is not a manifest ({error!r}); capture the group again") from None


def read_bracket(shot: Taken) -> Bracket:
    """Read the RAW frames of a shot.

    Raises
    ------
    InputError
        A frame cannot be read, has another size or shutter time than it should, or an exposure stands twice.
    """
    ordered = sorted(shot.frames, key=lambda frame: -frame.nominal_s)
    if not ordered:
        raise InputError(f"shot '{shot.shot}' has no frames; capture it again")
    frames: list[RawFrame] = []
    for k, frame in enumerate(ordered):
        raw = read_raw(frame.path)
        if k and frame.nominal_s == ordered[k - 1].nominal_s:
            raise InputError(f"{frame.path}: its exposure {frame.nominal_s:g} s stands twice in shot '{shot.shot}'")
        if raw.seconds and abs(raw.seconds / frame.nominal_s - 1) > MISLABELLED:
            raise InputError(
                f"{frame.path}: EXIF says {raw.seconds:g} s but the manifest {frame.nominal_s:g} s; shoot it again"
            )
        if frames and raw.planes.shape != frames[0].planes.shape:
            raise InputError(f"{frame.path}: its size differs from that of {ordered[0].path.name}; shoot it again")
        frames.append(raw)
    return Bracket(
        shot,
        np.stack([frame.planes for frame in frames]),
        np.array([frame.black for frame in frames]),
        all(frame.masked for frame in frames),
        np.array([frame.nominal_s for frame in ordered]),
        frames[0].white,
    )


def merge_bracket(bracket: Bracket, camera: Camera) -> tuple[Image, Flags]:
    """Merge a bracket to one sample a superpixel: R, the mean of both greens, B.

    Returns
    -------
    rate : (y, x, 3) float32
        Counts a second.
    flags : (y, x, 3) uint8

    Raises
    ------
    InputError
        An exposure is not the one that its name says.
    """
    black = site_black(bracket, camera.black, camera.masked)
    seconds = _shot_seconds(bracket, black, camera)
    merged = [estimate(bracket.planes[:, k], black[:, k], seconds, camera.response) for k in range(4)]
    rate = np.stack([plane for plane, _ in merged])
    sigma = np.stack([plane for _, plane in merged])
    bad = np.zeros(rate.shape, bool)
    bad[tuple(np.array(camera.bad, int).reshape(-1, 3).T)] = True
    saturated = np.isinf(sigma)
    good = ~bad[1:3]
    good[:, ~good.any(0)] = True  # two bad greens: their mean, flagged
    weight = good / good.sum(0)
    with np.errstate(invalid="ignore"):
        green = (weight * rate[1:3]).sum(0)
        green_sigma = np.sqrt(np.where(good, weight * sigma[1:3], 0) ** 2).sum(0)
    values = np.stack([rate[0], green, rate[3]], -1).astype(np.float32)
    spread = np.stack([sigma[0], green_sigma, sigma[3]], -1)
    full = np.stack([saturated[0], (saturated[1:3] & good).any(0), saturated[3]], -1)
    hot = np.stack([bad[0], bad[1:3].all(0), bad[3]], -1)
    flags = full * np.uint8(SATURATED) | (values < DARK_SIGMA * spread) * np.uint8(DARK) * ~full
    return values, (flags | hot * np.uint8(HOT)).astype(np.uint8)


def site_black(bracket: Bracket, black: tuple[float, ...], masked: bool) -> NDArray[np.float64]:
    """(exposure, 4) counts of darkness of each frame and site."""
    if masked and not bracket.masked:
        raise InputError(f"shot '{bracket.shot.shot}': its frames have no masked border, but the dark ones had")
    return np.array(black) + (bracket.black[:, None] if masked else 0.0)


def light_of(bracket: Bracket, black: NDArray[np.float64], exposure: int) -> Image:
    """(2, y, x) counts over black of the green sites of one exposure."""
    return bracket.planes[exposure, 1:3].astype(np.float32) - black[exposure, 1:3, None, None].astype(np.float32)


def _shot_seconds(bracket: Bracket, black: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """(exposure,) times of the frames of this shot, lamp and shutter as they were; their log mean is calibrated.

    The calibrated ratio of two exposures is the prior, what this shot's pictures say the measurement.
    """
    calibrated = np.array([camera.seconds(nominal) for nominal in bracket.nominal_s])
    seconds = calibrated.copy()
    for k in range(len(seconds) - 1):
        longer, shorter = light_of(bracket, black, k), light_of(bracket, black, k + 1)
        top, bottom, sites = ratio_sums(longer, shorter, camera.response.clip)
        shot_noise = max(bottom, 0) * camera.response.gain + sites * camera.response.read**2
        noise = np.hypot(np.sqrt(shot_noise), sites * BLACK_ERROR)
        off = 0.0
        if sites >= 50 and bottom > 30 * noise:
            off = top / bottom / (calibrated[k] / calibrated[k + 1]) - 1
            if abs(off) > MISLABELLED:
                frames = sorted(bracket.shot.frames, key=lambda frame: -frame.nominal_s)
                raise InputError(
                    f"{frames[k + 1].path}: is {1 / (1 + off):.2f} times as bright beside"
                    f" {frames[k].path.name} as their exposures say; they are mislabelled or"
                    " the lamp failed: shoot them again"
                )
            off *= FLICKER**2 / (FLICKER**2 + (noise / bottom) ** 2)
        seconds[k + 1] = seconds[k] * (calibrated[k + 1] / calibrated[k]) / (1 + off)
    return np.asarray(seconds * np.exp(np.mean(np.log(calibrated / seconds))))


def read_light(shot: Taken, calibration: Calibration) -> tuple[Image, Flags]:
    """Linear light (y, x, 3) of a shot that is one photograph, and its flags.

    Raises
    ------
    InputError
        It cannot be read, or its size is not that of the others.
    """
    if len(shot.frames) != 1:
        raise InputError(f"shot '{shot.shot}' has {len(shot.frames)} photographs; one is needed")
    photograph = read_photograph(shot.frames[0].path, parse(calibration.encoding), parse_crop(calibration.crop))
    height, width = photograph.light.shape[:2]
    if (height, width) != (calibration.height, calibration.width):
        raise InputError(
            f"{shot.frames[0].path}: gives {width} × {height} texels but the first photograph of the set"
            f" {calibration.width} × {calibration.height}; all need one size"
        )
    return photograph.light, photograph.saturated * np.uint8(SATURATED)
