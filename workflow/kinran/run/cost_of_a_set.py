"""What a set of photographs will cost, said before its run, and how to have it cheaper."""

import math

from kinran.capture.photograph_set import Known, PhotographSet, averaged
from kinran.data.capture_plan import LIST_GROUP
from kinran.data.photographs import parse_crop
from kinran.run.resources import COSTS, Size

ONCE = ("calibrate", "stack", "segment", "need", "prior", "fit", "material", "residual", "sigma", "evaluate", "scan",
        "mesh", "scene", "render", "report")  # fmt: skip
"""Stages of a set of photographs, beside its merges."""
OTHER_MODELS_S = 25.0
"""CPU seconds of the models beside the slope model, for a million texels under 60 lights. A guess:
under the 337 of virtual fabrics they took 41."""
JOB_S, JOBS = 1.0, 30
"""CPU seconds of Snakemake and shells for a job, and the jobs of a small set: 19 s were measured for 60 lights."""
STACK_BYTES = 5.1
"""Bytes that a stack has for a texel and a light: of a strip of the virtual rig, whose noise compresses badly."""
MATERIAL_BYTES = 500
"""Bytes that materials, maps of deviations and pages have for a texel: 194 of them are the material with a residual of
16 components, as measured for a megapixel."""
LONG_S = 3600.0
"""CPU seconds from which there is a proposal: an hour."""


def predicted(found: PhotographSet, known: Known) -> list[str]:
    """Return sentences on the time, memory and disk that a set takes, and on what takes less if that is long."""
    part = parse_crop(known.crop)
    width, height = (part.width, part.height) if part else found.size
    pixels, lights = width * height, len(found.lights)
    average = averaged(part, found.size, known.max_mp)
    seconds, megabytes, disk = _cost(pixels, average, lights)
    said = [
        f"{lights} lights of {pixels * 1e-6:.3g} megapixels: about {_in_words(seconds)} of CPU time, {_size(megabytes)}"
        f" of memory and {_size(disk)} of disk"
        + (f"; {average} × {average} pixels make a texel" if average > 1 else "")
    ]
    if seconds > LONG_S:
        least = next((k for k in range(average + 1, 100) if _cost(pixels, k, lights)[0] <= LONG_S), 100)
        cheaper = _cost(pixels, least, lights)
        said.append(
            f"that is long: --max-mp {_ceil(pixels * 1e-6 / least**2)} takes about {_in_words(cheaper[0])} and"
            f" {_size(cheaper[1])}, and --crop X,Y,W,H of the part that matters its share"
        )
    return said


def _cost(pixels: int, average: int, lights: int) -> tuple[float, float, float]:
    """Return CPU seconds, megabytes of memory and megabytes of disk."""
    whole, size = Size(pixels, lights), Size(pixels // average**2, lights)
    groups = -(-lights // LIST_GROUP)
    seconds = sum(COSTS[stage].time(size) for stage in ONCE) + groups * COSTS["merge"].time(whole) + JOB_S * JOBS
    seconds += OTHER_MODELS_S * size.texels * 1e-6
    memory = max(COSTS["merge"].memory(whole), *(COSTS[stage].memory(size) for stage in ONCE))
    return seconds, memory, size.texels * (STACK_BYTES * lights + MATERIAL_BYTES) * 1e-6


def _ceil(megapixels: float) -> str:
    """Return megapixels rounded up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(megapixels)) - 1)
    return f"{math.ceil(megapixels / unit - 1e-9) * unit:g}"


def _in_words(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds < LONG_S else f"{seconds / LONG_S:.1f} h"


def _size(megabytes: float) -> str:
    return f"{megabytes:.0f} MB" if megabytes < 1000 else f"{megabytes * 1e-3:.1f} GB"
