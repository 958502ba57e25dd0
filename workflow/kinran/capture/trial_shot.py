"""One frame on trial: does the camera release, does its file come whole, and is it exposed well?"""

from contextlib import AbstractContextManager
from pathlib import Path

from kinran.base.files import InputError, atomic
from kinran.capture.exposing import expose
from kinran.capture.live import STOPS, seen
from kinran.rig.camera import Camera, CameraError
from kinran.rig.goniometer import Goniometer, check_fault
from kinran.rig.protocol import Flag


def trial_shot(devices: AbstractContextManager[tuple[Goniometer, Camera]], seconds: float, folder: Path) -> str:
    """Take a frame where the arm stands, under the open shutter, and copy it from the card.

    Parameters
    ----------
    devices
        Rig and camera; they are closed at the end.
    seconds
        Exposure time.
    folder
        Folder of the copy, which is named as on the card.

    Returns
    -------
    str
        What the frame says of itself, and how it is exposed, in some lines.

    Raises
    ------
    InputError
        The folder cannot be written to, or holds a file of that name.
    CameraError, RigError
        A device failed, or no frame came, or another one than was asked for.
    """
    with devices as (rig, camera):
        check_fault(rig.hello())
        camera.place("fabric")
        dark = "" if rig.state.has(Flag.LAMP) else "; the lamp is off"
        new, _ = expose(rig, camera, [seconds], lit=True)
        if len(new) != 1:
            raise CameraError(f"{len(new)} frames landed on the card instead of one; look at the camera's settings")
        name = new[0].name
        target = folder / Path(name).name
        if target.exists():
            raise InputError(f"{target}: is there already; move it, or give another --to")
        with atomic(target) as temporary:
            camera.download(name, temporary)
            facts = camera.facts(temporary)
        camera.delete(name)
        health = camera.health()
    said = f"{facts.exposure_s:g} s" + (f", ISO {facts.iso:g}" if facts.iso else "")
    said += f", f/{facts.aperture:g}" if facts.aperture else ""
    lines = [f"{target}: {said}, {new[0].bytes / 1e6:.1f} MB{dark}"]
    if frame := seen(folder, target.name, seconds):
        lines.append(f"  {frame.saturated:.2%} saturated; the brightest hundredth of each colour begins")
        for channel, row in zip(("red", "green", "blue"), frame.histogram, strict=True):
            lines.append(f"    {channel:5} {_below(row):.1f} stops below saturation")
    if health.battery or health.free_bytes is not None:
        free = "" if health.free_bytes is None else f", {health.free_bytes / 1e9:.1f} GB free on the card"
        lines.append(f"  battery {health.battery or 'unknown'}{free}")
    return "\n".join(lines)


def _below(row: tuple[float, ...]) -> float:
    """Return the stops below saturation of the brightest hundredth, to the half stop of the histogram."""
    share = 0.0
    for k in reversed(range(len(row))):
        share += row[k]
        if share >= 0.01:
            return STOPS * (len(row) - 1 - k) / len(row)
    return float(STOPS)
