"""What the checks in the guest stand on: a rig that the kernel sees, programs beside this one, and results."""

import grp
import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import rig_device

import kinran.__main__ as command_line
from kinran.rig.transport import PRODUCT, VENDOR

SOON_S = 20.0
"""Seconds in which what must happen happens, on a loaded machine that computes the guest's instructions."""
POLL_S = 0.01
"""Seconds between two looks."""
NOBODY = 65534
"""Number of the user and group nobody."""


@dataclass(frozen=True)
class User:
    """A user without rights of his own: nobody, in some groups."""

    groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ended:
    """A program that ended: its exit status, negative for a signal, and what it printed."""

    status: int
    out: str
    error: str

    def __str__(self) -> str:
        """Status and last lines, which say most."""
        last = [text.splitlines()[-1] for text in (self.out, self.error) if text]
        return f"status {self.status}: {', '.join(last)}"

    def refused(self, *words: str) -> bool:
        """Return whether it ended with one sentence that has these words, and not with a traceback."""
        lines = self.error.splitlines()
        return self.status == 2 and len(lines) == 1 and all(word in lines[0] for word in words)


class Program:
    """A forked copy of this process that runs a function; starting Python anew takes seconds in the guest.

    Parameters
    ----------
    run
        Function whose result is the exit status.
    user
        Whom it runs as; root by default.
    environment
        What is added to the environment.
    """

    _count = 0

    def __init__(
        self, run: Callable[[], int], user: User | None = None, environment: Mapping[str, str] | None = None
    ) -> None:
        Program._count += 1
        self._files = [Path(f"/run/program-{Program._count}-{name}") for name in ("out", "error")]
        sys.stdout.flush()
        self.pid = os.fork()
        if self.pid:
            return
        status = 70
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            for number, path in enumerate(self._files, 1):
                os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            os.environ.update(environment or {})
            if user is not None:
                os.setgroups([grp.getgrnam(name).gr_gid for name in user.groups])
                os.setgid(NOBODY)
                os.setuid(NOBODY)
            status = run()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)

    def wait(self) -> Ended:
        """Wait for the end of the program, and kill it if it does not come soon."""
        until = time.monotonic() + 3 * SOON_S
        while time.monotonic() < until:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return Ended(os.waitstatus_to_exitcode(status), *(path.read_text().strip() for path in self._files))
            time.sleep(POLL_S)
        self.signal(signal.SIGKILL)
        return self.wait()

    def signal(self, number: signal.Signals) -> None:
        """Send the program a signal."""
        os.kill(self.pid, number)


class Device:
    """The rig, in a process of its own, which can be killed as by a failure of its power."""

    def __init__(self, link: str) -> None:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()

        def run() -> int:
            os.close(ours_out)
            with open(theirs_in) as words, open(theirs_out, "w") as answers:  # noqa: PTH123
                rig_device.Emulator(link).serve(words, answers)
            return 0

        self._program = Program(run)
        os.close(theirs_in)
        os.close(theirs_out)
        self._words, self._answers = open(ours_out, "w"), open(ours_in)  # noqa: PTH123, SIM115

    def __call__(self, words: str = "look") -> Any:
        """Tell the rig something, and return its true state."""
        print(words, file=self._words, flush=True)
        line = self._answers.readline()
        if not line:
            raise RuntimeError(f"the emulated rig died at '{words}': {self._program.wait().error[-200:]}")
        return SimpleNamespace(**json.loads(line))

    def kill(self) -> None:
        """End the process at once."""
        self._program.signal(signal.SIGKILL)
        self._program.wait()


class Bench:
    """A rig after power-on, the ways to look at it, and the results of the checks.

    Parameters
    ----------
    backend
        ``hidraw`` or ``libusb``: how the driver reaches the rig.
    link
        ``uhid`` or ``vhci``: how the rig reaches the kernel.

    Attributes
    ----------
    rig
        The rig: called with words, it obeys and returns its true state.
    """

    def __init__(self, backend: str, link: str) -> None:
        self.backend, self.link = backend, link
        self.rig = Device(link)
        self.seen(True)

    def check(self, what: str, passed: object, found: object = "") -> None:
        """Print a check with what was found, on one line."""
        shown = " | ".join(str(found).split("\n"))[:300]
        print(f"{'ok  ' if passed else 'FAIL'} {self.backend}:{self.link} {what}  {shown}".rstrip(), flush=True)

    def restarted(self) -> None:
        """Start another process for the rig, after the last one was killed."""
        self.seen(False)
        self.rig = Device(self.link)
        self.seen(True)

    def seen(self, wanted: bool) -> None:
        """Wait until the kernel sees the rig and udev has dealt with it, or until it does not see it any more.

        This process does not ask libusb, which must not be forked afterwards.
        """
        until = time.monotonic() + SOON_S
        while self._present() != wanted and time.monotonic() < until:
            time.sleep(POLL_S)
        udevadm("settle")

    def _present(self) -> bool:
        """Return whether the kernel has what the back-end opens."""
        if self.backend == "hidraw":
            wanted = f"HID_ID=0003:{VENDOR:08X}:{PRODUCT:08X}"
            return any(wanted in path.read_text() for path in Path("/sys/class/hidraw").glob("*/device/uevent"))
        return any(path.read_text() == f"{VENDOR:04x}\n" for path in Path("/sys/bus/usb/devices").glob("*/idVendor"))

    def until(self, true: Callable[[Any], object], seconds: float = SOON_S) -> Any:
        """Wait until something is true of the rig, and return its state then, or after some seconds."""
        until = time.monotonic() + seconds
        while not true(state := self.rig()) and time.monotonic() < until:
            time.sleep(POLL_S)
        return state

    def kinran(self, *words: str, user: User | None = None, **environment: str) -> Program:
        """Start ``kinran rig`` with these words."""
        return Program(lambda: command_line.main(["rig", *words]), user, environment)

    def still(self) -> bool:
        """Return whether the arms rest."""
        before = self.rig()
        time.sleep(0.2)
        after = self.rig()
        return not after.running and before.pose == after.pose


def load_commands() -> None:
    """Call the command once, so that programs that are forked have its modules."""
    with redirect_stdout(StringIO()):
        command_line.main(["rig", "--device", "virtual", "status"])


def udevadm(*words: str) -> None:
    """Call ``udevadm``, which refuses to work in another root without being told."""
    environment = os.environ | {"SYSTEMD_IGNORE_CHROOT": "1", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}
    subprocess.run(["udevadm", *words], env=environment, check=True)


def raised(call: Callable[[], object], *kinds: type[Exception]) -> Exception | None:
    """Return the error of one of these kinds that a call raises; another error is raised on."""
    try:
        call()
    except kinds as error:
        return error
    return None


def close_to(pose: Sequence[float], wanted: Sequence[float]) -> bool:
    """Return whether axes rest within the 20 mdeg that an arm may be off."""
    return all(abs(a - b) <= 20 for a, b in zip(pose, wanted, strict=False))
