"""Talk to the goniometer: look at it, home it, move it, stop it.

`status` only looks. `home` clears a latched fault after showing it, then finds the reference of every axis. `estop`
stops everything at once, whatever other program drives the rig. `repair` and `verify` need no rig: they look after the
frames of captures.

An action imports what it alone needs, so that the rig can be stopped from a machine with hidapi and nothing else.
"""

import argparse
import logging
import sys
from pathlib import Path

from kinran.base.files import InputError, check_name
from kinran.rig.camera import CameraError
from kinran.rig.errors import RigError
from kinran.rig.goniometer import ALL_AXES, Goniometer
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import mdeg
from kinran.rig.opening import RigSettings, open_goniometer, usb_pair
from kinran.rig.protocol import Fault, Flag
from kinran.rig.stopping import interruptible
from kinran.rig.transport import UDEV_RULE, TransportError

log = logging.getLogger(__name__)

RULES = Path("/etc/udev/rules.d")
"""Folder of the rules that an administrator adds."""
CAPTURES = Path("captures")
"""Folder of the captures, from where the workflow runs."""
PARKED_MDEG = (0, 0)
"""Where the light arm is parked: over the fabric at φ = 0, under the closed shutter."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``kinran rig`` to a parser."""
    parser.add_argument("--device", choices=["hid", "virtual"], default="hid", help="which rig")
    parser.add_argument("--serial", default="", help="serial number, if several are connected")
    parser.add_argument("--usb", default=RigSettings.usb, help="VENDOR:PRODUCT in hexadecimal")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("status", help="show identity, pose, lamp and faults, and change nothing")
    actions.add_parser("home", help="find the reference of every axis")
    move = actions.add_parser("move", help="move the light arm to a direction")
    move.add_argument("theta", type=float, help="degrees from the normal")
    move.add_argument("phi", type=float, help="degrees from the weft")
    jog = actions.add_parser("jog", help="move one axis by some degrees")
    jog.add_argument("axis", choices=["theta", "phi", "camera-theta", "camera-phi"], help="axis to move")
    jog.add_argument("degrees", type=float, help="degrees to move it by, such as -2.5")
    actions.add_parser("park", help="move the arms to θ = 0, φ = 0 and put out the lamp")
    actions.add_parser("estop", help="stop everything at once, even if another program drives the rig")
    trial = actions.add_parser("test-shot", help="take one frame under the open shutter, and say how it is exposed")
    trial.add_argument("--exposure", type=float, default=0.01, metavar="SECONDS", help="exposure time (0.01)")
    trial.add_argument("--camera", default="usb", help="port of the camera: usb, or ptpip:HOST:PORT")
    trial.add_argument("--to", type=Path, default=Path(), metavar="DIR", help="folder of the frame (this one)")
    watching = actions.add_parser("watch", help="show a running capture: progress, lamp, last frame, questions")
    watching.add_argument("fabric", help="name of the fabric")
    watching.add_argument("--captures", type=Path, default=CAPTURES, metavar="DIR", help="folder of the captures")
    mend = actions.add_parser("repair", help="build the journal of a capture again from its copy, sidecars and frames")
    mend.add_argument("fabric", help="name of the fabric")
    look = actions.add_parser("verify", help="hash all frames of captures, and say which are damaged")
    look.add_argument("fabrics", nargs="*", metavar="fabric", help="names of fabrics (all)")
    udev = actions.add_parser("install-udev", help="write the udev rule that lets users open the rig")
    udev.add_argument("--to", type=Path, default=RULES, metavar="DIR", help=f"folder of the rule ({RULES})")


def main(args: argparse.Namespace) -> None:
    """Carry out one action and show the state."""
    if args.action in WITHOUT_RIG:
        WITHOUT_RIG[args.action](args)
        return
    settings = RigSettings(args.usb, args.serial)
    try:
        with interruptible():
            if args.action == "test-shot":
                test_shot(args)
                return
            with open_goniometer(args.device, settings, alone=args.action != "estop") as rig:
                act(rig, args)
    except (RigError, CameraError, TransportError) as error:
        raise InputError(str(error)) from None


def watch(args: argparse.Namespace) -> None:
    """Show a running capture."""
    from kinran.capture import watch

    watch.watch(watch.folder(args.captures, args.fabric))


def repair(args: argparse.Namespace) -> None:
    """Build a journal again."""
    from kinran.capture import repair

    print(repair.report(args.fabric, repair.repair(CAPTURES / check_name(args.fabric, "fabric"))))


def verify(args: argparse.Namespace) -> None:
    """Hash the frames of captures."""
    from kinran.capture import bit_rot

    names = args.fabrics or sorted(path.name for path in CAPTURES.glob("*") if path.is_dir())
    bit_rot.verify_all([CAPTURES / check_name(name, "fabric") for name in names])


def test_shot(args: argparse.Namespace) -> None:
    """Take one frame, and say how it is exposed."""
    from kinran.capture.rig_devices import RigConfig, rig_devices
    from kinran.capture.trial_shot import trial_shot

    if args.device == "virtual":
        from kinran.virtual.devices import virtual_devices

        devices = virtual_devices(args.to, {}, "test-shot")
    else:
        devices = rig_devices(RigConfig(args.camera, usb=args.usb, serial=args.serial), args.to, print)
    print(trial_shot(devices, args.exposure, args.to))


def act(rig: HidGoniometer, args: argparse.Namespace) -> None:
    """Carry out one action on an open rig."""
    if args.action == "estop":
        rig.estop()
        print("emergency stop sent; `kinran rig home` clears it")
        return
    if args.action == "status":
        rig.look()
        print(describe(rig))
        return
    rig.hello()
    if args.action == "home" or (args.device == "virtual" and not rig.state.homed):
        if rig.state.fault:
            print(describe(rig))
            rig.clear()
        rig.home()
    if args.action == "move":
        rig.move(mdeg(args.theta), mdeg(args.phi))
    if args.action == "jog":
        jog(rig, args.axis, mdeg(args.degrees))
    if args.action == "park":
        rig.move(*PARKED_MDEG, (0, 0))
        rig.lamp(False)
    print(describe(rig))


def jog(rig: Goniometer, axis: str, by_mdeg: int) -> None:
    """Move one axis by some millidegrees from where it stands.

    Raises
    ------
    RigError
        The rig is not homed, or the move fails.
    """
    if rig.state.homed != ALL_AXES:
        raise RigError("the rig does not know where its axes stand; run `kinran rig home` first")
    target = list(rig.state.position)
    moved = ["theta", "phi", "camera-theta", "camera-phi"].index(axis)
    target[moved] += by_mdeg
    theta, phi, camera_theta, camera_phi = target
    rig.move(theta, phi, (camera_theta, camera_phi) if moved > 1 else None)


def describe(rig: Goniometer) -> str:
    """Return identity and state of a rig in a few lines."""
    state, identity = rig.state, rig.identity
    lines = [f"rig {identity.serial or '?'}, protocol 1, up {state.uptime_ms / 1000:.0f} s"]
    for i, axis in enumerate(identity.axes):
        at = f"{state.position[i] / 1000:.3f}°" if state.homed >> i & 1 else "not homed"
        limits = f"{axis.low / 1000:g}° to {axis.high / 1000:g}°"
        lines.append(f"  {axis.name:9} {at:>10}   {limits}, {axis.speed / 1000:g}°/s, {axis.acceleration / 1000:g}°/s²")
    warm = "warm" if state.has(Flag.LAMP_WARM) else "cold"
    lines.append(f"  lamp      {'on, ' + warm if state.has(Flag.LAMP) else 'off'}")
    lines.append(f"  shutter   {'open' if state.has(Flag.SHUTTER) else 'closed'}")
    lines.append(f"  fault     {Fault(state.fault).name.lower()}")
    return "\n".join(lines)


def install_udev(args: argparse.Namespace) -> None:
    """Write the udev rule that lets the users of the machine open a rig, and say how to make it count.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    path = args.to / UDEV_RULE
    try:
        path.write_text(udev_rule(args.usb))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); run it as root:"
            f" sudo {Path(sys.executable)} -m kinran rig --usb {args.usb} install-udev"
        ) from None
    print(
        f"{path}: written; now run `udevadm control --reload && udevadm trigger` as root, reconnect the rig, and"
        " add its users to the group plugdev: `usermod -aG plugdev NAME`"
    )


def udev_rule(usb: str) -> str:
    """Return the rule for a pair VENDOR:PRODUCT: the kernel's names are upper case, the attributes lower."""
    vendor, product = usb_pair(usb)
    access = 'MODE="0660", GROUP="plugdev", TAG+="uaccess"'
    return (
        f"# The goniometer {vendor:04x}:{product:04x}: for the user at the machine, and for the group plugdev\n"
        f'SUBSYSTEM=="hidraw", KERNELS=="0003:{vendor:04X}:{product:04X}.*", {access}\n'
        f'SUBSYSTEM=="usb", ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}", {access}\n'
    )


WITHOUT_RIG = {"install-udev": install_udev, "watch": watch, "repair": repair, "verify": verify}
"""Actions that open no rig."""
