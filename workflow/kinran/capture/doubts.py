"""What a set's photographs say against what is assumed of them: sentences, each with the number that speaks."""

from pathlib import Path

from kinran.base.encoding import parse
from kinran.capture import axes_evidence, encoding_evidence
from kinran.capture.encoding_evidence import LIGHTS, LOUD
from kinran.capture.photograph_set import PhotographSet
from kinran.capture.sampled_set import sample
from kinran.data.capture_plan import Plan
from kinran.data.file_statements import statements
from kinran.data.picture_file import read_picture
from kinran.data.picture_kind import is_raw, kind_of

LOSSLESS = ("PNG", "TIFF", "BMP", "TGA", "JPEG 2000")
"""Kinds in which linear light is found, too: in lossy files of 8 bits it is not."""


def doubts(found: PhotographSet, plan: Plan) -> list[str]:
    """Return what the photographs say against their encoding and the axes of their lights.

    Parameters
    ----------
    found
        The set.
    plan
        Its plan.

    Raises
    ------
    InputError
        A photograph cannot be read.
    """
    frames = [found.frames[light.name] for light in plan.lights]
    said = _against_file(frames[0][0], plan.encoding or "srgb")
    if len(frames) >= LIGHTS:
        paths = [bracket[len(bracket) // 2] for bracket in frames]
        sampled = sample(plan, paths)
        encoding = parse("linear" if sampled.linear else plan.encoding or "srgb")
        said.append(axes_evidence.doubt(*axes_evidence.correlate(sampled, encoding)))
        if len(frames[0]) == 1 and not sampled.linear:  # a bracket tells its response by itself
            evidence = encoding_evidence.weigh(sampled)
            said.append(encoding_evidence.doubt(evidence, encoding) or _unknown(paths[0], evidence, encoding.name))
    return [sentence for sentence in said if sentence]


def _against_file(path: Path, encoding: str) -> list[str]:
    """Return a sentence where a file says that it is sRGB, and a user that it is not."""
    said = "" if encoding == "srgb" or is_raw(path) else statements(path).srgb
    return [f"--encoding {encoding}: is believed, but {path} says that it is sRGB ({said})"] if said else []


def _unknown(path: Path, evidence: encoding_evidence.Evidence | None, encoding: str) -> str:
    """Return a sentence where neither files nor photographs tell the encoding that is assumed."""
    silent = (
        encoding == "srgb" and kind_of(path) in LOSSLESS and not (statements(path).srgb or read_picture(path).profile)
    )
    if not silent or (evidence and evidence.ratio >= LOUD):
        return ""
    tell = f"{evidence}, and a shiny surface misleads" if evidence else "they have too few matt values to tell"
    return (
        f"{path}: does not say how its values encode light, and the photographs do not tell for sure: {tell}; they are"
        " taken as sRGB, so if they are linear, give --encoding linear"
    )
