"""Use a group of photographs as shots of a capture: write its manifest; the files stay where they are."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from kinran.base.files import sha256, write_json
from kinran.capture.photograph_set import frame_seconds
from kinran.data import photographs
from kinran.data.capture_plan import read_plan
from kinran.data.light_files import find_lights
from kinran.data.picture_kind import is_raw


@dataclass(frozen=True)
class Inputs:
    folder: Annotated[Path, "folder of the photographs"]
    plan: Annotated[Path, "plan of the capture (.json)"]


@dataclass(frozen=True, kw_only=True)
class Options:
    group: Annotated[str, "its name"]
    lp: Annotated[Path | None, "--lp FILE", "lights, where no .lp lies beside the photographs"] = None


def main(inputs: Inputs, out: Annotated[Path, "OUT", "the group's manifest (.json)"], options: Options) -> None:
    """Write the manifest of a group."""
    write_json(out, manifest(inputs.plan, options.group, inputs.folder, options.lp))


def manifest(plan_file: Path, name: str, folder: Path, lp: Path | None = None) -> dict[str, Any]:
    """Return the manifest of a group: the paths of its photographs, with their digests.

    Raises
    ------
    InputError
        The plan or a photograph is missing, or a frame has no exposure time.
    """
    planned = read_plan(plan_file)
    group = planned.group(name)
    found = photographs.find_frames(folder, find_lights(folder, lp).lights)
    shots = []
    for shot in group.shots:
        paths = [path.resolve() for path in found[shot.shot]]
        alone = len(paths) == 1 and not is_raw(paths[0])
        seconds = [None] if alone else frame_seconds(paths)
        frames = [
            {"file": str(path), "sha256": sha256(path), "bytes": path.stat().st_size, "exposure_s": time}
            for path, time in zip(paths, seconds, strict=True)
        ]
        shots.append(
            {
                "shot": shot.shot,
                "kind": shot.kind,
                "light": shot.light,
                "revision": 0,
                "pose_mdeg": None,
                "photodiode": None,
                "time_s": None,
                "frames": frames,
            }
        )
    return {
        "version": 1,
        "fabric": planned.fabric,
        "group": name,
        "plan_sha256": planned.sha256,
        "kind": planned.kind,
        "lights": list(group.lights),
        "shots": shots,
    }
