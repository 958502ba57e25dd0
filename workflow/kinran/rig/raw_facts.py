"""What a RAW file of a camera says of itself; the whole file is decoded for it."""

from datetime import UTC
from pathlib import Path

from kinran.rig.camera import CameraError, FrameFacts


def raw_facts(path: Path) -> FrameFacts:
    """Decode a RAW file with LibRaw, and return the exposure that its EXIF states.

    Raises
    ------
    CameraError
        The file is no RAW file, cut off, or damaged where LibRaw can see it.
    """
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            if not raw.raw_image.size:
                raise CameraError("it has no picture")
            said = raw.other
    except (rawpy.LibRawError, KeyError) as error:
        reason = error.args[0] if error.args else error
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise CameraError(f"it does not decode ({text})") from None
    taken = said.timestamp.replace(tzinfo=UTC).timestamp() if said.timestamp else 0.0
    return FrameFacts(float(said.shutter_speed), float(said.iso_speed), float(said.aperture), max(taken, 0.0))
