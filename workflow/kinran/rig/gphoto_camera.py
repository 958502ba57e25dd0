"""A camera behind libgphoto2, such as a Canon EOS, on USB or PTP/IP.

libgphoto2 runs in a process of its own (`kinran.rig.gphoto_worker`) with a deadline for each request. When it hangs, or
the camera stays busy, that process is killed, the camera opened anew, and what is on its card decides what was taken.
"""

import fcntl
import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from kinran.rig.camera import CameraError, CardFile, FrameFacts, Health
from kinran.rig.raw_facts import raw_facts

PORT = re.compile(r"usb|usb:\d+,\d+|ptpip:[\w.-]+(:\d+)?")
"""Pattern of a camera's port."""
CHUNK = 4 << 20
"""Bytes of a file that are fetched at once: a second or less on USB 2, so that each request has a short deadline."""
REQUEST_S = 20.0
"""Deadline of a request in seconds: opening a camera takes up to 5 s, the others under 1 s (research with an emulated
EOS, and users' reports of libgphoto2 calls that take 1.2 s)."""
LIST_S = 120.0
"""Deadline of a listing in seconds: size and time of each file on the card are asked for once, thousands at 10 ms."""
BUSY_S = 8.0
"""Seconds for which a busy camera is asked again before it is reset: an EOS writes a frame to a slow card in 3 s."""
LANDS_S = 10.0
"""Seconds after its exposure in which a frame must land on the card."""
END_S = 3.0
"""Seconds that the process has to end by itself."""
USBDEVFS_RESET = 0x5514
"""Linux' request to reset a USB device (linux/usbdevice_fs.h)."""

SENTENCES = {
    -53: "another program holds the camera; end it (often gvfs-gphoto2-volume-monitor, or a file manager)",
    -105: "libgphoto2 does not know this camera; connect another one",
    -52: "the camera is not there; check its cable, and switch it on",
    -60: "the camera cannot be locked; end the program that holds it",
}
"""What to do about errors of libgphoto2, by their numbers (gphoto2-port-result.h, gphoto2-result.h)."""


@dataclass(frozen=True)
class CameraSettings:
    """What the config says of the camera.

    Attributes
    ----------
    port
        ``usb``, ``usb:BUS,DEVICE`` or ``ptpip:HOST:PORT``.
    iso, aperture
        ISO and aperture (f-number) to set; 0 for those that the camera has.
    """

    port: str = "usb"
    iso: float = 0.0
    aperture: float = 0.0


class FailedError(CameraError):
    """A request that failed in a way that opening the camera anew may mend."""


class BusyError(FailedError):
    """The camera stays busy."""


class GphotoCamera:
    """A camera behind libgphoto2 (`kinran.rig.camera.Camera`), opened by its first use.

    Parameters
    ----------
    settings
        Port, ISO and aperture.
    ask
        Function that asks a person to put a subject before the lens, and returns when that is done.
    lands_s, busy_s
        Seconds in which a frame must land, and for which a busy camera is asked again.

    Attributes
    ----------
    iso, aperture
        ISO and aperture that frames must say: what was asked for, else what the camera had when it was opened first.
    restarts
        Times that libgphoto2 was started anew.
    """

    suffix = ".cr2"

    def __init__(
        self,
        settings: CameraSettings,
        ask: Callable[[str], None] = lambda subject: None,
        lands_s: float = LANDS_S,
        busy_s: float = BUSY_S,
    ) -> None:
        if not PORT.fullmatch(settings.port):
            raise CameraError(
                f"rig.camera: '{settings.port}' is no port of a camera; give usb, usb:BUS,DEVICE or ptpip:HOST:PORT"
            )
        self.iso, self.aperture = settings.iso, settings.aperture
        self.restarts = -1
        self._settings = settings
        self._ask = ask
        self._lands_s, self._busy_s = lands_s, busy_s
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Connection | None = None
        self._home: tempfile.TemporaryDirectory[str] | None = None
        self._port = ""
        self._speeds: list[str] = []

    # -- what a capture asks of a camera -------------------------------------------------------------

    def place(self, subject: str) -> None:
        """Ask a person for a subject; see `Camera.place`."""
        self._ask(subject)

    def expose(self, seconds: float) -> None:
        """Take one frame; see `Camera.expose`."""
        self._ready()
        speed = nearest(self._speeds, seconds)
        try:
            self._set("shutterspeed", speed)
            self._request("shoot", seconds + self._lands_s + self._busy_s + REQUEST_S, wait=seconds + self._lands_s)
        except FailedError as error:
            self._end(reset=isinstance(error, BusyError))  # the next request opens the camera, and lists its card anew
            raise

    def card(self) -> list[CardFile]:
        """Return the RAW frames on the card; see `Camera.card`."""
        files = [CardFile(name, size) for name, size in self._again("frames")["files"]]
        if files:
            self.suffix = Path(files[-1].name).suffix.lower()
        return files

    def download(self, name: str, to: Path) -> None:
        """Copy a file from the card; see `Camera.download`."""
        with to.open("wb") as file:
            for part in self._parts(name):
                file.write(part)

    def digest(self, name: str) -> str:
        """Read a file on the card once more; see `Camera.digest`."""
        digest = hashlib.sha256()
        for part in self._parts(name):
            digest.update(part)
        return digest.hexdigest()

    def facts(self, path: Path) -> FrameFacts:
        """Decode a copy of a frame; see `Camera.facts`."""
        return raw_facts(path)

    def delete(self, name: str) -> None:
        """Delete a frame on the card, and its JPEG file; see `Camera.delete`."""
        self._again("delete", name=name)

    def health(self) -> Health:
        """Return battery and free space; see `Camera.health`."""
        said = self._again("health")
        return Health(said["battery"], said["free"])

    def close(self) -> None:
        """Let go of the camera, and end the process of libgphoto2."""
        if self._link is not None and self._process is not None and self._process.poll() is None:
            try:
                self._link.send_bytes(_packed("close", END_S, 0.0, {}))
                self._process.wait(END_S)
            except (OSError, subprocess.TimeoutExpired):
                pass
        self._end()

    # -- requests ------------------------------------------------------------------------------------

    def _parts(self, name: str) -> Iterator[bytes]:
        """Read a file in parts; each is asked for again once where the link fails."""
        offset = 0
        while True:
            size = self._again("read", name=name, offset=offset, size=CHUNK)["of"]
            assert self._link is not None
            part = self._link.recv_bytes()
            yield part
            offset += len(part)
            if len(part) < CHUNK or offset >= size:
                return

    def _set(self, name: str, value: str) -> None:
        """Change a setting and read it back.

        Raises
        ------
        CameraError
            The camera has another value then.
        """
        taken = self._request("set", REQUEST_S + self._busy_s, name=name, value=value)["value"]
        if taken != value:
            raise CameraError(f"the camera has {name} {taken} after it was set to {value}; set its dial to M")

    def _again(self, do: str, **given: Any) -> dict[str, Any]:
        """Ask for something that may be asked twice, the second time with libgphoto2 started anew."""
        seconds = self._busy_s + (LIST_S if do == "frames" else REQUEST_S)
        try:
            self._ready()
            return self._request(do, seconds, **given)
        except FailedError:
            self._end()
        self._ready()
        return self._request(do, seconds, **given)

    def _request(self, do: str, seconds: float, **given: Any) -> dict[str, Any]:
        """Ask the process, which has some seconds to answer.

        Raises
        ------
        FailedError
            libgphoto2 failed, hangs or ended, or the camera stays busy.
        CameraError
            The camera did what it could, and that was not what was asked.
        """
        if self._link is None:
            raise FailedError("the camera is not open; run the capture again")
        try:
            self._link.send_bytes(_packed(do, seconds, self._busy_s, given))
            if not self._link.poll(seconds):
                self._end(reset=True)
                raise FailedError(f"the camera did not answer for {seconds:.0f} s; switch it off and on")
            said: dict[str, Any] = json.loads(self._link.recv_bytes())
        except (EOFError, OSError):
            last = self._last_words()
            self._end(reset=True)
            raise FailedError(f"libgphoto2 ended by itself{last}; switch the camera off and on") from None
        if "error" in said:
            raise _error(said)
        return said

    def _ready(self) -> None:
        """Open the camera and set it up, unless that is done."""
        if self._link is not None:
            return
        self.restarts += 1
        self._start()
        try:
            self._port = self._request("open", REQUEST_S + self._busy_s, port=self._settings.port)["port"]
            self._set_up()
        except CameraError:
            self._end()
            raise

    def _set_up(self) -> None:
        """Set what does not change in a capture: files to the card, as RAW; ISO and aperture; mode M."""
        mode = self._get("autoexposuremode")["value"]
        if mode not in (None, "Manual"):
            raise CameraError(f"the camera is in mode {mode}; turn its dial to M, then run the capture again")
        form = self._get("imageformat")["value"]
        if form is not None and "raw" not in form.lower():
            raise CameraError(
                f"the camera writes no RAW files ({form}); set its image quality to RAW, then run the capture again"
            )
        cards = [each for each in self._get("capturetarget")["choices"] if "card" in each.lower()]
        if cards:
            self._set("capturetarget", cards[0])
        self._speeds = self._get("shutterspeed")["choices"]
        self.iso = self._chosen("iso", self.iso)
        self.aperture = self._chosen("aperture", self.aperture)

    def _chosen(self, name: str, wanted: float) -> float:
        """Set ISO or aperture, and return it; 0 wants what the camera has, and is returned where it does not say."""
        said = self._get(name)
        if wanted:
            fitting = [each for each in said["choices"] if (value := number(each)) and abs(value / wanted - 1) < 0.03]
            if not fitting:
                known = ", ".join(said["choices"]) or "none"
                raise CameraError(f"rig.{name}: {wanted:g} is not among those of this camera and lens ({known})")
            self._set(name, fitting[0])
            return wanted
        if name == "iso" and "auto" in (said["value"] or "").lower():
            raise CameraError("the camera chooses the ISO of each frame; set one on it, or as rig.iso in the config")
        return number(said["value"] or "") or 0.0

    def _get(self, name: str) -> dict[str, Any]:
        return self._request("get", REQUEST_S + self._busy_s, name=name)

    # -- the process ---------------------------------------------------------------------------------

    def _start(self) -> None:
        """Start the process, in a session of its own: Ctrl-C must not end it in the middle of an exposure."""
        if find_spec("gphoto2") is None:
            raise CameraError("Python's package gphoto2 is not installed; run: pip install 'gphoto2>=2.6.4'")
        self._home = tempfile.TemporaryDirectory(prefix="kinran-camera-")  # libgphoto2 writes settings to HOME
        ours, theirs = socket.socketpair()
        with theirs, self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "kinran.rig.gphoto_worker", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                env={**os.environ, "HOME": self._home.name},
            )
        self._link = Connection(ours.detach())

    @property
    def _errors(self) -> Path:
        """File of what the process says on its standard error, where libgphoto2 also says what is no error."""
        assert self._home is not None
        return Path(self._home.name) / "errors"

    def _last_words(self) -> str:
        lines = self._errors.read_text(errors="replace").splitlines() if self._home is not None else []
        return f" ({lines[-1].strip()})" if lines else ""

    def _end(self, reset: bool = False) -> None:
        """End the process, by its id if need be; with `reset`, reset the camera's USB, too."""
        if self._process is not None:
            if self._process.poll() is None:
                os.kill(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._home is not None:
            self._home.cleanup()
            self._home = None
        if reset:
            reset_usb(self._port)


@contextmanager
def open_camera(settings: CameraSettings, ask: Callable[[str], None]) -> Iterator[GphotoCamera]:
    """Give a camera, and close it at the end."""
    camera = GphotoCamera(settings, ask)
    try:
        yield camera
    finally:
        camera.close()


def nearest(speeds: list[str], seconds: float) -> str:
    """Return the camera's name of an exposure time.

    Raises
    ------
    CameraError
        The camera has no such time.
    """
    known = {speed: value for speed in speeds if (value := number(speed))}
    fitting = [speed for speed, value in known.items() if 0.9 < value / seconds < 1.11]
    if not fitting:
        raise CameraError(
            f"the camera has no exposure time of {seconds:g} s; it has {', '.join(known) or 'none: turn its dial to M'}"
        )
    return min(fitting, key=lambda speed: abs(known[speed] / seconds - 1))


def number(text: str) -> float | None:
    """Return the number in a camera's name of a setting, such as ``1/250``, ``f/8`` or ``400``; None if none."""
    try:
        return float(Fraction(text.strip().lower().removeprefix("f/"))) or None
    except (ValueError, ZeroDivisionError):
        return None


def reset_usb(port: str) -> None:
    """Reset a camera on USB as if it were connected anew; what the system does not allow is left out."""
    found = re.fullmatch(r"usb:(\d+),(\d+)", port)
    if not found:
        return
    try:
        with Path(f"/dev/bus/usb/{int(found[1]):03d}/{int(found[2]):03d}").open("wb") as device:
            fcntl.ioctl(device, USBDEVFS_RESET, 0)
    except OSError:
        pass


def _packed(do: str, seconds: float, busy: float, given: dict[str, Any]) -> bytes:
    return json.dumps({"do": do, "seconds": seconds, "busy": busy, "with": given}).encode()


def _error(said: dict[str, Any]) -> CameraError:
    """Return the error of an answer of the process."""
    match said["error"]:
        case "busy":
            return BusyError("the camera stays busy; switch it off and on, then run the capture again")
        case "no file":
            return FailedError("the camera wrote no file in time; look whether it focuses, or its card is full")
        case "no raw":
            return CameraError(f"the camera wrote {said['name']} and no RAW file; set its image quality to RAW")
        case "cameras":
            found = ", ".join(said["found"])
            return CameraError(
                f"several cameras are connected ({found}): name one as rig.camera, such as usb:001,004"
                if len(said["found"]) > 1
                else "no camera is connected; check its cable, and switch it on"
            )
    code = said["code"]
    if code in SENTENCES:
        return CameraError(SENTENCES[code])
    return FailedError(
        f"libgphoto2 failed ({said['text']}, {code}); check the camera's cable, and switch it off and on"
    )
