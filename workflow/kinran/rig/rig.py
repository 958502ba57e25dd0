"""Talk to the goniometer: show its state, home it, move the light arm.

`status` only looks. `home` clears a latched fault after showing it, then finds the reference of every axis.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from kinran.base.files import InputError
from kinran.rig.errors import RigError
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.motion import AXES, mdeg
from kinran.rig.protocol import Fault, Flag
from kinran.rig.simulation import simulated_goniometer
from kinran.rig.transport import PRODUCT, VENDOR, TransportError, open_hid, rig_lock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kinran rig`` to a parser."""
    parser.add_argument("--device", choices=["hid", "virtual"], default="hid", help="which rig")
    parser.add_argument("--serial", help="serial number, if several are connected")
    parser.add_argument("--usb", type=usb_pair, default=(VENDOR, PRODUCT), help="VENDOR:PRODUCT in hexadecimal")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("status", help="show identity, pose, lamp and faults")
    actions.add_parser("home", help="find the reference of every axis")
    move = actions.add_parser("move", help="move the light arm")
    move.add_argument("theta", type=float, help="degrees from the normal")
    move.add_argument("phi", type=float, help="degrees from the weft")


def usb_pair(text: str) -> tuple[int, int]:
    """Parse vendor and product id such as ``1209:0001``."""
    try:
        vendor, product = (int(word, 16) for word in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not VENDOR:PRODUCT, such as 1209:0001") from None
    return vendor, product


@contextmanager
def open_goniometer(
    device: str, serial: str | None = None, usb: tuple[int, int] = (VENDOR, PRODUCT)
) -> Iterator[Goniometer]:
    """Open and greet a rig; a real one is locked for this process.

    Raises
    ------
    RigError, TransportError
        The rig cannot be opened, or does not answer.
    """
    if device == "virtual":
        rig = simulated_goniometer(Firmware())
        rig.hello()
        yield rig
        rig.close()
        return
    handle, name = open_hid(serial, *usb)
    rig = Goniometer(handle)
    with rig_lock(name):
        try:
            rig.hello()
            yield rig
        finally:
            rig.close()


def describe(rig: Goniometer) -> str:
    """Return identity and state of a rig in a few lines."""
    state, ident = rig.status(), rig.ident
    lines = [f"rig {ident.serial if ident else '?'}, protocol 1, up {state.uptime_ms / 1000:.0f} s"]
    for i, axis in enumerate(AXES):
        homed = f"{state.position[i] / 1000:.3f}°" if state.homed >> i & 1 else "not homed"
        lines.append(f"  {axis.name:9} {homed}")
    warm = "warm" if state.has(Flag.LAMP_WARM) else "cold"
    lines.append(f"  lamp      {'on, ' + warm if state.has(Flag.LAMP) else 'off'}")
    lines.append(f"  shutter   {'open' if state.has(Flag.SHUTTER) else 'closed'}")
    lines.append(f"  fault     {Fault(state.fault).name.lower()}")
    return "\n".join(lines)


def main(args: argparse.Namespace) -> None:
    """Carry out one action and show the state."""
    try:
        with open_goniometer(args.device, args.serial, args.usb) as rig:
            if args.action == "home":
                if rig.state.fault:
                    print(describe(rig))
                    rig.clear()
                rig.home()
            if args.action == "move":
                if args.device == "virtual":
                    rig.home()
                rig.move(mdeg(args.theta), mdeg(args.phi))
            print(describe(rig))
    except (RigError, TransportError) as error:
        raise InputError(str(error)) from None
