"""What the jobs of a fabric ask of a machine: threads, memory and time, from its texels and its lights.

A scheduler kills what takes more than it asked for, and leaves waiting what asks for too much. So the costs of a stage
are those that were measured, with a margin, and a job that failed asks for more at its next attempt.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError
from kinran.run.fabrics import FabricRow

CAMERA_TEXELS = 2_500_000
"""Texels of a fabric on a real rig before its first frame: superpixels of 10.1 megapixels, as in Takeda2008, §4."""
MARGIN = 1.5
"""Memory and time that are asked for, over those measured. A choice: the costs were fitted to within a third."""
SHELL_MB = 350
"""Memory of what runs a stage on a node, a shell and two Snakemakes, in megabytes: measured as 2 × 165."""
SLOWER = 4
"""Time that is asked for, over that of an idle core, for cores that are slower or shared, and slow disks. A choice."""
LEAST_MINUTES = 10
"""Shortest time that a job asks for: the start of Snakemake and of a stage on a cold file system. A choice."""
MOST_THREADS = 8
"""Most threads of a stage: more hardly speed up stages of a minute, and wait longer for a free node. A choice."""
VIRTUAL_S, VIRTUAL_SHOT_S, VIRTUAL_RAYS_S = 5, 0.1, 1.3
"""CPU seconds of a group on the virtual rig: of its start, of a light, and of a million of its rays (texels × samples).
From the demo, 64 lights of 0.2 million in 29 s, and the tiny fabric of `.test`, 17 of 0.002 in 7."""
SHOT_S = 10
"""Seconds of a light on a real rig before there is a plan, which says more exactly. A choice."""
WHOLE_MACHINE = 1024
"""Threads of a job that wants the machine for itself: Snakemake cuts them to the cores that it was given."""


@dataclass(frozen=True)
class Size:
    """What the cost of a fabric depends on.

    Attributes
    ----------
    texels
        Texels of its maps.
    lights
        Different light directions.
    """

    texels: int
    lights: int


@dataclass(frozen=True)
class Cost:
    """Cost of a job of a stage, on one core.

    Attributes
    ----------
    mb, mb_texels, mb_lights
        Megabytes at the peak: a constant, a part for each million texels, and one for each light.
    seconds, s_texels, s_samples
        CPU seconds: a constant, a part for each million texels, and one for each million samples (texels × lights).
    threaded
        Whether the stage shares its work among threads.
    """

    mb: float
    mb_texels: float = 0
    mb_lights: float = 0
    seconds: float = 5
    s_texels: float = 0
    s_samples: float = 0
    threaded: bool = False

    def memory(self, size: Size) -> float:
        """Megabytes at the peak."""
        return self.mb + self.mb_texels * size.texels * 1e-6 + self.mb_lights * size.lights

    def time(self, size: Size) -> float:
        """CPU seconds."""
        return self.seconds + (self.s_texels + self.s_samples * size.lights) * size.texels * 1e-6


COSTS = {
    "plan": Cost(80, seconds=1),
    "ingest": Cost(80, 36),
    "ingest_group": Cost(80),
    "calibrate": Cost(240, 320),
    "merge": Cost(260, 140, 0, 5, 35),
    "stack": Cost(250),
    "segment": Cost(180, 330, 0.3, 5, 0, 0.15),
    "coarsen": Cost(260, 160, 0.2, 5, 0, 0.3),
    "choice": Cost(300, 0, 0.5, 120, threaded=True),
    "prior": Cost(230, 40, 0.35, 10, threaded=True),
    "fit": Cost(180, 90, 0.35, 5, 130, 0.15),
    "material": Cost(180, 420, 0, 2, 21),
    "residual": Cost(300, 720, 0.4, 15, 8, 0.2, threaded=True),
    "sigma": Cost(250, 370, 0.4, 5, 14, 0.3, threaded=True),
    "choose": Cost(10, seconds=0),
    "evaluate": Cost(250, 480, 0.1, 5, 5, 0.2),
    "scan": Cost(100),
    "mesh": Cost(260),
    "own_mesh": Cost(10, seconds=0),
    "need": Cost(180, seconds=3),
    "need_to_fit": Cost(180, seconds=3),
    "scene": Cost(150, 260, 0, 2, 2.5),
    "render": Cost(250, 1080, 0, 40, 8, threaded=True),
    "report": Cost(400, 400, 0, 5, 10),
    "overview": Cost(100, seconds=1),
    "chart_kind": Cost(1500, 0, 1, 200),
    "chart_default": Cost(1500, 0, 1, 200),
    "chart_regions": Cost(600, 200, 0, 60),
}
"""Costs of the jobs of each stage, from the peak of resident memory and the CPU time of its process (getrusage), for
photographs of 65,536 texels × 48 lights, 1,048,576 × 12, 1,500,000 × 60, 6,000,000 × 60 and RAW brackets of
2,519,424 × 16 (`kinran bench size`), and 16,384 × 192, for the demo, and for a strip of 65,536 × 1,153 lights. Those
of `merge` hold for 64 lights of five RAW frames each (`kinran bench merge`), those of `fit` for all jobs of the
slope model with two lobes, and those of `render` for a material with a residual. `coarsen`, `choice` and the chart
were not measured on large fabrics: theirs are guesses on the safe side."""


def size_of(fabric: FabricRow, captures: Path = Path("captures")) -> Size:
    """Size of a fabric: from the virtual fabric, its crop, or the header of one frame."""
    return Size(_texels(fabric, captures), fabric.lights)


def _texels(fabric: FabricRow, captures: Path) -> int:
    if fabric.folder is None and fabric.settings["rig"]["device"] == "virtual":
        return int(fabric.settings["virtual"]["texels"]) ** 2
    whole = _photographed(fabric, captures)
    return min(whole, int(fabric.max_mp * 1e6)) if fabric.max_mp else whole


def _photographed(fabric: FabricRow, captures: Path) -> int:
    if fabric.crop:
        return math.prod(int(part) for part in fabric.crop.split(",")[2:])
    frame = _frame(fabric, captures)
    if frame is None:
        return CAMERA_TEXELS
    from kinran.data import photographs  # it imports what reads images, which no other row needs

    try:
        return math.prod(photographs.size(frame))
    except InputError:
        return CAMERA_TEXELS  # the job that reads it will say what is wrong with it


def _frame(fabric: FabricRow, captures: Path) -> Path | None:
    """Return a frame of a fabric: of its photographs, or of what was captured."""
    if fabric.folder is not None:
        from kinran.data import light_files, photographs

        try:
            frames = photographs.find_frames(fabric.folder, light_files.find_lights(fabric.folder, fabric.lp).lights)
        except InputError:
            return None
        return next(iter(frames.values()))[0]
    for manifest in sorted((captures / fabric.name / "groups").glob("[0-9]*.json")):
        try:
            return captures / fabric.name / str(json.loads(manifest.read_bytes())["shots"][0]["frames"][0]["file"])
        except (OSError, ValueError, LookupError):
            continue
    return None


def seconds(stage: str, size: Size, threads: int, jobs: int = 1) -> float:
    """Predicted time of a job, of which so many share the work of a stage, on idle cores."""
    cost = COSTS[stage]
    return cost.time(size) / (threads if cost.threaded else 1) / jobs


def capture_seconds(fabric: FabricRow, group: str, threads: int, captures: Path = Path("captures")) -> float:
    """Predicted time of a capture's group: of the virtual camera, whose cost was measured, or as the plan has it."""
    lights = fabric.lights / len(fabric.light_groups) if group in fabric.light_groups else 0
    if fabric.settings["rig"]["device"] == "virtual":
        rays = int(fabric.settings["virtual"]["texels"]) ** 2 * int(fabric.settings["virtual"]["samples"]) * 1e-6
        return (VIRTUAL_S + lights * (VIRTUAL_SHOT_S + VIRTUAL_RAYS_S * rays)) / min(threads, 2)
    try:
        return float(json.loads((captures / fabric.name / "plan.json").read_bytes())["duration_s"]) / len(
            fabric.all_groups
        )
    except (OSError, ValueError, LookupError):
        return lights * SHOT_S


def threads(stage: str, size: Size) -> int:
    """Threads of a job: 2 where its stage uses them, and one more for each minute of work."""
    cost = COSTS[stage]
    return min(MOST_THREADS, 2 + int(cost.time(size) / 60)) if cost.threaded else 1


def memory_mb(stage: str, size: Size, attempt: int = 1) -> int:
    """Megabytes that a job asks for: half as much again at each new attempt."""
    asked = (COSTS[stage].memory(size) * MARGIN + SHELL_MB) * (1 + 0.5 * (attempt - 1))
    return 100 * math.ceil(asked / 100)


def minutes(stage: str, size: Size, attempt: int = 1, threads: int = 1) -> int:
    """Minutes that a job asks for: as many again at each new attempt."""
    return attempt * math.ceil(LEAST_MINUTES + COSTS[stage].time(size) * MARGIN * SLOWER / threads / 60)
