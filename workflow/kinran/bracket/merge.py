"""Merge one bracket to linear radiance: RAW, TIFF, PNG or JPEG frames to one EXR with its noise.

Channels R G B, sigma.R sigma.G sigma.B (standard deviation; infinite where every exposure is saturated) and flags
(1 saturated, 2 dark, 4 hot, 8 shifted). RAW is merged before any demosaic, one pixel for four sites, in counts per
second of the camera's R, G, B; photographs in white per second, linear Rec. 709. Nominal times come from --times, EXIF
or the name (…_25ms, …_1-250s); times of a camera's dial stand for third stops. True ratios come from the pictures.
"""

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from kinran.base.encoding import parse
from kinran.base.exr import write_exr
from kinran.base.files import InputError
from kinran.bracket.exposures import parse_times
from kinran.bracket.response_curve import CODES, Curve, merge_debevec
from kinran.bracket.shots import FULL, Bracket, Frame, Taken, read_bracket
from kinran.bracket.superpixels import merge_sites
from kinran.bracket.uncalibrated import RECOVERED, decoder_of, describe
from kinran.data.calibration import CalibratedCamera
from kinran.data.nominal_time import nominal_seconds
from kinran.data.orientation import upright
from kinran.data.picture_kind import READ, is_raw, kind_of
from kinran.data.radiance import DARK, SATURATED, Image, Radiance

log = logging.getLogger(__name__)

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities (x, y) of Rec. 709: R, G, B and white."""


@dataclass(frozen=True)
class Inputs:
    frames: Annotated[tuple[Path, ...], "FRAME", "frames of the bracket, in any order"]


@dataclass(frozen=True)
class Options:
    times: Annotated[str, "--times 1/25,1/100,…", "exposure time of each frame, in this order"] = ""
    encoding: Annotated[
        str, "of photographs: srgb, linear, gamma:EXPONENT or recovered; without it, as the bracket tells"
    ] = ""
    method: Annotated[
        Literal["kinran", "debevec"], "kinran, or a baseline for photographs: Debevec and Malik 1997, without σ"
    ] = "kinran"


def main(
    inputs: Inputs, out: Annotated[Path, "--out X.exr", "radiance with σ and flags"], options: Options = Options()
) -> None:
    """Write the radiance."""
    if out.suffix.lower() != ".exr":
        raise InputError(f"{out}: give a name that ends in .exr")
    frames = timed(inputs.frames, options.times)
    if options.method == "debevec":
        write_exr(out, *debevec(frames, options.encoding or RECOVERED))
        return
    bracket, encoding = read(frames, options.encoding)
    camera = describe([bracket])
    merged = merge_sites(bracket, camera)
    bracket = replace(bracket, planes=bracket.planes[:0].copy())  # room for the copies that writing makes
    write(out, merged, bracket, camera, encoding)
    log.info(summary(merged, camera, encoding))


def timed(paths: Sequence[Path], times: str) -> list[Frame]:
    """Return frames with their nominal times, from `times`, EXIF or the names.

    Raises
    ------
    InputError
        A file is missing, given twice or of another kind, or its time is unknown.
    """
    for k, path in enumerate(paths):
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if kind_of(path) not in READ:
            raise InputError(f"{path}: is no RAW, TIFF, PNG or JPEG file; give frames of these kinds")
        if path.resolve() in {other.resolve() for other in paths[:k]}:
            raise InputError(f"{path}: is given twice; give each frame once")
    given = parse_times(times) if times else []
    if given and len(given) != len(paths):
        raise InputError(f"--times {times}: has {len(given)} times for {len(paths)} frames; give one for each")
    seconds = given or [nominal_seconds(path) for path in paths]
    if missing := [path for path, value in zip(paths, seconds, strict=True) if not value]:
        if len(paths) > 1:
            raise InputError(f"{missing[0]}: has no exposure time in its EXIF or name; give --times 1/25,1/100,…")
        seconds = [1.0]
    return [Frame(path, value) for path, value in zip(paths, seconds, strict=True)]


def read(frames: Sequence[Frame], encoding: str) -> tuple[Bracket, str]:
    """Read a bracket, and the encoding of its photographs; empty for RAW.

    Raises
    ------
    InputError
        An encoding is given for RAW, or the frames cannot be read as a bracket.
    """
    shot = Taken("bracket", "light", 0, None, None, tuple(frames))
    if any(is_raw(frame.path) for frame in frames):
        if encoding:
            raise InputError(f"--encoding {encoding}: is for photographs, but {frames[0].path} is RAW; leave it out")
        return read_bracket(shot), ""
    if encoding not in ("", "recovered"):
        parse(encoding)
    paths, seconds = [frame.path for frame in frames], [frame.nominal_s for frame in frames]
    name, decoder = decoder_of(encoding, paths, seconds, None)
    return read_bracket(shot, decoder), name


def debevec(frames: Sequence[Frame], encoding: str) -> tuple[dict[str, Image], dict[str, object]]:
    """Return channels (R G B in white per second, flags) and header of the baseline of Debevec and Malik (Debevec1997).

    The encoding ``recovered`` is their own: the response curve of the bracket. Where no exposure has a weight (codes 0
    and 255 have none) the value is NaN, flagged as saturated or dark.

    Raises
    ------
    InputError
        A frame is RAW or cannot be read.
    """
    for frame in frames:
        if is_raw(frame.path):
            raise InputError(f"{frame.path}: is RAW, but --method debevec is for photographs; leave it out")
    ordered = sorted(frames, key=lambda frame: -frame.nominal_s)
    seconds = np.array([frame.nominal_s for frame in ordered])
    name, decoder = decoder_of(encoding, [frame.path for frame in ordered], seconds.tolist(), None)
    bracket = read_bracket(Taken("bracket", "light", 0, None, None, tuple(frames)), parse("linear"))
    codes = np.round(bracket.planes / (FULL / (CODES - 1))).astype(np.uint8)
    curve = decoder if isinstance(decoder, Curve) else Curve(tuple(decoder.decode(np.arange(CODES) / (CODES - 1))))
    value = merge_debevec(codes, seconds, curve)[:, ::-1]
    flags = np.where(np.isnan(value), np.where(codes[-1, :, ::-1] > CODES // 2, SATURATED, DARK), 0)
    channels = {channel: np.ascontiguousarray(value[k]) for k, channel in enumerate("RGB")}
    channels["flags"] = np.bitwise_or.reduce(flags, axis=0).astype(np.float32)
    header: dict[str, object] = {
        "kinran:unit": "white per second",
        "kinran:colour": f"linear Rec. 709 ({name} photographs)",
        "kinran:method": "Debevec and Malik 1997",
        "chromaticities": REC709,
    }
    return channels, header


def write(path: Path, merged: Radiance, bracket: Bracket, camera: CalibratedCamera, encoding: str) -> None:
    """Write the EXR, upright and top row first."""
    unit = FULL if encoding else 1
    if merged.sigma is None:
        raise ValueError("the radiance has no σ")
    value, sigma, flags = (upright(p[::-1], bracket.orientation) for p in (merged.value, merged.sigma, merged.flags))
    channels = {name: np.asarray(value[..., k] / unit, np.float32) for k, name in enumerate("RGB")}
    channels |= {f"sigma.{name}": np.asarray(sigma[..., k] / unit, np.float32) for k, name in enumerate("RGB")}
    channels["flags"] = np.bitwise_or.reduce(flags, axis=-1).astype(np.float32)
    longest = camera.exposures[0]
    levels = np.array(camera.black) + (bracket.mask if camera.masked else np.zeros((len(bracket.nominal_s), 1)))
    header: dict[str, object] = {
        "expTime": float(longest.seconds),
        "kinran:unit": "white per second" if encoding else "counts over black per second",
        "kinran:colour": f"linear Rec. 709 ({encoding} photographs)" if encoding else "camera RGB, not balanced",
        "kinran:flags": "1 saturated, 2 dark, 4 hot, 8 shifted",
        "kinran:frames": json.dumps([frame.path.name for frame in bracket.frames], ensure_ascii=False),
        "kinran:exposures": json.dumps([exposure.seconds for exposure in camera.exposures]),
        "kinran:noise": json.dumps(
            {
                "counts_per_electron": camera.response.gain,
                "read_counts": camera.response.read,
                "relative_coding": camera.response.coding,
                "saturation_counts": camera.response.saturation,
                "black_counts": levels.round(3).tolist(),
            }
        ),
    }
    if encoding:
        header["chromaticities"] = REC709
    write_exr(path, channels, header)


def summary(merged: Radiance, camera: CalibratedCamera, encoding: str) -> str:
    """Return a summary of a merged bracket in a few lines."""
    height, width, _ = merged.value.shape
    full = float(merged.texels_with(SATURATED).mean())
    lines = [f"{width} × {height} pixels" + (f", {encoding} photographs" if encoding else ", RAW"), ""]
    for k, e in enumerate(camera.exposures):
        how = f"from {e.sites} sites" if e.sites else "the longest" if k == 0 else "no site tells: as its name says"
        lines.append(f"  {e.nominal_s:<9.6g} s is {e.seconds:.6g} s ({how})")
    r = camera.response
    lines += [
        "",
        f"saturation {r.saturation:.0f} counts, {r.gain:.4g} counts an electron, read noise {r.read:.2f} counts",
    ]
    return "\n".join([*lines, f"saturated at every exposure: {full:.2%} of the picture"])
