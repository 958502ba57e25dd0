"""Shoot the missing and the repeated shots of a group of the plan, and write the group's manifest."""

import json
import logging
import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from kinran.base.digest import digest
from kinran.base.files import DISK, InputError, write_json
from kinran.capture.brackets_taken import Wanted, finished, manifest, missing, setup_digest
from kinran.capture.journal import JOURNAL, Journal
from kinran.capture.light_dose import Lighting
from kinran.capture.live import Live, LiveFile, seen
from kinran.capture.lost_records import checked_brackets, record_last
from kinran.capture.rig_devices import rig_config, rig_devices
from kinran.capture.session import UNLIMITED, Session, untold
from kinran.data.capture_plan import Plan, read_plan
from kinran.rig.camera import Camera, CameraError
from kinran.rig.errors import RigError
from kinran.rig.goniometer import Goniometer
from kinran.rig.stopping import interruptible

log = logging.getLogger(__name__)

Devices = Callable[[], AbstractContextManager[tuple[Goniometer, Camera]]]


def json_object(text: str) -> dict[str, Any]:
    """Parse a JSON object.

    Raises
    ------
    InputError
        The text is not a JSON object.
    """
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{text!r}: is not JSON ({error}); give an object such as {{}}") from None
    if not isinstance(value, dict):
        raise InputError(f"{text!r}: is not a JSON object; give one such as {{}}")
    return value


@dataclass(frozen=True)
class Inputs:
    plan: Annotated[Path, "plan.json in the folder of the capture"]


@dataclass(frozen=True)
class Options:
    group: Annotated[str, "group to shoot"]
    device: Annotated[Literal["virtual", "hid"], "rig and camera"]
    virtual: Annotated[Mapping[str, Any], "--virtual JSON", "virtual fabric as an object", json_object] = field(
        default_factory=dict
    )
    rig: Annotated[Mapping[str, Any], "--rig JSON", "rig and camera of hid as an object", json_object] = field(
        default_factory=dict
    )
    revisions: Annotated[Mapping[str, int], "--revisions JSON", "revisions asked for, by shot", json_object] = field(
        default_factory=dict
    )


def main(inputs: Inputs, out: Annotated[Path, "OUT", "manifest of the group"], options: Options) -> None:
    """Shoot a group and write its manifest.

    When the code of the virtual rig changes, its frames are shot anew, and the old ones kept.
    """
    root, plan, config = inputs.plan.parent, read_plan(inputs.plan), rig_config(options.rig)
    watched = LiveFile(root, Live(plan.fabric, options.group, os.getpid(), device=options.device, usb=config.usb,
                               serial=config.serial))  # fmt: skip

    begin: Callable[[str], None] | None = None

    def tell(**changes: Any) -> None:
        if "shot" in changes and begin:
            begin(changes["shot"])
        if "frame" in changes:
            changes["frame"] = seen(root, *changes["frame"])
        watched.update(**changes)

    device: Mapping[str, Any]
    devices: Devices
    if options.device == "hid":
        device, devices = config.device, partial(rig_devices, config, root, watched.ask)
    else:
        from kinran.virtual.devices import VirtualGroup  # it imports the path tracer

        scene = dict(options.virtual)
        device = {"device": options.device, "scene": scene, "code": digest("kinran.virtual.devices")}
        virtual = VirtualGroup(root, scene, plan, options.group, options.revisions)
        devices, begin = virtual.devices, virtual.begin
    try:
        with interruptible():
            value = capture(plan, options.group, root, devices, device, options.revisions, config.lighting, tell)
    except (RigError, CameraError) as error:
        watched.update(phase=f"stopped: {error}")
        raise InputError(str(error)) from None
    except InputError as error:
        watched.update(phase=f"stopped: {error}")
        raise
    except KeyboardInterrupt:
        watched.update(phase="stopped by a signal")
        raise
    watched.update(phase="done", left_s=0.0)
    write_json(out, value)


def capture(
    plan: Plan,
    group: str,
    root: Path,
    devices: Devices,
    device: Mapping[str, Any],
    revisions: Mapping[str, int],
    lighting: Lighting = UNLIMITED,
    tell: Callable[..., None] = untold,
) -> dict[str, Any]:
    """Shoot the missing shots of a group, and return its manifest.

    Parameters
    ----------
    plan
        The plan.
    group
        Name of the group.
    root
        Folder of the capture: frames, journal, card, quarantine.
    devices
        Function that opens the rig and the camera; called only when something is to be shot, or when a session was
        killed before it had tidied the card.
    device
        Description of the devices; frames of another description do not count.
    revisions
        Revision that is asked for, by shot; 0 for the others.
    lighting
        Illuminance on the sample, and the limit of its dose.
    tell
        Function that hears of changes of the state, as `LiveFile.update`.

    Raises
    ------
    InputError
        A revision names no shot of the group, another capture runs, the disk is full or fails, or the journal is
        damaged or lost.
    RigError, CameraError
        A device stopped the session; what was shot is safe, and the next run goes on from there.
    """
    chosen = plan.group(group)
    check_revisions(revisions, {shot.shot for shot in chosen.shots}, group)
    wanted = [
        Wanted(group, shot, revisions.get(shot.shot, 0), setup_digest(plan, shot, device)) for shot in chosen.shots
    ]
    try:
        with Journal(root / JOURNAL) as journal:
            brackets = checked_brackets(root, journal.records)
            record_last(root, journal, brackets)
            todo = missing(brackets, wanted, root)
            log.info("capture %s: %d of %d shots to take", group, len(todo), len(wanted))
            if todo or not finished(journal.records, group):
                with devices() as (rig, camera):
                    session = Session(plan, root, journal, rig, camera, str(device["device"]), lighting, tell)
                    session.run(group, wanted)
                    brackets = session.brackets
            journal.copy()
            return manifest(plan, chosen, brackets)
    except OSError as error:
        if error.errno not in DISK:
            raise
        raise InputError(f"{error.filename or root}: {DISK[error.errno]} and run the capture again") from None


def check_revisions(revisions: Mapping[str, int], shots: set[str], group: str) -> None:
    """Check the revisions that are asked for.

    Raises
    ------
    InputError
        A revision names no shot of the group, or is not a whole number from 0.
    """
    for shot, revision in revisions.items():
        if shot not in shots:
            raise InputError(f"revision of '{shot}': group {group} has no such shot; see the plan")
        if not isinstance(revision, int) or isinstance(revision, bool) or revision < 0:
            raise InputError(f"revision of '{shot}' is {revision!r}; give a whole number from 0")
