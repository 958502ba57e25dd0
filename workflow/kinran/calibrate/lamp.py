"""The light of the lamp at each shot, from the photodiode and the repeats of θ = 0."""

from pathlib import Path

import numpy as np

from kinran.base.files import InputError
from kinran.bracket.shots import Taken
from kinran.data.calibration import CalibratedCamera
from kinran.data.radiance import HOT, Image, Radiance


def irradiance(position_mm: tuple[float, float, float], height: int, width: int, field_mm: float) -> Image:
    """Return the irradiance (y, x) of a point lamp relative to the middle of the field: inverse square and cosine.

    Parameters
    ----------
    position_mm
        Position of the lamp in millimetres from the field's centre.
    height, width
        Size of the picture in texels.
    field_mm
        Width of the field in millimetres.
    """
    texel = field_mm / width
    x = (np.arange(width) + 0.5 - width / 2) * texel - position_mm[0]
    y = (np.arange(height) + 0.5 - height / 2) * texel - position_mm[1]
    squared = np.square(x) + np.square(y)[:, None] + position_mm[2] ** 2
    return np.asarray((np.square(position_mm).sum() / squared) ** 1.5, np.float32)


def level(picture: Radiance) -> float:
    """Return the level of a picture (y, x, 3): the mean of green without its darkest and brightest tenth.

    This trimmed mean is proportional to the lamp's light, even where some samples are saturated.
    """
    green = np.sort(picture.value[..., 1][~picture.has(HOT)[..., 1]])
    tenth = len(green) // 10
    return float(green[tenth : len(green) - tenth].mean())


def lamp_gains(
    shots: list[Taken], camera: CalibratedCamera, levels: dict[str, float], manifest: Path
) -> dict[str, float]:
    """Return the light of the lamp at each shot, by name, relative to that on the white plate.

    The photodiode gives the changes from shot to shot; the monitors (repeats of θ = 0) scale them to the light on the
    fabric. Without a photodiode, the monitors' level is interpolated over the time of their session; a session without
    monitors has their mean.

    Parameters
    ----------
    shots
        Shots of one group.
    camera
        Camera with the white plate's photodiode and the monitors' level.
    levels
        `level` of the group's monitors, by name of the shot.
    manifest
        Manifest of the group, to name in an error.

    Raises
    ------
    InputError
        A gain is not between 0.5 and 2, or there are neither photodiode readings nor monitors.
    """
    monitors = [shot for shot in shots if shot.shot in levels]
    relative = [levels[shot.shot] / camera.monitor for shot in monitors] if camera.monitor else []
    gains: dict[str, float] = {}
    if camera.photodiode and all(shot.photodiode for shot in shots):
        diode = {shot.shot: float(shot.photodiode or 0) / camera.photodiode for shot in shots}
        ratios = [value / diode[shot.shot] for shot, value in zip(monitors, relative, strict=False)]
        factor = float(np.median(ratios)) if ratios else 1.0
        gains = {shot.shot: diode[shot.shot] * factor for shot in shots}
    elif relative and all(shot.time_s is not None for shot in shots):
        at = dict(zip((shot.shot for shot in monitors), relative, strict=True))
        for session in {shot.session for shot in shots}:
            own = sorted((shot for shot in shots if shot.session == session), key=lambda shot: float(shot.time_s or 0))
            known = [shot for shot in own if shot.shot in at]
            times, light = [float(shot.time_s or 0) for shot in known], [at[shot.shot] for shot in known]
            if not known:  # a capture that went on after its last monitor, or shot some directions again
                times, light = [0.0], [float(np.mean(relative))]
            gains |= {shot.shot: float(np.interp(float(shot.time_s or 0), times, light)) for shot in own}
    elif relative:
        gains = {shot.shot: float(np.mean(relative)) for shot in shots}
    else:
        raise InputError(
            f"{manifest}: has no photodiode readings, and no repeats of θ = 0 that the calibration knows;"
            " calibrate with a manifest that has some"
        )
    gains = {shot.shot: gains[shot.shot] for shot in shots}
    for name, gain in gains.items():
        if not 0.5 <= gain <= 2:
            raise InputError(f"{manifest}: the lamp at shot '{name}' was {gain:.2f} times its light on the white plate")
    return gains
