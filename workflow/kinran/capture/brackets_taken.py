"""Brackets in the journal: those that were taken, with their frames, and the one that was under way."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kinran.base.files import sha256
from kinran.capture.journal import Record
from kinran.data.capture_plan import Group, Plan, Shot
from kinran.rig.motion import mdeg


@dataclass
class JournalBracket:
    """A bracket in the journal: an intent and its outcome.

    Attributes
    ----------
    intent
        Record of the intent.
    frames
        Records of the frames, by their place in the bracket.
    void
        Whether the frames were quarantined or superseded.
    """

    intent: Record
    frames: dict[int, Record] = field(default_factory=dict)
    void: bool = False

    @property
    def recorded(self) -> bool:
        """Whether all frames are recorded."""
        exposures: list[float] = self.intent["exposures"]
        return len(self.frames) == len(exposures)

    @property
    def complete(self) -> bool:
        """Whether all frames are recorded and valid."""
        return self.recorded and not self.void


@dataclass(frozen=True)
class Wanted:
    """A shot to be taken, with its revision and the digest of its set-up (`setup_digest`)."""

    group: str
    shot: Shot
    revision: int
    setup: str


def read_brackets(records: Iterable[Record]) -> list[JournalBracket]:
    """Return the brackets of a journal in the order of their intents."""
    brackets: list[JournalBracket] = []
    for record in records:
        match record["t"]:
            case "intent":
                brackets.append(JournalBracket(record))
            case "frame":
                brackets[record["intent"]].frames[record["k"]] = record
            case "quarantined" | "superseded" if record["intent"] is not None:
                brackets[record["intent"]].void = True
    return brackets


def setup_digest(plan: Plan, shot: Shot, device: Mapping[str, Any]) -> str:
    """Return the digest of a bracket's set-up: device, subject, pose and exposures."""
    parts = [dict(device), shot.kind, mdeg(shot.theta), mdeg(shot.phi), list(plan.exposures_s)]
    if shot.camera is not None:  # a camera on N leaves the digests as they were before it could move
        parts.append([mdeg(angle) for angle in shot.camera])
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def latest(brackets: Iterable[JournalBracket], group: str, shot: str) -> JournalBracket | None:
    """Return the newest complete bracket of a shot; None if there is none."""
    found = None
    for bracket in brackets:
        if bracket.complete and (bracket.intent["group"], bracket.intent["shot"]) == (group, shot):
            found = bracket
    return found


def missing(brackets: list[JournalBracket], wanted: Iterable[Wanted], root: Path) -> list[Wanted]:
    """Return the shots without a complete bracket of their set-up and revision, or whose files are gone or cut."""
    newest = {(bracket.intent["group"], bracket.intent["shot"]): bracket for bracket in brackets if bracket.complete}
    last = max((i for i, bracket in enumerate(brackets) if bracket.complete), default=None)
    if last is not None and not all(
        _whole(root, frame) and sha256(root / frame["file"]) == frame["sha256"]
        for frame in brackets[last].frames.values()
    ):
        newest.pop((brackets[last].intent["group"], brackets[last].intent["shot"]), None)
    todo = []
    for want in wanted:
        bracket = newest.get((want.group, want.shot.shot))
        if (
            bracket is None
            or bracket.intent["revision"] < want.revision
            or bracket.intent["setup"] != want.setup
            or not all(_whole(root, frame) for frame in bracket.frames.values())
        ):
            todo.append(want)
    return todo


def _whole(root: Path, frame: Record) -> bool:
    try:
        return bool((root / frame["file"]).stat().st_size == frame["bytes"])
    except FileNotFoundError:
        return False


def manifest(plan: Plan, group: Group, brackets: list[JournalBracket]) -> dict[str, Any]:
    """Return the manifest of a group, lights first, in the order of their indices."""
    shots = [_manifest_shot(shot, latest(brackets, group.name, shot.shot)) for shot in group.shots]
    shots.sort(key=lambda shot: len(plan.lights) if shot["light"] is None else shot["light"])
    return {
        "version": 1,
        "fabric": plan.fabric,
        "group": group.name,
        "plan_sha256": plan.sha256,
        "kind": plan.kind,
        "lights": list(group.lights),
        "shots": shots,
    }


def _manifest_shot(shot: Shot, bracket: JournalBracket | None) -> dict[str, Any]:
    if bracket is None:
        raise RuntimeError(f"{shot.shot} has no complete bracket")
    intent = bracket.intent
    frames = [bracket.frames[k] for k in range(len(bracket.frames))]
    return {
        "shot": shot.shot,
        "kind": shot.kind,
        "light": shot.light,
        "revision": intent["revision"],
        "session": intent["session"],
        "pose_mdeg": intent["pose"],
        "photodiode": frames[0]["photodiode"],
        "time_s": intent["time"],
        "frames": [
            {key: frame[key] for key in ("file", "sha256", "bytes")} | {"exposure_s": frame["exposure"]}
            for frame in frames
        ],
    }
