"""Taking exposures under the open shutter, each until a frame of it lands on the card."""

from collections.abc import Sequence

from kinran.rig.camera import Camera, CameraError, CardFile
from kinran.rig.goniometer import Goniometer, confirm_shutter

TRIES = 2
"""Times that a bracket, or a missed exposure, is taken before the session stops (docs/rig.md, Resume)."""
FRAME_LIMIT_S = 60.0
"""Seconds of open shutter for a frame besides its exposure, after which the rig closes the shutter by itself."""
OWED_S = 10.0
"""Seconds that a frame may be late whose exposure the rig has counted: users of EOS bodies report events that come
1.2 s late (libgphoto2 #151); a choice well above."""


def expose(rig: Goniometer, camera: Camera, exposures: Sequence[float], lit: bool) -> float:
    """Take exposures, under the open shutter if `lit`, and return the seconds for which it was open.

    Whose frame is whose is not decided here.

    Raises
    ------
    RigError
        The rig is disconnected or has a fault, or its shutter closed: the frames may be dark.
    CameraError
        No frame landed.
    """
    opened = 0
    if lit:
        opened = rig.shutter(True, sum(exposures) + FRAME_LIMIT_S * len(exposures)).uptime_ms
    for seconds in exposures:
        _expose_once(rig, camera, seconds)
        confirm_shutter(rig, lit)
    return (rig.shutter(False).uptime_ms - opened) / 1000 if lit else 0.0


def _expose_once(rig: Goniometer, camera: Camera, seconds: float) -> None:
    """Take one exposure, and try again where no frame lands of it."""
    seen = set(camera.card())
    problem = "no frame landed on the card"
    for _ in range(TRIES):
        counted = rig.status().exposures
        try:
            camera.expose(seconds)
        except CameraError as error:
            problem = str(error)
        if _landed(rig, camera, seen, counted):
            return
    raise CameraError(
        f"the camera missed an exposure of {seconds:g} s twice ({problem}); check it, then run the capture again"
    )


def _landed(rig: Goniometer, camera: Camera, seen: set[CardFile], counted: int) -> bool:
    """Return whether a new frame is on the card; it is waited for where the rig has counted its exposure."""
    waited = 0.0
    while all(file in seen for file in camera.card()):
        owed = rig.identity.x_sync and rig.status().exposures > counted
        if not owed or waited >= OWED_S:
            return False
        rig.wait(1.0)
        waited += 1.0
    return True
