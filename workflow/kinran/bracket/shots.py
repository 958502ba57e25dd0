"""The shots of a manifest, and their frames as brackets of counts."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding, parse
from kinran.base.files import InputError, read_json, sha256
from kinran.bracket.response_curve import Curve
from kinran.data.calibration import Calibration
from kinran.data.capture_plan import Plan
from kinran.data.orientation import UPRIGHT
from kinran.data.photographs import CLIPPED, Crop, parse_crop
from kinran.data.photographs import read as read_photograph
from kinran.data.picture_kind import is_raw, kind_of
from kinran.data.radiance import Image, Radiance
from kinran.data.raw import RawFrame, read_raw

MISLABELLED = 0.10
"""Relative difference from its calibrated time above which an exposure is mislabelled: a third stop is 26 %."""
FULL = 65535
"""Counts of a photograph's white."""
APERTURE = 0.02
"""Largest relative difference of ISO or aperture within a bracket: rounding in EXIF explains it."""
STRIP = 64
"""Rows of a photograph that are decoded at a time, to save memory."""


@dataclass(frozen=True)
class Frame:
    """A file of a bracket.

    Attributes
    ----------
    path
        The file.
    nominal_s
        Nominal shutter time in seconds; 0 for a single photograph.
    sha256
        Digest that its bytes must have; empty where no manifest names one.
    remedy
        What to do if it has another.
    """

    path: Path
    nominal_s: float
    sha256: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class Taken:
    """A shot that was taken; attributes are those of the manifest, whose times compare within a session alone."""

    shot: str
    kind: str
    light: int | None
    time_s: float | None
    photodiode: float | None
    frames: tuple[Frame, ...]
    session: int = 0


@dataclass(frozen=True)
class Bracket:
    """The frames of a shot, longest exposure first.

    Attributes
    ----------
    shot
        The shot.
    planes : (exposure, plane, y, x) uint16
        Counts of R, G1, G2, B of RAW frames, or of R, G, B of photographs; row 0 is v = 0.
    black : (exposure, plane) float
        Black levels in counts that the files state.
    mask : (exposure, plane) float or None
        Levels in counts under the border of the sensor: the mean of all sites in each frame, and what each kind differs
        by in the mean of all frames, as it does not change; None where a frame has no border.
    drift : (exposure, plane, y) float or None
        What the level under the border differs by in each row of each frame; None where frames have no border, or were
        turned by a quarter.
    nominal_s : (exposure,) float
        Nominal shutter times in seconds.
    white
        Saturation level in counts that the file states.
    orientation
        How the picture is shown, as in EXIF; RAW frames of a set are turned upright already.
    frames
        Frames in the order of the planes.
    """

    shot: Taken
    planes: NDArray[np.uint16]
    black: NDArray[np.float64]
    mask: NDArray[np.float64] | None
    drift: NDArray[np.float64] | None
    nominal_s: NDArray[np.float64]
    white: float
    orientation: int = UPRIGHT
    frames: tuple[Frame, ...] = field(default=())

    @property
    def bayer(self) -> bool:
        """Whether the planes are the sites of a Bayer sensor."""
        return bool(self.planes.shape[1] == 4)


def read_manifest(path: Path, plan: Plan) -> list[Taken]:
    """Read the shots of a group's manifest, in its order.

    Raises
    ------
    InputError
        The manifest is missing, broken, or belongs to another plan.
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
                    Frame(
                        path.parent.parent / frame["file"],
                        float(frame["exposure_s"] or 0),
                        frame.get("sha256", ""),
                        _remedy(path, plan),
                    )
                    for frame in shot["frames"]
                ),
                shot.get("session") or 0,
            )
            for shot in value["shots"]
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: is not a manifest ({error!r}); capture the group again") from None


def _remedy(manifest: Path, plan: Plan) -> str:
    """Return what to do about a frame whose bytes are not those in a manifest."""
    again = f"`snakemake --force captures/{plan.fabric}/groups/{manifest.name}`"
    if plan.kind == "grid":
        return f"run `kinran rig repair {plan.fabric}`, then shoot it again: {again}"
    return f"put the photograph back, or take it in as it is now: {again}"


def check_digest(frame: Frame) -> Path:
    """Return the path of a frame whose bytes are those that its manifest names.

    Raises
    ------
    InputError
        The file is missing, cannot be read, or has other bytes.
    """
    if frame.sha256:
        try:
            found = sha256(frame.path)
        except FileNotFoundError:
            raise InputError(f"{frame.path}: no such file; {frame.remedy}") from None
        except OSError as error:
            raise InputError(f"{frame.path}: cannot be read ({error.strerror}); {frame.remedy}") from None
        if found != frame.sha256:
            raise InputError(f"{frame.path}: has other bytes than when it was taken (SHA-256); {frame.remedy}")
    return frame.path


def read_bracket(shot: Taken, decoder: Encoding | Curve | None = None, crop: Crop | None = None) -> Bracket:
    """Read the frames of a shot: RAW, or photographs that `decoder` makes linear.

    With a decoder, they are of a set of photographs: RAW frames are turned upright and cut, too. Those of the rig,
    and of a bracket alone, stay as the sensor lies.

    Raises
    ------
    InputError
        A frame cannot be read, has other bytes than its manifest says, or differs from the others in size, kind, ISO or
        aperture; or it has another shutter time in EXIF than in the manifest, or an exposure stands twice.
    """
    ordered = sorted(shot.frames, key=lambda frame: -frame.nominal_s)
    if not ordered:
        raise InputError(f"shot '{shot.shot}' has no frames; capture it again")
    for frame, before in zip(ordered[1:], ordered, strict=False):
        if frame.nominal_s == before.nominal_s:
            raise InputError(f"{frame.path}: its exposure {frame.nominal_s:g} s stands twice in shot '{shot.shot}'")
    check_kind([frame.path for frame in ordered])
    if not is_raw(ordered[0].path):
        return _photographs(shot, ordered, decoder or parse("srgb"), crop)
    frames: list[RawFrame] = []
    planes = np.empty((0,), np.uint16)
    for k, frame in enumerate(ordered):
        raw = read_raw(check_digest(frame))
        if decoder is not None:  # of a set, whose lights are in the picture as it is shown
            raw = _cut(raw.upright(), crop, frame.path)
        if raw.seconds and abs(raw.seconds / frame.nominal_s - 1) > MISLABELLED:
            raise InputError(
                f"{frame.path}: EXIF says {raw.seconds:g} s, not {frame.nominal_s:g} s; correct it or shoot again"
            )
        if k == 0:
            planes = np.empty((len(ordered), *raw.planes.shape), np.uint16)
        _same(frame.path, raw, ordered[0].path, frames[0] if frames else raw, planes.shape[1:])
        planes[k] = raw.planes
        frames.append(replace(raw, planes=planes[k]))
    return Bracket(
        shot,
        planes,
        np.array([frame.black for frame in frames]),
        _under_mask([frame.mask for frame in frames]),
        _drift([frame.drift for frame in frames]),
        np.array([frame.nominal_s for frame in ordered]),
        frames[0].white,
        frames[0].orientation,
        tuple(ordered),
    )


def _under_mask(masks: Sequence[NDArray[np.float64] | None]) -> NDArray[np.float64] | None:
    found = [mask for mask in masks if mask is not None]
    if len(found) < len(masks):
        return None
    levels = np.array(found)
    common = levels.mean(1, keepdims=True)
    return np.asarray(common + (levels - common).mean(0))


def _drift(drifts: Sequence[NDArray[np.float64] | None]) -> NDArray[np.float64] | None:
    found = [drift for drift in drifts if drift is not None]
    return np.array(found) if len(found) == len(drifts) else None


def _cut(raw: RawFrame, crop: Crop | None, path: Path) -> RawFrame:
    """Return a part of a RAW frame; the crop is in superpixels."""
    if crop is None:
        return raw
    height, width = raw.planes.shape[1:]
    if crop.x + crop.width > width or crop.y + crop.height > height:
        raise InputError(
            f"{path}: is {width}x{height} superpixels, too small for the crop {crop}; choose a smaller one"
        )
    rows = slice(height - crop.y - crop.height, height - crop.y)
    drift = None if raw.drift is None else raw.drift[:, rows]
    return replace(raw, planes=raw.planes[:, rows, crop.x : crop.x + crop.width], drift=drift)


def _same(path: Path, raw: RawFrame, first_path: Path, first: RawFrame, shape: tuple[int, ...]) -> None:
    if raw.planes.shape != shape:
        raise InputError(f"{path}: its size differs from that of {first_path.name}; shoot it again")
    for what, value, other in (("ISO", raw.iso, first.iso), ("aperture", raw.aperture, first.aperture)):
        if value and other and abs(value / other - 1) > APERTURE:
            raise InputError(
                f"{path}: has {what} {value:g} but {first_path.name} {other:g}; only the shutter time may change"
            )
    if raw.white != first.white:
        raise InputError(
            f"{path}: saturates at {raw.white:g} counts but {first_path.name} at {first.white:g}; they are of"
            " different bit depths: shoot them alike"
        )


def _photographs(shot: Taken, ordered: list[Frame], decoder: Encoding | Curve, crop: Crop | None) -> Bracket:
    """Read a bracket of photographs as counts of linear light, `FULL` for white."""
    planes = np.empty((0,), np.uint16)
    for k, frame in enumerate(ordered):
        codes = read_codes(check_digest(frame), crop)
        if k == 0:
            planes = np.empty((len(ordered), 3, *codes.shape[:2]), np.uint16)
        if codes.shape[:2] != planes.shape[2:]:
            raise InputError(f"{frame.path}: its size differs from that of {ordered[0].path.name}; use one size")
        for first in range(0, len(codes), STRIP):
            rows = slice(first, first + STRIP)
            light = np.clip(decoder.decode(codes[rows]), 0, 1)
            planes[k][:, rows] = (light * FULL + 0.5).astype(np.uint16).transpose(2, 0, 1)
    white = float(decoder.decode(np.float32(CLIPPED)))
    return Bracket(
        shot,
        planes,
        np.zeros((len(ordered), 3)),
        None,
        None,
        np.array([frame.nominal_s for frame in ordered]),
        white * FULL,
        frames=tuple(ordered),
    )


def read_codes(path: Path, crop: Crop | None) -> Image:
    """Read the encoded values (y, x, 3) of a photograph, 1 for white.

    Raises
    ------
    InputError
        The file cannot be read, is an EXR, or has values that are not finite or over white.
    """
    if kind_of(path) == "EXR":
        raise InputError(f"{path}: is linear radiance already; give the photographs that it is made of")
    codes = read_photograph(path, parse("linear"), crop).value
    if not np.isfinite(codes).all():
        raise InputError(f"{path}: has values that are no numbers; write it again")
    if codes.max() > 1.001:
        raise InputError(f"{path}: has values up to {codes.max():.4g}, but white is 1; scale all frames alike")
    return codes


def check_kind(paths: Sequence[Path]) -> None:
    """Check that the frames of a bracket are files of one kind.

    Raises
    ------
    InputError
        A frame is of another kind than the first.
    """
    kinds = [kind_of(path) for path in paths]
    for path, kind in zip(paths, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(f"{path}: is no file of the kind of {paths[0].name}; merge one kind at a time")


def light_of(bracket: Bracket, black: NDArray[np.float64], exposure: int) -> Image:
    """Return the counts over black (2, y, x) of the green sites of one exposure; `black` is that of `site_black`."""
    return bracket.planes[exposure, 1:3].astype(np.float32) - black[exposure, 1:3, :, None].astype(np.float32)


def read_shot(shot: Taken, calibration: Calibration) -> Bracket:
    """Read the frames of a shot with encoding and crop of its calibration; errors as in `read_bracket`."""
    decoder: Encoding | Curve | None = None
    if calibration.encoding:
        decoder = Curve(calibration.curve) if calibration.curve else parse(calibration.encoding)
    return read_bracket(shot, decoder, parse_crop(calibration.crop))


def read_light(shot: Taken, calibration: Calibration) -> Radiance:
    """Read the linear light (y, x, 3) of a shot that is one photograph.

    Raises
    ------
    InputError
        The photograph cannot be read, has other bytes than in its manifest, or another size than the first of the set.
    """
    if len(shot.frames) != 1:
        raise InputError(f"shot '{shot.shot}' has {len(shot.frames)} photographs; one is needed")
    photograph = read_photograph(
        check_digest(shot.frames[0]), parse(calibration.encoding), parse_crop(calibration.crop)
    )
    height, width = photograph.value.shape[:2]
    if (height, width) != (calibration.height, calibration.width):
        raise InputError(
            f"{shot.frames[0].path}: gives {width} × {height} texels but the first photograph of the set"
            f" {calibration.width} × {calibration.height}; all need one size"
        )
    return photograph
