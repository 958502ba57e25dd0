"""A bench for captures: a fake camera, and a rig and camera in another process than the host.

Run as a script it is the host: it captures through a socket and kills itself at a given step.
"""

import hashlib
import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.connection import Client, Connection, Listener
from pathlib import Path
from typing import Any

from kinran.capture.capture import Devices, capture
from kinran.data.capture_plan import Plan, read_plan
from kinran.rig.camera import Camera, CameraError, CardFile, FrameFacts, Health
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import mdeg
from kinran.rig.simulation import PacedCamera, simulated_goniometer
from kinran.rig.transport import SimulatedHid

EXPOSURES = (0.04, 0.004, 0.0005)
DEVICE = {"device": "fake"}


def small_plan() -> Plan:
    """Eight lights, eight monitors, three exposures."""
    from kinran.capture.grid import plan_grid  # it imports numpy, which the host need not

    return plan_grid("silk", [0, 30], 8, EXPOSURES, meridians=8)


class FakeCamera:
    """A camera whose files say what it saw; like a real one it outlives its host and counts on."""

    suffix = ".raw"
    iso = 100.0
    aperture = 8.0

    def __init__(self, firmware: Firmware, card: Path) -> None:
        self.firmware = firmware
        self.folder = card
        self.subject = ""
        self.fired: list[str] = []
        self.order: list[str] = []
        self.misbehave: list[str] = []
        card.mkdir(parents=True, exist_ok=True)

    def place(self, subject: str) -> None:
        self.subject = subject

    def expose(self, seconds: float) -> None:
        fault = self.misbehave.pop(0) if self.misbehave else ""
        if fault == "miss":
            return
        if fault == "error":
            raise CameraError("the battery is empty; charge it")
        for _ in range(2 if fault == "surplus" else 1):
            name = f"IMG_{len(self.fired) + 1:05d}{self.suffix}"
            seen = {
                "number": len(self.fired),
                "subject": self.subject,
                "exposure": seconds,
                "pose": self.firmware.pose[:2],
                "light": self.firmware.lamp_output if self.firmware.shutter_open else 0,
                "taken": self.firmware.clock,
            }
            self.fired.append(name)
            data = b"" if fault == "empty" else json.dumps(seen).encode().ljust(400)
            self.land(name, data)

    def land(self, name: str, data: bytes) -> None:
        """Put a file on the card, as the newest."""
        (self.folder / name).write_bytes(data)
        self.order.append(name)

    def card(self) -> list[CardFile]:
        names = {path.name for path in self.folder.iterdir()}
        known = [name for name in self.order if name in names]
        return [CardFile(name, (self.folder / name).stat().st_size) for name in [*sorted(names - set(known)), *known]]

    def download(self, name: str, to: Path) -> None:
        shutil.copyfile(self.folder / name, to)

    def digest(self, name: str) -> str:
        return hashlib.sha256((self.folder / name).read_bytes()).hexdigest()

    @staticmethod
    def facts(path: Path) -> FrameFacts:
        data = path.read_bytes()
        if len(data) != 400:
            raise CameraError("it is cut off")
        seen = json.loads(data)
        return FrameFacts(seen["exposure"], seen.get("iso", 100.0), 8.0, seen["taken"])

    def health(self) -> Health:
        return Health("75%", 10**9)

    def delete(self, name: str) -> None:
        (self.folder / name).unlink()


class Bench:
    """A rig and a camera that live on while hosts come and go."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.firmware = Firmware()
        self.camera = FakeCamera(self.firmware, root / "card")

    @contextmanager
    def devices(self) -> Iterator[tuple[Goniometer, Camera]]:
        rig = simulated_goniometer(self.firmware)
        try:
            yield rig, PacedCamera(self.camera, self.firmware, rig)
        finally:
            rig.close()

    def capture(self, plan: Plan, group: str = "00", **other: Any) -> dict[str, Any]:
        arguments: dict[str, Any] = {
            "devices": self.devices, "device": DEVICE, "revisions": {}
        }  # fmt: skip
        return capture(plan, group, self.root, **{**arguments, **other})


def check(root: Path, plan: Plan, manifest: dict[str, Any]) -> list[int]:
    """Check that each frame is whole and under its own direction and exposure; numbers of the exposures."""
    shots = {shot.shot: shot for group in plan.groups for shot in group.shots}
    numbers = []
    for entry in manifest["shots"]:
        shot = shots[entry["shot"]]
        for frame, exposure in zip(entry["frames"], plan.exposures_s, strict=True):
            data = (root / frame["file"]).read_bytes()
            seen = json.loads(data)
            assert len(data) == frame["bytes"]
            assert seen["exposure"] == frame["exposure_s"] == exposure
            assert abs(seen["pose"][0] - mdeg(shot.theta)) <= 20
            assert abs(seen["pose"][1] - mdeg(shot.phi)) <= 20
            assert bool(seen["light"]) == (shot.kind != "dark")
            numbers.append(seen["number"])
    return numbers


def serve(bench: Bench, listener: Listener, hosts: int) -> None:
    """Serve one host after the other; five seconds pass after the death of each."""
    handle = SimulatedHid(bench.firmware)

    def expose(seconds: float) -> None:
        bench.camera.expose(seconds)
        bench.firmware.sync()
        bench.firmware.advance(0.1)

    calls: dict[str, Callable[..., Any]] = {
        "write": handle.write,
        "read": handle.read,
        "send_feature_report": handle.send_feature_report,
        "get_feature_report": handle.get_feature_report,
        "hello": lambda: None,
        "place": bench.camera.place,
        "expose": expose,
        "card": bench.camera.card,
        "download": bench.camera.download,
        "digest": bench.camera.digest,
        "delete": bench.camera.delete,
    }
    for _ in range(hosts):
        with listener.accept() as connection:
            try:
                while True:
                    name, args = connection.recv()
                    connection.send((calls[name](*args), bench.firmware.clock))
            except (EOFError, ConnectionError):
                bench.firmware.advance(5)


@contextmanager
def serving(bench: Bench, address: str, hosts: int) -> Iterator[None]:
    """Serve in a thread."""
    with Listener(address, "AF_UNIX") as listener:
        thread = threading.Thread(target=serve, args=(bench, listener, hosts), daemon=True)
        thread.start()
        yield
        thread.join(timeout=60)
        assert not thread.is_alive()


class Remote:
    """The host's end: a handle and a camera at once, each call a step at which it may be killed."""

    suffix = FakeCamera.suffix
    iso = FakeCamera.iso
    aperture = FakeCamera.aperture

    def __init__(self, connection: Connection, step: Callable[[], None]) -> None:
        self._connection = connection
        self._step = step
        self._clock = 0.0
        self._call("hello")

    def _call(self, name: str, *args: Any) -> Any:
        self._connection.send((name, args))
        answer, self._clock = self._connection.recv()
        return answer

    def write(self, data: bytes) -> int:
        return int(self._call("write", data))

    def read(self, max_length: int, timeout_ms: int) -> list[int]:
        return list(self._call("read", max_length, timeout_ms))

    def send_feature_report(self, data: bytes) -> int:
        return int(self._call("send_feature_report", data))

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        return list(self._call("get_feature_report", report_num, max_length))

    def close(self) -> None:
        pass

    def clock(self) -> float:
        """The rig's clock, which stands still between calls."""
        return self._clock

    def place(self, subject: str) -> None:
        self._call("place", subject)

    def expose(self, seconds: float) -> None:
        self._step()
        self._call("expose", seconds)
        self._step()

    def card(self) -> list[CardFile]:
        return list(self._call("card"))

    def download(self, name: str, to: Path) -> None:
        self._step()
        self._call("download", name, to)

    def digest(self, name: str) -> str:
        self._step()
        return str(self._call("digest", name))

    def facts(self, path: Path) -> FrameFacts:
        return FakeCamera.facts(path)

    def health(self) -> Health:
        return Health()

    def delete(self, name: str) -> None:
        self._step()
        self._call("delete", name)


def host(address: str, root: Path, kill_at: int) -> None:
    """Capture group 00, and die by SIGKILL before step `kill_at`: syncs, writes, renames, camera calls."""
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1
        if steps == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    def before(function: Callable[..., Any]) -> Callable[..., Any]:
        def stepped(*args: Any) -> Any:
            step()
            return function(*args)

        return stepped

    write = os.write

    def torn_write(file: int, data: bytes) -> int:
        step()
        done = write(file, data[: len(data) // 2])
        step()
        return done + write(file, data[done:])

    os.fsync = before(os.fsync)
    os.write = torn_write  # type: ignore[assignment]
    Path.replace = before(Path.replace)  # type: ignore[method-assign]

    with Client(address, "AF_UNIX") as connection:
        remote = Remote(connection, step)

        @contextmanager
        def devices() -> Iterator[tuple[Goniometer, Camera]]:
            rig = HidGoniometer(remote, remote.clock, live=False)
            yield rig, remote
            rig.close()

        connect: Devices = devices
        plan = read_plan(root / "plan.json")
        capture(plan, "00", root, connect, DEVICE, {})


if __name__ == "__main__":
    host(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
