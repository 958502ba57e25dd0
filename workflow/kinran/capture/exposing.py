"""Taking exposures under the open shutter, each until a frame of it lands on the card."""

from collections.abc import Sequence

from kinran.rig.camera import Camera, CameraError, CardFile
from kinran.rig.goniometer import Goniometer, confirm_shutter

TRIES = 2
"""Times that a bracket, or a missed exposure, is taken before the session stops (docs/capture.md, Resume)."""
FRAME_LIMIT_S = 60.0
"""Seconds of open shutter for a frame besides its exposure, after which the rig closes the shutter by itself."""
OWED_S = 10.0
"""Seconds that a frame may be late whose exposure the rig has counted: users of EOS bodies report events that come
1.2 s late (libgphoto2 #151); a choice well above."""


def expose(rig: Goniometer, camera: Camera, exposures: Sequence[float], lit: bool) -> tuple[list[CardFile], float]:
    """Take exposures, under the open shutter if `lit`.

    Returns
    -------
    landed : list of CardFile
        The frames that are new on the card. Whose frame is whose is not decided here.
    open_s : float
        Seconds for which the shutter was open.

    Raises
    ------
    RigError
        The rig is disconnected or has a fault, or its shutter closed: the frames may be dark.
    CameraError
        No frame landed.
    """
    opened = 0
    before = card = camera.card()
    if lit:
        opened = rig.shutter(True, sum(exposures) + FRAME_LIMIT_S * len(exposures)).uptime_ms
    for seconds in exposures:
        card = _expose_once(rig, camera, seconds, card)
        confirm_shutter(rig, lit)
    seconds = (rig.shutter(False).uptime_ms - opened) / 1000 if lit else 0.0
    return [file for file in card if file not in before], seconds


def _expose_once(rig: Goniometer, camera: Camera, seconds: float, seen: list[CardFile]) -> list[CardFile]:
    """Take one exposure, try again where no frame lands of it, and return what is on the card then."""
    problem = "no frame landed on the card"
    for _ in range(TRIES):
        counted = rig.status().exposures
        try:
            camera.expose(seconds)
        except CameraError as error:
            problem = str(error)
        card = _landed(rig, camera, seen, counted)
        if any(file not in seen for file in card):
            return card
    raise CameraError(
        f"the camera missed an exposure of {seconds:g} s twice ({problem}); check it, then run the capture again"
    )


def _landed(rig: Goniometer, camera: Camera, seen: list[CardFile], counted: int) -> list[CardFile]:
    """Return what is on the card; a new frame is waited for where the rig has counted its exposure."""
    waited, card = 0.0, camera.card()
    while waited < OWED_S and all(file in seen for file in card):
        if not rig.identity.x_sync or rig.status().exposures <= counted:
            break
        rig.wait(1.0)
        waited += 1.0
        card = camera.card()
    return card
