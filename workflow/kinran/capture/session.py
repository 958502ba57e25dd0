"""A session of shooting, which can be killed at any moment without losing or repeating a bracket.

For each bracket: intent, sync; exposures; copies, sync; rename, sync the folder; frame records, sync; only
then are the files deleted on the card. The journal alone says what is done (docs/rig.md has the resume rule).
"""

import errno
import logging
import shutil
import time
from collections.abc import Sequence
from pathlib import Path

from kinran.base.files import InputError
from kinran.capture.arms import go
from kinran.capture.brackets_taken import JournalBracket, Wanted, missing, read_brackets
from kinran.capture.journal import Journal, Record
from kinran.capture.store import digest_on_card, land, quarantine, remove_parts, set_aside
from kinran.data.capture_plan import Plan
from kinran.rig.camera import Camera, CameraError
from kinran.rig.errors import RebootedError, RigError
from kinran.rig.goniometer import ALL_AXES, Goniometer, check_fault, check_pose, confirm_shutter, wait_warm
from kinran.rig.motion import ON_TARGET_MDEG, mdeg

TRIES = 2
"""Times that a bracket, or a missed exposure, is taken before the session stops (docs/rig.md, Resume)."""
RESTARTS = 3
"""Restarts of the rig after which a session goes on: a choice; a rig that restarts more often needs a person."""
LAMP_LEAVES, LAMP_RETURNS = 0.03, 0.02
"""Relative drift of the lamp at which shooting pauses, and at which it goes on: several times the simulated lamp's
breathing of 0.6 %. Monitors correct smaller drifts. No measurement of a real lamp stands behind these numbers."""
LAMP_WAIT_S = 600.0
"""Longest pause for the lamp in seconds: a choice; a lamp that has drifted for ten minutes needs a person."""
LAMP_SAME = 0.01
"""Relative change of the lamp within which a bracket may be completed later: under `LAMP_RETURNS`. No measurement
stands behind it."""
FRAME_LIMIT_S = 60.0
"""Seconds of open shutter for a frame besides its exposure, after which the rig closes the shutter by itself."""
LONG_S = 1.0
"""Exposure time in seconds above which the watchdog of a dead host may close the shutter under an exposure."""

SUBJECTS = dict.fromkeys(("light", "monitor", "view"), "fabric") | {"dark": "dark", "white": "white", "chart": "chart"}
"""Subject before the lens for each kind of shot."""

log = logging.getLogger(__name__)


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
    """

    def __init__(self, plan: Plan, root: Path, journal: Journal, rig: Goniometer, camera: Camera, device: str) -> None:
        self.plan, self.root, self.journal = plan, root, journal
        self.rig, self.camera, self.device = rig, camera, device
        self.brackets = read_brackets(journal.records)
        self._started = sum(record["t"] == "session" for record in journal.records)
        self._kept: list[str] = []
        self._reference = 0
        self._subject = ""

    def run(self, group: str, wanted: Sequence[Wanted]) -> None:
        """Shoot the missing shots of a group.

        Raises
        ------
        RigError, CameraError
            A device failed; the session can be run again when the cause is gone.
        InputError
            The disk is full, or has too little space.
        """
        try:
            self._run(group, wanted)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            raise InputError(
                f"{self.root}: the disk is full; free some space and run the capture again:"
                " the frames are still on the card"
            ) from None

    def _run(self, group: str, wanted: Sequence[Wanted]) -> None:
        remove_parts(self.root)
        self._meet(group)
        todo = missing(self.brackets, wanted, self.root)
        if not todo:
            return
        self._check_disk(len(todo))
        for shot in (shot for each in self.plan.groups for shot in each.shots):
            check_pose(self.rig.identity, (mdeg(shot.theta), mdeg(shot.phi)))  # all poses, before the lamp is lit
        self._prepare()
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
            if done == 1:
                self._check_disk(len(todo))
            if done % 8 == 0 or not todo:
                left = (time.monotonic() - began) / done * len(todo)
                log.info("capture %s: %d of %d shots, %s left", group, done, done + len(todo), _duration(left))
        self.journal.append({"t": "complete", "group": group, "plan": self.plan.sha256})

    # -- meeting the devices -------------------------------------------------------------------------

    def _meet(self, group: str) -> None:
        """Greet the rig, and settle the frames that an earlier session left on the card."""
        self.rig.hello()
        self.journal.append(
            {"t": "session", "session": self._started, "plan": self.plan.sha256, "group": group,
             "device": self.device, "serial": self.rig.identity.serial, "boot": self.rig.identity.boot}
        )  # fmt: skip
        self._started += 1
        self._subject = ""
        self._kept = []
        self._tidy_card()
        self._settle()
        check_fault(self.rig.state)

    def _tidy_card(self) -> None:
        """Delete recorded frames on the card: a session was killed before it deleted them."""
        recorded: dict[str, set[str]] = {}
        whole = [bracket for bracket in self.brackets if bracket.recorded]  # its records may be torn, too
        entries = [frame for bracket in whole for frame in bracket.frames.values()]
        for record in self.journal.records:
            if record["t"] == "quarantined":
                entries += record["files"]
        for entry in entries:
            recorded.setdefault(entry["name"], set()).add(entry["sha256"])
        for name in self.camera.card():
            if name in recorded and digest_on_card(self.camera, self.root, name) in recorded[name]:
                self.camera.delete(name)

    def _settle(self) -> None:
        """Adopt the frames of the bracket that was under way, keep them for its completion, or quarantine them."""
        if not self.brackets or self.brackets[-1].complete or self.brackets[-1].void:
            return
        bracket = self.brackets[-1]
        found = [name for name in self.camera.card() if name not in bracket.intent["card"]]
        if not found:
            return
        exposures: list[float] = bracket.intent["exposures"]
        same_boot = bracket.intent["boot"] == self.rig.identity.boot
        counted = self._counted(bracket, len(found)) if same_boot else len(found)
        if self.rig.state.fault or max(exposures) > LONG_S:
            self._quarantine(found, "the shutter may have closed under an exposure")
        elif len(found) == len(exposures) == counted:
            self._record(bracket, found, bracket.intent["photodiode"], "adopted")
            log.info("capture %s: adopted %d frames from the card", bracket.intent["shot"], len(found))
        elif same_boot and len(found) < len(exposures) and len(found) == counted:
            self._kept = found
        else:
            self._quarantine(found, "not the bracket that was under way")

    def _counted(self, bracket: JournalBracket, unknown: int) -> int:
        """Return the X-sync edges since the intent; `unknown` where the rig does not count them."""
        if not self.rig.identity.x_sync:
            return unknown
        return self.rig.state.exposures - int(bracket.intent["counter"])

    def _prepare(self) -> None:
        """Home the rig if it does not know its pose, and wait for a warm lamp."""
        if self.rig.state.homed != ALL_AXES:
            self.rig.home()
        self.rig.lamp(True)
        wait_warm(self.rig)
        self._reference = self.rig.intensity()

    def _check_disk(self, brackets: int) -> None:
        """Check that the disk has room for so many brackets.

        Raises
        ------
        InputError
            The disk has too little space.
        """
        largest = max((record["bytes"] for record in self.journal.records if record["t"] == "frame"), default=0)
        need = brackets * len(self.plan.exposures_s) * largest * 1.1
        free = shutil.disk_usage(self.root).free
        if need > free:
            raise InputError(
                f"{self.root}: {brackets} brackets need {need / 1e6:.0f} MB and {free / 1e6:.0f} MB are free;"
                " free some space and run the capture again"
            )

    # -- one bracket ---------------------------------------------------------------------------------

    def _shoot(self, want: Wanted) -> None:
        for attempt in range(TRIES):
            bracket, names = self._open(want)
            try:
                self._expose(bracket, names)
            except RigError as error:  # the light of the last frames is unknown
                card = bracket.intent["card"]
                self._quarantine([name for name in self.camera.card() if name not in card], str(error))
                raise
            steady = self._steady(want, self.rig.state.photodiode)
            if steady and self._counted(bracket, len(names)) >= len(names):
                self._record(bracket, names, self.rig.state.photodiode, "shot")
                return
            self._quarantine(names, "X-sync missing" if steady else "lamp drifted")
            if not steady:
                self._wait_for_lamp()
            elif attempt:
                raise CameraError("the rig does not see the camera's X-sync; check the cable between them")
        raise RigError("the lamp does not hold steady; check it, then run the capture again")

    def _open(self, want: Wanted) -> tuple[JournalBracket, list[str]]:
        """Move to the shot's pose and write its intent, or go on with the bracket that was under way."""
        subject = SUBJECTS[want.shot.kind]
        if subject != self._subject:
            self.camera.place(subject)
            self._subject = subject
        pose = go(self.rig, want.shot, mdeg(self.plan.backlash))
        photodiode = self.rig.intensity()
        if not self._steady(want, photodiode):
            self._wait_for_lamp()
            photodiode = self.rig.intensity()
        kept, self._kept = self._kept, []
        if kept and self._may_complete(self.brackets[-1].intent, want, pose, photodiode):
            return self.brackets[-1], kept
        if kept:
            self._quarantine(kept, "its bracket cannot be completed")
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
            "card": self.camera.card(),
        }
        self.journal.append(intent)
        self.brackets.append(JournalBracket(intent))
        return self.brackets[-1], []

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

    def _expose(self, bracket: JournalBracket, names: list[str]) -> None:
        """Take the exposures that `names` lacks, under an open shutter unless the shot is a dark one.

        Raises
        ------
        RigError
            The rig is disconnected or has a fault, or its shutter closed: the frames may be dark.
        """
        exposures: list[float] = bracket.intent["exposures"]
        seen = set(self.camera.card())
        lit = self._subject != "dark"
        if lit:
            self.rig.shutter(True, sum(exposures) + FRAME_LIMIT_S * len(exposures))
        for seconds in exposures[len(names) :]:
            names.append(self._expose_once(seconds, seen))
            confirm_shutter(self.rig, lit)
        if lit:
            self.rig.shutter(False)

    def _expose_once(self, seconds: float, seen: set[str]) -> str:
        """Take one frame and return its name; try again where none lands, or several do, which are quarantined."""
        problem = "no frame landed on the card"
        for _ in range(TRIES):
            try:
                self.camera.expose(seconds)
            except CameraError as error:
                problem = str(error)
            new = [name for name in self.camera.card() if name not in seen]
            seen.update(new)
            if len(new) == 1:
                return new[0]
            if new:
                self._quarantine(new, "surplus on the card", void=False)
        raise CameraError(
            f"the camera missed an exposure of {seconds:g} s twice ({problem}); check it, then run the capture again"
        )

    def _record(self, bracket: JournalBracket, names: list[str], photodiode: int, how: str) -> None:
        """Copy the frames to disk, record them, and only then delete them on the card."""
        intent = bracket.intent
        stem = f"{intent['shot']}_e{{k}}_r{intent['revision']}{self.camera.suffix}"
        folder = self.root / "frames" / intent["group"]
        targets = [folder / stem.format(k=k) for k in range(len(names))]
        landed = land(self.camera, self.root, names, targets)
        number = len(self.brackets) - 1
        records: list[Record] = [
            {"t": "frame", "intent": number, "k": k, "exposure": intent["exposures"][k], "file": frame.file,
             "sha256": frame.sha256, "bytes": frame.bytes, "name": name, "photodiode": photodiode, "how": how}
            for k, (name, frame) in enumerate(zip(names, landed, strict=True))
        ]  # fmt: skip
        self.journal.append(*records)
        bracket.frames = {record["k"]: record for record in records}
        for name in names:
            self.camera.delete(name)

    def _quarantine(self, names: list[str], reason: str, void: bool = True) -> None:
        """Copy files aside that are not to be used; with `void` the bracket under way becomes invalid."""
        landed = quarantine(self.camera, self.root, names) if names else []
        files = [
            {"name": name, "file": each.file, "sha256": each.sha256} for name, each in zip(names, landed, strict=True)
        ]
        number = len(self.brackets) - 1 if void and self.brackets else None
        self.journal.append({"t": "quarantined", "intent": number, "reason": reason, "files": files})
        if number is not None:
            self.brackets[number].void = True
        for name in names:
            self.camera.delete(name)
        log.info("capture: quarantined %s: %s", ", ".join(names), reason)

    # -- lamp ----------------------------------------------------------------------------------------

    def _steady(self, want: Wanted, photodiode: int) -> bool:
        if want.shot.kind == "dark":
            return True
        return abs(photodiode - self._reference) <= LAMP_LEAVES * self._reference

    def _wait_for_lamp(self) -> None:
        """Pause until the lamp is back at its level of the start of the session.

        Raises
        ------
        RigError
            The lamp does not come back in `LAMP_WAIT_S`.
        """
        self.journal.append({"t": "pause", "reason": "lamp", "photodiode": self.rig.state.photodiode})
        log.info("capture: the lamp drifted; waiting for it")
        for _ in range(int(LAMP_WAIT_S / 10)):
            self.rig.wait(10.0)
            if abs(self.rig.intensity() - self._reference) <= LAMP_RETURNS * self._reference:
                return
        raise RigError(
            f"the lamp stays more than {LAMP_RETURNS:.0%} off its level for {LAMP_WAIT_S / 60:g} minutes;"
            " check it, then run the capture again"
        )


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"
