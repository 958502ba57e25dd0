"""The rig's driver and its commands on a real kernel: a virtual machine sees a simulated rig, and the driver drives it.

The rig is a device of uhid, or of USB through vhci_hcd, and is reached through hidraw or libusb. Every check prints a
line; the last line has their numbers. The status is 0 if all passed, 1 if one failed, and 2 if the machine could not be
set up, which is an error and never a pass.
"""

import argparse
import compileall
import sys
import sysconfig
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from virtual_machine import SetupError, boot, initramfs, install_tools, kernel

from kinran.base.project import ROOT

SETUPS = ("hidraw:uhid", "hidraw:vhci", "libusb:vhci")
"""How the driver reaches the rig, and how the rig reaches the kernel."""
HERE = Path(__file__).resolve().parent


@dataclass
class Results:
    """What the guest said.

    Attributes
    ----------
    passed, failed
        Numbers of checks.
    ended
        Set-ups whose checks came to their end.
    """

    passed: int = 0
    failed: int = 0
    ended: set[str] = field(default_factory=set)

    def take(self, line: str) -> str | None:
        """Count a line of the guest, and return what is to be shown of it.

        Raises
        ------
        SetupError
            The guest misses something.
        """
        word, _, rest = line.partition(" ")
        if word == "@needs":
            raise SetupError(f"the guest needs {rest}")
        if word == "@end":
            self.ended.add(rest.split()[0])
            return None
        self.passed += word == "ok"
        self.failed += word == "FAIL"
        return line

    def missing(self, setups: Sequence[str]) -> list[str]:
        """Return the set-ups whose checks did not come to their end."""
        return [setup for setup in setups if setup not in self.ended]


PYTHON = Path(sys.executable).resolve()
"""The interpreter itself: a copied root has no virtual environment."""
PACKAGES = Path(sysconfig.get_paths()["purelib"])
"""Folder of the packages, hidapi's among them."""


def copied() -> list[Path]:
    """Return what the guest needs: Python, hidapi, udev, the library and the checks."""
    python = [PYTHON, Path(sys.base_prefix) / "lib" / f"python3.{sys.version_info[1]}"]
    packages = [path for name in ("hid", "msgspec", "typing_extensions") for path in PACKAGES.glob(f"{name}*")]
    # libusb's strings are read with iconv, which is a part of glibc that no program is linked with
    gconv = [path for path in Path("/usr/lib").glob("*/gconv/*") if path.name.startswith(("gconv-modules", "UTF-16"))]
    udev = [
        Path(name) for name in ("/bin/udevadm", "/lib/systemd/systemd-udevd", "/lib/udev/rules.d/50-udev-default.rules")
    ]
    return [*python, *packages, *gconv, *udev, ROOT / "workflow" / "kinran", ROOT / "tests" / "helpers", HERE]


def main(words: Sequence[str]) -> int:
    """Run the checks in the set-ups that are named, or in all; returns the exit status."""
    parser = argparse.ArgumentParser(prog="kinran test rig-vm", description=__doc__)
    parser.add_argument("setups", nargs="*", metavar="SETUP", help=f"{', '.join(SETUPS)}; all by default")
    args = parser.parse_args(words)
    if unknown := set(args.setups) - set(SETUPS):
        parser.error(f"unknown set-up {' '.join(sorted(unknown))}; known are {', '.join(SETUPS)}")
    setups = args.setups or SETUPS
    began = time.monotonic()
    results = Results()
    try:
        install_tools()
        found = kernel()
        # the guest takes seconds for it
        compileall.compile_dir(ROOT / "workflow" / "kinran", quiet=2)
        compileall.compile_dir(HERE, quiet=2)
        with initramfs(found, [program(setups)], copied()) as packed:
            prepared = time.monotonic()
            for line in boot(found, packed):
                if shown := results.take(line):
                    print(shown, flush=True)
    except SetupError as error:
        print(f"SETUP ERROR: {error}", flush=True)
        return 2
    for setup in results.missing(setups):
        print(f"FAIL {setup} did not come to its end")
        results.failed += 1
    print(f"note {found.name}, prepared in {prepared - began:.0f} s, ran for {time.monotonic() - prepared:.0f} s")
    print(f"{results.passed} passed, {results.failed} failed")
    return 1 if results.failed or not results.passed else 0


def program(setups: Sequence[str]) -> str:
    """Return the line of shell that runs the checks of some set-ups."""
    path = ":".join(str(folder) for folder in (ROOT / "workflow", ROOT / "tests" / "helpers", PACKAGES))
    environment = f"HOME=/run TMPDIR=/run PYTHONDONTWRITEBYTECODE=1 PYTHONPATH={path}"
    return f"{environment} {PYTHON} {HERE / 'rig_guest.py'} {' '.join(setups)}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
