"""What a scene's template says, apart from comments and layout: what its jobs depend on, before any of them runs.

The number of samples a pixel changes the picture alone. So it is read apart from all else, and `kinran render` is told
it. It stands apart where it is one whole number in one place: ``<integer name="sample_count" value="16"/>`` of an
``independent`` or ``multijitter`` sampler, or there the name of a default that is used for nothing else. Multijitter
rounds up what makes no grid, such as 32 to 35, on reading and on rendering alike. Other samplers round to numbers of
their own; so there, as in every other case, the number of samples counts with the rest.
"""

import hashlib
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from kinran.base.digest import digest


@dataclass(frozen=True)
class Template:
    """What jobs depend on of a template.

    Attributes
    ----------
    digest
        Twelve hexadecimal digits of all but comments, layout and `samples`.
    samples
        Samples a pixel; None where they do not stand apart.
    """

    digest: str
    samples: int | None


@cache
def read_template(path: Path) -> Template:
    """Read a template; of one that is no XML, which the jobs will say, all bytes count.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    data = path.read_bytes()
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, UnicodeDecodeError, LookupError):
        return Template(_short(data), None)
    samples = None
    if (holder := _holder(root)) is not None:
        samples = int(holder.attrib["value"])
        holder.set("value", "")
    text = ET.canonicalize(ET.tostring(root, encoding="unicode"), strip_text=True)
    return Template(_short(text.encode()), samples)


def need_key(path: Path) -> str:
    """Return what `kinran need` notes of a template, and of the code that asked: the same key, the same question.

    Raises
    ------
    OSError
        The template cannot be read.
    """
    return f"{read_template(path).digest} {digest('kinran.scene.need')}"


def _holder(root: ET.Element) -> ET.Element | None:
    """Return the element whose value is the number of samples and nothing else; None where there is none."""
    counts = [(of, count) for of in root.iter() for count in of.iterfind("integer[@name='sample_count']")]
    if len(counts) != 1 or root.find(".//include") is not None:
        return None
    (sampler, holder), words = counts[0], [value for element in root.iter() for value in element.attrib.values()]
    if sampler.tag != "sampler" or sampler.get("type") not in ("independent", "multijitter"):
        return None
    if (word := holder.get("value", "")).startswith("$"):
        named = root.findall(f"default[@name='{word[1:]}']") if word[1:].isidentifier() else []
        if len(named) != 1 or sum(word in value for value in words) != 1:
            return None
        holder = named[0]
    value = holder.get("value", "").strip()
    return holder if value.isdecimal() and int(value) > 0 else None


def _short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:12]
