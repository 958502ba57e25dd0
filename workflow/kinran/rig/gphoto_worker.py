"""libgphoto2 in a process of its own: `python -m kinran.rig.gphoto_worker FD` answers the requests of `GphotoCamera`.

libgphoto2 can hang, crash, or keep a camera busy for ever; a process can be killed and started anew. Requests and
answers are JSON on a socket; the bytes of a file follow their answer.
"""

import json
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import PurePosixPath
from typing import Any, TypeVar

import gphoto2 as gp

T = TypeVar("T")

BACK_OFF_S = 0.1
"""Seconds before a busy camera is asked again at first; doubled each time: a choice, a tenth of a frame's time."""
LOOK_MS = 100
"""Milliseconds that libgphoto2 may wait for an event of the camera: events of EOS bodies are polled for anyway."""
DRAIN_EVENTS = 100
"""Most events that are taken before the card is listed: a bracket makes about ten."""
SIBLING_S = 3.0
"""Seconds for which the RAW file of a JPEG file is waited for: a choice, several times what a card needs for it."""
RAW = (".cr2", ".cr3", ".crw", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".dng")
"""Suffixes of RAW files on a card."""
GRACE_S = 10
"""Seconds after its deadline at which this process ends itself, should nobody else do."""


class RefusalError(Exception):
    """A request that the camera does not carry out; a word for the kind, and what there is to say about it."""

    def __init__(self, kind: str, **said: Any) -> None:
        super().__init__(kind)
        self.answer = {"error": kind, **said}


class Worker:
    """The requests, each a method; libgphoto2's errors pass through."""

    def __init__(self) -> None:
        self._camera: Any = None
        self._widgets: dict[str, Any] = {}
        self._known: dict[tuple[str, str], tuple[int, int]] = {}
        self._until = 0.0
        self._port = ""
        self._whole = b""

    def begin(self, seconds: float) -> None:
        """Set the time that a request has, in which a busy camera is asked again."""
        self._until = time.monotonic() + seconds

    def open(self, port: str) -> dict[str, Any]:
        """Open the camera at a port of libgphoto2, or the only one on USB."""
        self._port = port
        self._widgets.clear()
        model = "PTP/IP Camera"
        if port.count(":") == 2:
            port += ":" + port.rpartition(":")[2]  # libgphoto2 takes the port of events by itself, and else its default
        if not port.startswith("ptpip:"):
            found = [(name, where) for name, where in gp.Camera.autodetect() if where.startswith("usb:")]
            fitting = [each for each in found if port in ("usb", each[1])]
            if len(fitting) != 1:
                raise RefusalError("cameras", found=[f"{name} at {where}" for name, where in found])
            model, port = fitting[0]
        abilities, ports = gp.CameraAbilitiesList(), gp.PortInfoList()
        abilities.load()
        ports.load()
        camera = gp.Camera()
        camera.set_abilities(abilities[abilities.lookup_model(model)])
        camera.set_port_info(ports[ports.lookup_path(port)])
        self._camera = camera
        self._patient(camera.init)
        return {"model": model, "port": port}

    def get(self, name: str) -> dict[str, Any]:
        """Return the value and the choices of a setting, read from the camera; None where it has no such setting."""
        try:
            widget = self._patient(lambda: self._camera.get_single_config(name))
        except gp.GPhoto2Error as error:
            if error.code in (gp.GP_ERROR_BAD_PARAMETERS, gp.GP_ERROR_NOT_SUPPORTED):
                return {"value": None, "choices": []}
            raise
        self._widgets.setdefault(name, widget)
        radio = widget.get_type() in (gp.GP_WIDGET_RADIO, gp.GP_WIDGET_MENU)
        return {"value": str(widget.get_value()), "choices": list(widget.get_choices()) if radio else []}

    def set(self, name: str, value: str) -> dict[str, Any]:
        """Change a setting, and return what the camera has then."""
        if name not in self._widgets:
            self.get(name)
        widget = self._widgets[name]
        widget.set_value(value)
        self._patient(lambda: self._camera.set_single_config(name, widget))
        return self.get(name)

    def shoot(self, wait: float) -> dict[str, Any]:
        """Release the shutter, and wait for its file for some seconds."""
        self._drain()
        self._patient(self._camera.trigger_capture)
        until = time.monotonic() + wait
        name = ""
        while time.monotonic() < until:
            kind, said = self._patient(lambda: self._camera.wait_for_event(LOOK_MS))
            if kind != gp.GP_EVENT_FILE_ADDED:
                continue
            self._known.pop((said.folder, said.name), None)
            name = f"{said.folder}/{said.name}"
            if is_raw(said.name):
                return {"name": name}
            until = min(until, time.monotonic() + SIBLING_S)
        raise RefusalError("no raw" if name else "no file", name=name)

    def frames(self) -> dict[str, Any]:
        """Return the RAW files on the card with their sizes, oldest first by the camera's clock, then its own order."""
        self._drain()
        found: list[tuple[int, int, str, int]] = []
        folders = ["/"]
        while folders:
            folder = folders.pop()
            for name in self._names(self._camera.folder_list_files(folder)):
                if is_raw(name):
                    size, time_ = self._info(folder, name)
                    found.append((time_, len(found), f"{folder.rstrip('/')}/{name}", size))
            inner = self._names(self._camera.folder_list_folders(folder))
            folders += [f"{folder.rstrip('/')}/{name}" for name in reversed(inner)]
        return {"files": [[name, size] for _, _, name, size in sorted(found)]}

    def read(self, name: str, offset: int, size: int) -> tuple[dict[str, Any], bytes]:
        """Return a part of a file, from the card and not from libgphoto2's memory."""
        path = PurePosixPath(name)
        part = bytearray(size)
        try:
            count = self._patient(
                lambda: self._camera.file_read(str(path.parent), path.name, gp.GP_FILE_TYPE_NORMAL, offset, part)
            )
            data = bytes(part[:count])
        except gp.GPhoto2Error as error:
            if error.code != gp.GP_ERROR_NOT_SUPPORTED:
                raise
            if offset == 0:
                self._whole = self._read_whole(path)
            data = self._whole[offset : offset + size]
        return {"bytes": len(data), "of": self._info(str(path.parent), path.name)[0]}, data

    def _read_whole(self, path: PurePosixPath) -> bytes:
        """Read a file of a camera that sends no parts; it is opened anew, because libgphoto2 keeps what it has read."""
        self.close()
        self.open(self._port)
        file = self._patient(
            lambda: self._camera.file_get(str(path.parent), path.name, gp.GP_FILE_TYPE_NORMAL)
        )  # its data lives as long as this name
        return bytes(memoryview(file.get_data_and_size()))

    def delete(self, name: str) -> dict[str, Any]:
        """Delete a RAW file, and the JPEG file that was written with it."""
        path = PurePosixPath(name)
        beside = self._names(self._camera.folder_list_files(str(path.parent)))
        for each in beside:
            if each == path.name or (PurePosixPath(each).stem == path.stem and not is_raw(each)):
                self._patient(lambda each=each: self._camera.file_delete(str(path.parent), each))  # type: ignore[misc]
                self._known.pop((str(path.parent), each), None)
        return {}

    def health(self) -> dict[str, Any]:
        """Return battery and free space."""
        free = [each.freekbytes * 1024 for each in self._patient(self._camera.get_storageinfo)]
        return {"battery": self.get("batterylevel")["value"] or "", "free": sum(free) if free else None}

    def close(self) -> dict[str, Any]:
        """Let go of the camera."""
        with suppress(gp.GPhoto2Error):  # over PTP/IP it always reports one
            if self._camera is not None:
                self._camera.exit()
        return {}

    def _info(self, folder: str, name: str) -> tuple[int, int]:
        """Return size and time of a file; each is asked for once."""
        if (folder, name) not in self._known:
            info = self._patient(lambda: self._camera.file_get_info(folder, name)).file
            self._known[folder, name] = info.size, info.mtime
        return self._known[folder, name]

    def _drain(self) -> None:
        """Take the events that wait: files that they announce are listed from then on."""
        for _ in range(DRAIN_EVENTS):
            kind, said = self._patient(lambda: self._camera.wait_for_event(1))
            if kind == gp.GP_EVENT_TIMEOUT:
                return
            if kind == gp.GP_EVENT_FILE_ADDED:
                self._known.pop((said.folder, said.name), None)

    def _patient(self, call: Callable[[], T]) -> T:
        """Call, and call again while the camera is busy, ever more slowly."""
        pause = BACK_OFF_S
        while True:
            try:
                return call()
            except gp.GPhoto2Error as error:
                if error.code != gp.GP_ERROR_CAMERA_BUSY:
                    raise
                if time.monotonic() + pause > self._until:
                    raise RefusalError("busy") from None
            time.sleep(pause)
            pause *= 2

    @staticmethod
    def _names(listed: Any) -> list[str]:
        return [listed.get_name(k) for k in range(listed.count())]


def is_raw(name: str) -> bool:
    """Return whether a file on the card is a RAW file."""
    return name.lower().endswith(RAW)


def main(descriptor: int) -> None:
    """Answer requests until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    worker = Worker()
    with Connection(descriptor) as link:
        while True:
            try:
                request = json.loads(link.recv_bytes())
            except (EOFError, OSError):
                worker.close()
                return
            worker.begin(request["busy"])
            signal.alarm(int(request["seconds"]) + GRACE_S)  # ends this process where libgphoto2 hangs
            data = b""
            try:
                answer = getattr(worker, request["do"])(**request["with"])
                if isinstance(answer, tuple):
                    answer, data = answer
            except RefusalError as refusal:
                answer = refusal.answer
            except gp.GPhoto2Error as error:
                answer = {"error": "libgphoto2", "code": error.code, "text": error.string}
            signal.alarm(0)
            link.send_bytes(json.dumps(answer).encode())
            if "bytes" in answer:
                link.send_bytes(data)
            if request["do"] == "close":
                return


if __name__ == "__main__":
    main(int(sys.argv[1]))
