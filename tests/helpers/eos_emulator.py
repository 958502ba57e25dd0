"""A Canon EOS on PTP/IP, so that the real libgphoto2 takes, lists, reads and deletes real RAW files; with faults.

As a script it is a camera of its own that outlives its hosts: `python eos_emulator.py` prints the port of the camera
and that of its control, on which lines of JSON change attributes of `Eos` and call `Eos.told`.
"""

import itertools
import json
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from kinran.virtual.dng import Tags, write_dng

OK, BUSY, NO_OBJECT, UNSUPPORTED = 0x2001, 0x2019, 0x2009, 0x2005
"""Response codes of PTP."""
STORE, FOLDER = 0x00020001, 0x90000000
"""Ids of the card and of its folder."""
CR2, JPEG = 0xB103, 0x3801
"""Formats of files."""
SPEED, ISO, APERTURE, TARGET, QUALITY, BATTERY, MODE = 0xD102, 0xD103, 0xD101, 0xD11C, 0xD120, 0xD111, 0xD105
"""Properties of an EOS."""
SPEEDS = {
    0x38: "1", 0x5D: "1/25", 0x60: "1/30", 0x68: "1/60", 0x6D: "1/100", 0x70: "1/125", 0x78: "1/250", 0x80: "1/500",
    0x88: "1/1000", 0x90: "1/2000", 0x98: "1/4000",
}  # fmt: skip
ISOS = {0x48: 100, 0x50: 200, 0x58: 400}
APERTURES = {0x30: Fraction(28, 5), 0x38: Fraction(8)}
QUALITIES = {"raw": [(6, 0, 4)], "raw+jpeg": [(6, 0, 4), (1, 0, 3)], "jpeg": [(1, 0, 3)]}
OPERATIONS = [
    0x1001, 0x1002, 0x1003, 0x1004, 0x1005, 0x1006, 0x1007, 0x1008, 0x1009, 0x100B, 0x101B, 0x9101, 0x9102, 0x910F,
    0x9110, 0x9114, 0x9115, 0x9116, 0x9117, 0x9127, 0x9128, 0x9129,
]  # fmt: skip
MARK = b"KINRAN"
"""What stands before the JSON at the end of a frame that says under which light it was taken."""

Answer = tuple[int, tuple[int, ...], bytes | None]


@dataclass
class Taken:
    """A file on the card."""

    name: str
    data: bytes
    format: int
    when: str


@dataclass
class Eos:
    """A camera. Lists of faults have one word an exposure, or a reading of a file, which takes it off.

    Attributes
    ----------
    scene
        What stands before the lens, as the test says; each frame says it on.
    exposures
        ``miss``: no file. ``late N``: its file lands after N more exposures. ``wrong``: another shutter time.
        ``twice``: its file is announced twice. ``foreign``: somebody releases the shutter once more.
    readings
        ``cut``: half of the file comes. ``flip``: a byte of it changes. ``drop``: the link is cut in its middle.
    busy
        Requests to release that are answered with busy; -1 for all.
    partial
        Whether parts of files can be read.
    shape
        Rows and columns of a frame.
    hang
        Code of an operation that is never answered, the next time.
    """

    scene: Any = None
    exposures: list[str] = field(default_factory=list)
    readings: list[str] = field(default_factory=list)
    busy: int = 0
    hang: int = 0
    quality: str = "raw"
    battery: int = 2
    mode: int = 3
    number: int = 0
    partial: bool = True
    shape: tuple[int, int] = (40, 40)
    fired: int = 0
    files: dict[int, Taken] = field(default_factory=dict)
    properties: dict[int, int] = field(default_factory=lambda: {SPEED: 0x6D, ISO: 0x48, APERTURE: 0x30, TARGET: 2})

    def __post_init__(self) -> None:
        self._events: list[bytes] = []
        self._late: list[tuple[int, int, Taken]] = []
        self._handles = itertools.count(1)
        self._clock = datetime(2026, 1, 1)
        self._folder = Path(tempfile.mkdtemp(prefix="kinran-eos-"))
        self._frame(0x6D)  # the first one takes its time
        self.readings_done = 0

    # -- the camera ----------------------------------------------------------------------------------

    def shoot(self) -> None:
        """Take one exposure."""
        fault = self.exposures.pop(0) if self.exposures else ""
        self._clock += timedelta(seconds=2)
        if fault == "miss":
            return
        if fault == "foreign":
            self._land(self._expose(self.properties[SPEED]))
        speed = 0x80 if fault == "wrong" else self.properties[SPEED]
        late = int(fault.split()[1]) if fault.startswith("late") else 0
        handles = self._expose(speed)
        if late:
            self._late.append((self.fired + late, *handles[0]))
        else:
            self._land(handles)
            if fault == "twice":
                self._announce(*handles[0])
        for due in [each for each in self._late if each[0] <= self.fired and not late]:
            self._late.remove(due)
            self._land([due[1:]])

    def _expose(self, speed: int) -> list[tuple[int, Taken]]:
        self.fired += 1
        self.number = self.number % 9999 + 1
        formats = {"raw": [CR2], "raw+jpeg": [CR2, JPEG], "jpeg": [JPEG]}[self.quality]
        made = []
        for form in formats:
            suffix = "CR2" if form == CR2 else "JPG"
            data = self._frame(speed) if form == CR2 else b"\xff\xd8 a small picture \xff\xd9"
            taken = Taken(f"IMG_{self.number:04d}.{suffix}", data, form, self._clock.strftime("%Y%m%dT%H%M%S"))
            made.append((next(self._handles), taken))
        return made

    def _land(self, files: list[tuple[int, Taken]]) -> None:
        for handle, taken in files:
            self.files[handle] = taken
            self._announce(handle, taken)

    def _frame(self, speed: int) -> bytes:
        """A RAW file that says how, when and of what it was taken."""
        path = self._folder / "frame.dng"
        counts = np.random.default_rng(self.fired).integers(256, 4096, self.shape, np.uint16)
        seconds = Fraction(SPEEDS[speed])
        tags = Tags(
            seconds, 8, 256, 4095, self._clock.strftime("%Y:%m:%d %H:%M:%S"), iso=ISOS[self.properties[ISO]],
            aperture=APERTURES[self.properties[APERTURE]],
        )  # fmt: skip
        write_dng(path, counts, tags)
        said = {"number": self.fired - 1, "exposure": float(seconds), "scene": self.scene}
        return path.read_bytes() + MARK + json.dumps(said).encode()

    # -- what the host sees --------------------------------------------------------------------------

    def operation(self, code: int, given: tuple[int, ...], data: bytes) -> Answer:
        """Carry out one operation of PTP."""
        if code == 0x9128 and given and given[0] & 2:  # released, fully pressed
            if self.busy:
                self.busy -= self.busy > 0
                return BUSY, (), None
            self.shoot()
            return OK, (0,), None
        if code in (0x1009, 0x101B, 0x1008) and given[0] not in self.files and given[0] != FOLDER:
            return NO_OBJECT, (), None
        match code:
            case 0x1001:
                return OK, (), self._identity()
            case 0x1002 | 0x1003 | 0x9115 | 0x9117 | 0x9127:
                return OK, (), None
            case 0x9114:
                self._tell_properties()
                return OK, (), None
            case 0x9116:
                events = b"".join(self._events) + struct.pack("<II", 8, 0)
                self._events.clear()
                return OK, (), events
            case 0x9110:
                _, name, value = struct.unpack_from("<III", data)
                self.properties[name] = value
                self._events.append(struct.pack("<IIII", 16, 0xC189, name, value))
                return OK, (), None
            case 0x9128 | 0x9129:
                return OK, (0,), None
            case 0x1004 | 0x9101:
                return OK, (), _longs(STORE)
            case 0x1005 | 0x9102:
                text = _text("CF") + _text("EOS_DIGITAL")
                return OK, (), struct.pack("<HHHQQI", 3, 2, 0, 32 << 30, 16 << 30, 1000) + text
            case 0x1006:
                return OK, (len(self.files),), None
            case 0x1007:
                parent = given[2] if len(given) > 2 else 0
                inner = sorted(self.files)
                every = {0xFFFFFFFF: [FOLDER], FOLDER: inner}.get(parent, [FOLDER, *inner])
                return OK, (), _longs(*every)
            case 0x1008:
                return OK, (), self._information(given[0])
            case 0x1009:
                return OK, (), self._read(given[0])
            case 0x101B if self.partial:
                part = self._read(given[0])[given[1] : given[1] + given[2]]
                return OK, (len(part),), part
            case 0x100B:
                self.files.pop(given[0], None)
                return OK, (), None
        return UNSUPPORTED, (), None

    def _read(self, handle: int) -> bytes:
        data = self.files[handle].data
        self.readings_done += 1
        fault = self.readings.pop(0) if self.readings else ""
        if fault == "drop":
            raise ConnectionAbortedError
        if fault == "cut":
            return data[: len(data) // 2]
        return data[:1500] + bytes([data[1500] ^ 1]) + data[1501:] if fault == "flip" else data

    def _identity(self) -> bytes:
        operations = [code for code in OPERATIONS if self.partial or code != 0x101B]
        return (
            struct.pack("<HIH", 100, 0xB, 100) + _text("") + struct.pack("<H", 0) + _shorts(*operations) + 3 * _shorts()
            + _shorts(JPEG, CR2) + _text("Canon Inc.") + _text("Canon EOS Kiss Digital X") + _text("1") + _text("012")
        )  # fmt: skip

    def _tell_properties(self) -> None:
        values = {**self.properties, BATTERY: self.battery, MODE: self.mode}
        for name, value in values.items():
            self._events.append(struct.pack("<IIII", 16, 0xC189, name, value))
        choices: dict[int, list[int]] = {
            SPEED: list(SPEEDS),
            ISO: list(ISOS),
            APERTURE: list(APERTURES),
            TARGET: [2, 4],
        }
        for name, known in choices.items():
            listed = struct.pack(f"<{len(known)}I", *known)
            self._events.append(struct.pack("<IIIII", 20 + len(listed), 0xC18A, name, 3, len(known)) + listed)
        formats = QUALITIES[self.quality]
        said = struct.pack("<I", len(formats)) + b"".join(struct.pack("<IIII", 16, *each) for each in formats)
        self._events.append(struct.pack("<III", 12 + len(said), 0xC189, QUALITY) + said)

    def _announce(self, handle: int, taken: Taken) -> None:
        head = struct.pack("<IIIHHIIIII", 0xC181, handle, STORE, taken.format, 0, 0, 0, len(taken.data), FOLDER, handle)
        body = head + taken.name.encode() + b"\0"
        body += b"\0" * (-len(body) % 4)
        self._events.append(struct.pack("<I", len(body) + 4) + body)

    def _information(self, handle: int) -> bytes:
        layout = "<IHHIHIIIIIIIHII"
        if handle == FOLDER:
            return struct.pack(layout, STORE, 0x3001, *[0] * 10, 1, 0, 0) + _text("DCIM") + 3 * _text("")
        taken = self.files[handle]
        numbers = (STORE, taken.format, 0, len(taken.data), 0, 0, 0, 0, 40, 40, 24, FOLDER, 0, 0, 0)
        return struct.pack(layout, *numbers) + _text(taken.name) + 2 * _text(taken.when) + _text("")

    # -- what the test sees --------------------------------------------------------------------------

    def told(self, changes: dict[str, Any]) -> dict[str, Any]:
        """Change attributes, and return what the camera has done."""
        for name, value in changes.items():
            if name == "release":
                self.shoot()
            else:
                setattr(self, name, value)
        return {
            "fired": self.fired,
            "card": [each.name for each in self.files.values()],
            "readings": self.readings_done,
        }


def _text(text: str) -> bytes:
    return bytes([len(text) + 1]) + (text + "\0").encode("utf-16-le") if text else b"\0"


def _shorts(*values: int) -> bytes:
    return struct.pack(f"<I{len(values)}H", len(values), *values)


def _longs(*values: int) -> bytes:
    return struct.pack(f"<I{len(values)}I", len(values), *values)


def serve(camera: Eos) -> int:
    """Serve a camera on a free port of 127.0.0.1, in threads."""
    listener = socket.create_server(("127.0.0.1", 0))

    def accept() -> None:
        while True:
            link, _ = listener.accept()
            threading.Thread(target=answer, args=(camera, link), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return int(listener.getsockname()[1])


def answer(camera: Eos, link: socket.socket) -> None:
    """Answer the packets of one connection of PTP/IP until it is closed."""
    stream = link.makefile("rwb", buffering=0)

    def receive() -> tuple[int, bytes]:
        head = _exactly(stream, 8)
        length, kind = struct.unpack("<II", head)
        return kind, _exactly(stream, length - 8)

    def send(kind: int, body: bytes) -> None:
        link.sendall(struct.pack("<II", len(body) + 8, kind) + body)

    with suppress(OSError, EOFError), link:
        while True:
            kind, body = receive()
            if kind == 1:
                send(2, struct.pack("<I", 1) + b"\1" * 16 + "EOS\0".encode("utf-16-le") + struct.pack("<I", 0x10000))
            elif kind == 3:
                send(4, b"")
            elif kind == 13:
                send(14, b"")
            elif kind == 6:
                phase, code, number = struct.unpack_from("<IHI", body)
                given = struct.unpack(f"<{(len(body) - 10) // 4}I", body[10:])
                data = b""
                while phase == 2:
                    kind, part = receive()
                    data += part[4:] if kind in (10, 12) else b""
                    if kind == 12:
                        break
                if camera.hang == code:
                    camera.hang = 0
                    time.sleep(3600)
                said, results, out = camera.operation(code, given, data)
                if out is not None:
                    send(9, struct.pack("<IQ", number, len(out)))
                    send(12, struct.pack("<I", number) + out)
                send(7, struct.pack("<HI", said, number) + struct.pack(f"<{len(results)}I", *results))


def _exactly(stream: Any, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = stream.read(count - len(data))
        if not part:
            raise EOFError
        data += part
    return data


class Control:
    """The test's end of an emulator's control."""

    def __init__(self, camera_port: int, control_port: int) -> None:
        self.port = f"ptpip:127.0.0.1:{camera_port}"
        self.control = control_port
        self._link = socket.create_connection(("127.0.0.1", control_port))
        self._stream = self._link.makefile("rw")

    def close(self) -> None:
        self._stream.close()
        self._link.close()

    def tell(self, **changes: Any) -> dict[str, Any]:
        """Change attributes of the camera; return what it has done."""
        self._stream.write(json.dumps(changes) + "\n")
        self._stream.flush()
        said: dict[str, Any] = json.loads(self._stream.readline())
        return said


@contextmanager
def emulator(**first: Any) -> Iterator[Control]:
    """Run a camera in a process of its own."""
    with subprocess.Popen([sys.executable, __file__], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            camera, control = map(int, process.stdout.readline().split())
            with closing(Control(camera, control)) as link:
                link.tell(**first)
                yield link
        finally:
            process.kill()


def seen(path: Path) -> dict[str, Any]:
    """What a frame says of its light."""
    said: dict[str, Any] = json.loads(path.read_bytes().rpartition(MARK)[2])
    return said


def main() -> None:
    """Serve a camera and its control."""
    camera = Eos()
    listener = socket.create_server(("127.0.0.1", 0))
    print(serve(camera), listener.getsockname()[1], flush=True)
    while True:
        link, _ = listener.accept()
        threading.Thread(target=control, args=(camera, link), daemon=True).start()


def control(camera: Eos, link: socket.socket) -> None:
    """Carry out the lines of one connection."""
    with suppress(OSError), link.makefile("rw") as stream:
        for line in stream:
            stream.write(json.dumps(camera.told(json.loads(line))) + "\n")
            stream.flush()


if __name__ == "__main__":
    main()
