"""Shoot a group of the plan: what is missing or asked for anew; write the group's manifest."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from kinran.files import InputError, write_json
from kinran.journal import Journal
from kinran.plans import Plan, read_plan
from kinran.rig.camera import Camera, CameraError
from kinran.rig.errors import RigError
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.ledger import Wanted, manifest, missing, read_brackets, setup_digest
from kinran.rig.session import Session
from kinran.rig.simulation import PacedCamera, simulated_goniometer

Devices = Callable[[], AbstractContextManager[tuple[Goniometer, Camera]]]


def capture(
    plan: Plan,
    group: str,
    root: Path,
    devices: Devices,
    device: Mapping[str, Any],
    revisions: Mapping[str, int],
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Shoot what is missing of a group, and give its manifest.

    Parameters
    ----------
    plan
        The plan.
    group
        Name of the group.
    root
        Folder of the capture: frames, journal, card, quarantine.
    devices
        Opens the rig and the camera; called only when something is to be shot.
    device
        What the devices are; another description makes other frames.
    revisions
        Revision asked for, by shot; 0 for the others.
    say
        Takes a line of progress.

    Raises
    ------
    InputError
        A revision names no shot of the group, another capture runs, or the disk is full.
    RigError, CameraError
        A device stopped the session; what was shot is safe, and the next run goes on from there.
    """
    chosen = plan.group(group)
    check_revisions(revisions, {shot.shot for shot in chosen.shots}, group)
    wanted = [
        Wanted(group, shot, revisions.get(shot.shot, 0), setup_digest(plan, shot, device)) for shot in chosen.shots
    ]
    with Journal(root / "journal.jsonl") as journal:
        brackets = read_brackets(journal.records)
        todo = missing(brackets, wanted, root)
        say(f"{group}: {len(todo)} of {len(wanted)} shots to take")
        if todo:
            with devices() as (rig, camera):
                session = Session(plan, root, journal, rig, camera, str(device["device"]), say)
                session.run(group, wanted)
                brackets = session.brackets
        return manifest(plan, chosen, brackets)


def check_revisions(revisions: Mapping[str, int], shots: set[str], group: str) -> None:
    """Check the revisions asked for.

    Raises
    ------
    InputError
        One names no shot of the group, or is no whole number from 0.
    """
    for shot, revision in revisions.items():
        if shot not in shots:
            raise InputError(f"revision of '{shot}': group {group} has no such shot; see the plan")
        if not isinstance(revision, int) or isinstance(revision, bool) or revision < 0:
            raise InputError(f"revision of '{shot}' is {revision!r}; give a whole number from 0")


@contextmanager
def virtual_devices(root: Path, scene: dict[str, Any], group: str) -> Iterator[tuple[Goniometer, Camera]]:
    """A simulated rig, and a simulated camera with its card in `root`, for a group of the plan."""
    from kinran.virtual.camera import CACHE, SimulatedCamera  # it imports the path tracer

    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    camera: Camera = SimulatedCamera(firmware, root / "card", scene, CACHE, group)
    try:
        yield rig, PacedCamera(camera, firmware, rig)
    finally:
        rig.close()


def _json_object(text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not JSON ({error})") from None
    if not isinstance(value, dict):
        raise argparse.ArgumentTypeError(f"{text!r} is not a JSON object")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of ``kinran capture``."""
    parser.add_argument("--plan", type=Path, required=True, help="plan.json in the folder of the capture")
    parser.add_argument("--group", required=True, help="group to shoot")
    parser.add_argument("--device", choices=["virtual", "hid"], required=True, help="rig and camera")
    parser.add_argument("--virtual", type=_json_object, default={}, help="virtual fabric as a JSON object")
    parser.add_argument(
        "--revisions", type=_json_object, default={}, help="revisions asked for, as a JSON object by shot"
    )
    parser.add_argument("out", type=Path, metavar="OUT", help="manifest of the group")


def main(args: argparse.Namespace) -> None:
    """Shoot a group."""
    if args.device == "hid":
        raise InputError("device hid: no camera back-end is installed; use virtual, or ingest photographs")
    root = args.plan.parent
    device = {"device": args.device, "scene": args.virtual}
    try:
        value = capture(
            read_plan(args.plan),
            args.group,
            root,
            lambda: virtual_devices(root, args.virtual, args.group),
            device,
            args.revisions,
            lambda line: print(f"capture {line}", file=sys.stderr, flush=True),
        )
    except (RigError, CameraError) as error:
        raise InputError(str(error)) from None
    write_json(args.out, value)
