"""A session of shooting, which can be killed at any moment without losing or repeating a bracket.

For each bracket: intent, sync; exposures; copies, sync; checks; rename, sync the folder; frame records, sync; only
then are the files deleted on the card. The journal alone says what is done (docs/capture.md has the resume rule), and a
frame's own EXIF says to which exposure it belongs.
"""

import logging
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from kinran.base.files import DISK, InputError
from kinran.capture.arms import go
from kinran.capture.brackets_taken import JournalBracket, Wanted, missing, read_brackets
from kinran.capture.exposing import TRIES, expose
from kinran.capture.frame_check import own_frames
from kinran.capture.journal import Journal, Record
from kinran.capture.lamp_watch import LampWatch
from kinran.capture.light_dose import Dose, Lighting, check_dose, light_dose
from kinran.capture.next_shots import check_way, in_order
from kinran.capture.sidecar import keep_sidecar
from kinran.capture.store import Fetched, check_space, fetch, land, quarantine, remove_parts, set_aside, tidy_card
from kinran.data.capture_plan import Plan
from kinran.rig.camera import Camera, CameraError, CardFile
from kinran.rig.errors import RebootedError, RigError
from kinran.rig.goniometer import ALL_AXES, Goniometer, check_fault
from kinran.rig.motion import ON_TARGET_MDEG, mdeg

RESTARTS = 3
"""Restarts of the rig after which a session goes on: a choice; a rig that restarts more often needs a person."""
LAMP_SAME = 0.01
"""Relative change of the lamp within which a bracket may be completed later: under `LAMP_RETURNS`. No measurement
stands behind it."""
LONG_S = 1.0
"""Exposure time in seconds above which the watchdog of a dead host may close the shutter under an exposure."""
SUBJECTS = dict.fromkeys(("light", "monitor", "view"), "fabric") | {"dark": "dark", "white": "white", "chart": "chart"}
"""Subject before the lens for each kind of shot."""

UNLIMITED = Lighting()
"""Light of which nothing is known, and whose dose has no limit."""

log = logging.getLogger(__name__)


def untold(**changes: Any) -> None:
    """Tell nobody."""


class Session:
    """Shoots the missing brackets, until done or until an error stops it; both leave a sound journal.

    Parameters
    ----------
    plan
        The plan.
    root
        Folder of the capture.
    journal
        Journal of the capture, open.
    rig, camera
        Devices; both may hold leftovers of a killed session.
    device
        Name of the device, for the journal.
    lighting
        Illuminance on the sample, and the limit of its dose.
    tell
        Function that hears of changes of the state, as `LiveFile.update`.
    """

    def __init__(
        self,
        plan: Plan,
        root: Path,
        journal: Journal,
        rig: Goniometer,
        camera: Camera,
        device: str,
        lighting: Lighting = UNLIMITED,
        tell: Callable[..., None] = untold,
    ) -> None:
        self.plan, self.root, self.journal = plan, root, journal
        self.rig, self.camera, self.device = rig, camera, device
        self.lighting, self.tell = lighting, tell
        self.lamp = LampWatch(rig, journal)
        self.brackets = read_brackets(journal.records)
        self._started = sum(record["t"] == "session" for record in journal.records)
        self._kept: dict[int, Fetched] = {}
        self._before: set[CardFile] = set()
        self._newest = 0.0
        self._subject = ""

    def run(self, group: str, wanted: Sequence[Wanted]) -> None:
        """Shoot the missing shots of a group.

        Raises
        ------
        RigError, CameraError
            A device failed; the session can be run again when the cause is gone.
        InputError
            The disk is full, fails or cannot be written to; or the sample would get more light than its limit.
        """
        try:
            self._run(group, wanted)
        except OSError as error:
            if error.errno not in DISK:
                raise
            raise InputError(
                f"{self.root}: {DISK[error.errno]} and run the capture again: the frames are still on the card"
            ) from None

    def _run(self, group: str, wanted: Sequence[Wanted]) -> None:
        remove_parts(self.root)
        self._meet(group)
        todo = missing(self.brackets, wanted, self.root)
        if todo:
            check_space(self.root, len(todo) * len(self.plan.exposures_s), self.journal.records)
            if len(todo) < len(wanted):
                todo = in_order(self.rig, todo, self.brackets[-1].intent["shot"] if self._kept else "")
            check_way(self.rig, self.plan, [want.shot for want in todo])
            self._prepare()
            self._shoot_all(group, todo, len(wanted))
        self.journal.append({"t": "complete", "group": group, "plan": self.plan.sha256})

    def _shoot_all(self, group: str, todo: list[Wanted], total: int) -> None:
        began, restarts, done = time.monotonic(), 0, 0
        while todo:
            try:
                self._shoot(todo[0])
            except RebootedError as error:
                self.journal.append({"t": "fault", "message": str(error)})
                restarts += 1
                if restarts > RESTARTS:
                    raise
                self._meet(group)
                self._prepare()
                todo = missing(self.brackets, todo, self.root)
                continue
            except (RigError, CameraError) as error:
                self.journal.append({"t": "fault", "message": str(error)})
                raise
            todo = todo[1:]
            done += 1
            left = (time.monotonic() - began) / done * len(todo)
            dose = light_dose(self.journal.records)
            self.tell(phase="shoots", done=total - len(todo), total=total, left_s=left, dose=str(dose))
            if done == 1:
                check_space(self.root, len(todo) * len(self.plan.exposures_s), self.journal.records)
            if done % 8 == 0 or not todo:
                self._look_at_camera()
                log.info("capture %s: %d of %d shots, %s left", group, done, done + len(todo), _duration(left))

    def _look_at_camera(self) -> None:
        """Tell battery and free space of the camera, and warn of a battery that is nearly empty."""
        try:
            health = self.camera.health()
        except CameraError:
            return  # the next exposure meets what is wrong with the camera
        free = "" if health.free_bytes is None else f"{health.free_bytes / 1e9:.1f} GB free"
        self.tell(battery=health.battery, card=free)
        if health.low:
            log.warning("capture: the camera's battery is at %s; charge it, or give it a mains adapter", health.battery)

    # -- meeting the devices -------------------------------------------------------------------------

    def _meet(self, group: str) -> None:
        """Greet the rig, and settle the frames that an earlier session left on the card."""
        self.rig.hello()
        self.journal.append(
            {"t": "session", "session": self._started, "plan": self.plan.sha256, "group": group,
             "device": self.device, "serial": self.rig.identity.serial, "boot": self.rig.identity.boot,
             "lux": self.lighting.lux}
        )  # fmt: skip
        self._started += 1
        self._subject = ""
        self._kept = {}
        self._newest = 0.0
        tidy_card(self.camera, self.journal.records, self.brackets)
        self._settle()
        self._before = set(self.camera.card())
        check_fault(self.rig.state)

    def _settle(self) -> None:
        """Adopt the frames of the bracket that was under way, keep them for its completion, or quarantine them."""
        if not self.brackets or self.brackets[-1].complete or self.brackets[-1].void:
            return
        bracket = self.brackets[-1]
        found = [file for file in self.camera.card() if file.name not in bracket.intent["card"]]
        if not found:
            return
        exposures: list[float] = bracket.intent["exposures"]
        same_boot = bracket.intent["boot"] == self.rig.identity.boot
        counted = self._counted(bracket, len(found)) if same_boot else len(found)
        frames = self._fetch(found)
        earlier = [each for each in self.brackets if each.intent["session"] == bracket.intent["session"]]
        since = max((frame.get("taken", 0.0) for each in earlier for frame in each.frames.values()), default=0.0)
        own, others = own_frames(dict(enumerate(exposures)), frames, self.camera, since)
        if self.rig.state.fault or max(exposures) > LONG_S:
            self._quarantine(frames, "the shutter may have closed under an exposure")
        elif not others and len(own) == len(exposures) == counted:
            self._record(bracket, own, bracket.intent["photodiode"], "adopted")
            log.info("capture %s: adopted %d frames from the card", bracket.intent["shot"], len(found))
        elif not others and same_boot and len(own) < len(exposures) and len(own) == counted:
            self._kept = own
        else:
            self._quarantine(frames, "not the bracket that was under way")

    def _counted(self, bracket: JournalBracket, unknown: int) -> int:
        """Return the X-sync edges since the intent; `unknown` where the rig does not count them."""
        if not self.rig.identity.x_sync:
            return unknown
        return self.rig.state.exposures - int(bracket.intent["counter"])

    def _prepare(self) -> None:
        """Home the rig if it does not know its pose, and wait for a warm and steady lamp."""
        if self.rig.state.homed != ALL_AXES:
            self.rig.home()
        self.lamp.prepare(self.tell)

    # -- one bracket ---------------------------------------------------------------------------------

    def _shoot(self, want: Wanted) -> None:
        check_dose(light_dose(self.journal.records), self.plan.exposures_s, self.lighting)
        for attempt in range(TRIES):
            bracket, kept = self._open(want)
            frames = self._fill(bracket, kept)
            steady = self.lamp.steady(want.shot.kind, self.rig.state.photodiode)
            if steady and self._counted(bracket, len(frames)) >= len(frames):
                self._record(bracket, frames, self.rig.state.photodiode if self.rig.identity.photodiode else 0, "shot")
                return
            self._quarantine(list(frames.values()), "X-sync missing" if steady else "lamp drifted")
            if not steady:
                self.lamp.wait()
            elif attempt:
                raise CameraError("the rig does not see the camera's X-sync; check the cable between them")
        raise RigError("the lamp does not hold steady; check it, then run the capture again")

    def _fill(self, bracket: JournalBracket, frames: dict[int, Fetched]) -> dict[int, Fetched]:
        """Take the exposures that `frames` lacks until each has its frame; what else lands is quarantined.

        Raises
        ------
        RigError
            The rig failed: the light of the last frames is unknown, and the bracket is void.
        CameraError
            The camera does not take what was asked.
        """
        exposures: list[float] = bracket.intent["exposures"]
        frames = dict(frames)
        reason = ""
        for _ in range(TRIES):
            wanted = {k: seconds for k, seconds in enumerate(exposures) if k not in frames}
            try:
                landed, seconds = expose(self.rig, self.camera, list(wanted.values()), self._subject != "dark")
                self._note_light(bracket, seconds)
            except RigError as error:
                self._void(bracket, str(error))
                raise
            fetched = self._fetch(landed)
            for each in fetched:
                if each.facts is None:
                    raise CameraError(
                        f"{each.source.name} is damaged on the card: {each.problem};"
                        " check the card, then run the capture again"
                    )
            own, others = own_frames(wanted, fetched, self.camera, self._newest)
            frames |= own
            for reason, odd in others.items():
                self._quarantine(odd, reason, void=False)
            if len(frames) == len(exposures):
                return frames
        raise CameraError(
            f"the camera does not take {bracket.intent['shot']} as asked ({reason or 'no frame landed on the card'}),"
            f" in {TRIES} tries; check its settings, then run the capture again"
        )

    def _fetch(self, files: Sequence[CardFile]) -> list[Fetched]:
        return [fetch(self.camera, self.root, file) for file in files]

    def _void(self, bracket: JournalBracket, reason: str) -> None:
        """Put aside what landed for a bracket whose light is unknown, if the camera still lets it be read."""
        try:
            self._quarantine(
                self._fetch([file for file in self.camera.card() if file.name not in bracket.intent["card"]]), reason
            )
        except CameraError as error:
            log.warning("capture: frames of %s stay on the card: %s", bracket.intent["shot"], error)
            self._quarantine([], reason)

    def _open(self, want: Wanted) -> tuple[JournalBracket, dict[int, Fetched]]:
        """Move to the shot's pose and write its intent, or go on with the bracket that was under way."""
        subject = SUBJECTS[want.shot.kind]
        if subject != self._subject:
            self.camera.place(subject)
            self._subject = subject
        self.tell(shot=want.shot.shot, pose_deg=(want.shot.theta, want.shot.phi))
        pose = go(self.rig, want.shot, mdeg(self.plan.backlash))
        photodiode = self.lamp.reading()
        if not self.lamp.steady(want.shot.kind, photodiode):
            self.lamp.wait()
            photodiode = self.lamp.reading()
        kept, self._kept = self._kept, {}
        if kept and self._may_complete(self.brackets[-1].intent, want, pose, photodiode):
            return self.brackets[-1], kept
        if kept:
            self._quarantine(list(kept.values()), "its bracket cannot be completed")
        card = self.camera.card()
        stray = [file for file in card if file not in self._before]
        if stray:
            self._quarantine(self._fetch(stray), "it landed late, or somebody released the shutter", void=False)
            card = self.camera.card()
        self._supersede(want)
        intent: Record = {
            "t": "intent",
            "session": self._started - 1,
            "group": want.group,
            "shot": want.shot.shot,
            "revision": want.revision,
            "setup": want.setup,
            "exposures": list(self.plan.exposures_s),
            "pose": list(pose),
            "photodiode": photodiode,
            "time": round(self.rig.state.uptime_ms / 1000, 3),
            "boot": self.rig.identity.boot,
            "counter": self.rig.state.exposures,
            "card": [file.name for file in card],
            "subject": subject,
        }
        self.journal.append(intent)
        self.brackets.append(JournalBracket(intent))
        return self.brackets[-1], {}

    def _may_complete(self, intent: Record, want: Wanted, pose: Sequence[int], photodiode: int) -> bool:
        """Return whether pose and lamp allow a bracket to be completed as if it had been taken at once."""
        return (
            (intent["group"], intent["shot"]) == (want.group, want.shot.shot)
            and (intent["revision"], intent["setup"]) == (want.revision, want.setup)
            and max(abs(a - b) for a, b in zip(intent["pose"], pose, strict=True)) <= ON_TARGET_MDEG
            and abs(photodiode - intent["photodiode"]) <= LAMP_SAME * intent["photodiode"]
        )

    def _supersede(self, want: Wanted) -> None:
        """Move older frames of the same name to the folder ``superseded``."""
        for number, bracket in enumerate(self.brackets):
            intent = bracket.intent
            same = (intent["group"], intent["shot"], intent["revision"])
            if bracket.complete and same == (want.group, want.shot.shot, want.revision):
                files = [frame["file"] for frame in bracket.frames.values()]
                set_aside(self.root, files, self.root / "superseded" / str(number))
                self.journal.append({"t": "superseded", "intent": number, "files": files})
                bracket.void = True

    def _note_light(self, bracket: JournalBracket, seconds: float) -> None:
        """Keep the light that the sample had, in the journal."""
        dose = Dose(seconds, seconds * (self.lighting.lux or 0.0))
        number = self.brackets.index(bracket)
        self.journal.append(
            {"t": "dose", "intent": number, "open_s": round(dose.open_s, 3), "lux_s": round(dose.lux_s, 1)}
        )

    def _record(self, bracket: JournalBracket, frames: dict[int, Fetched], photodiode: int, how: str) -> None:
        """Give the frames of a bracket their names, record them, and only then delete them on the card."""
        intent = bracket.intent
        folder = self.root / "frames" / intent["group"]
        places = sorted(frames)
        targets = [folder / f"{intent['shot']}_e{k}_r{intent['revision']}{self.camera.suffix}" for k in places]
        landed = land(self.root, [frames[k] for k in places], targets)
        number = len(self.brackets) - 1
        taken = {k: frame.facts.taken if frame.facts else 0.0 for k, frame in frames.items()}
        records: list[Record] = [
            {"t": "frame", "intent": number, "k": k, "exposure": intent["exposures"][k], "file": file.file,
             "sha256": file.sha256, "bytes": file.bytes, "name": frames[k].source.name, "photodiode": photodiode,
             "how": how, "taken": taken[k]}
            for k, file in zip(places, landed, strict=True)
        ]  # fmt: skip
        keep_sidecar(self.root, number, self.journal.records, intent, records)
        self.journal.append(*records)
        bracket.frames = {record["k"]: record for record in records}
        self._newest = max(self._newest, *taken.values())
        self.tell(frame=(records[0]["file"], records[0]["exposure"]))
        for k in places:
            self.camera.delete(frames[k].source.name)

    def _quarantine(self, frames: Sequence[Fetched], reason: str, void: bool = True) -> None:
        """Put copies aside that are not to be used; with `void` the bracket under way becomes invalid."""
        landed = quarantine(self.root, frames) if frames else []
        files = [
            {"name": frame.source.name, "file": each.file, "sha256": each.sha256}
            for frame, each in zip(frames, landed, strict=True)
        ]
        number = len(self.brackets) - 1 if void and self.brackets else None
        self.journal.append({"t": "quarantined", "intent": number, "reason": reason, "files": files})
        if number is not None:
            self.brackets[number].void = True
        for frame in frames:
            self.camera.delete(frame.source.name)
        log.info("capture: quarantined %s: %s", ", ".join(frame.source.name for frame in frames) or "nothing", reason)


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
