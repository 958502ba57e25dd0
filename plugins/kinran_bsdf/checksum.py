"""Checksum of a material file: an attribute of its header that tells flipped bits in the maps and in what they mean.

`kinran:crc32` is JSON. For each channel it has the CRC-32 (that of zlib) of the channel's size as text, ``"HEIGHT
WIDTH"`` and a line end, followed by its float32 values, little-endian and row by row. Under ``kinran:`` it has the
CRC-32 of all other attributes of that prefix that are text, each as a line ``NAME=VALUE``, in the order of their names.
"""

import json
import zlib
from collections.abc import Mapping

import numpy as np

from kinran_bsdf.arrays import Map

NAME = "kinran:crc32"
"""Attribute with the checksums."""
ROWS = 16
"""Rows that are looked at together: channels that are views of the same pixels then stay in the processor's cache,
which takes a third of the time (of 26 channels of 960 × 960)."""
PREFIX = "kinran:"
"""Prefix of the attributes that have a checksum, and the key of their checksum."""


def checksums(attributes: Mapping[str, str], channels: Mapping[str, Map]) -> dict[str, str]:
    """Return the checksums of a file's attributes, which begin with `PREFIX`, and of its channels (y, x), by name."""
    lines = [f"{name}={attributes[name]}\n" for name in sorted(attributes) if name != NAME]
    found = {PREFIX: zlib.crc32("".join(lines).encode())}
    for name in sorted(channels):
        found[name] = zlib.crc32("{} {}\n".format(*channels[name].shape).encode())
    for first in range(0, max((len(plane) for plane in channels.values()), default=0), ROWS):
        for name, plane in channels.items():
            found[name] = zlib.crc32(np.ascontiguousarray(plane[first : first + ROWS], "<f4").data, found[name])
    return {name: f"{checksum:08x}" for name, checksum in found.items()}


def damaged(attributes: Mapping[str, str], channels: Mapping[str, Map]) -> str:
    """Return what contradicts the checksums among the attributes: "channel 'label'", or empty where all is sound.

    Without the attribute `NAME`, nothing does.
    """
    if NAME not in attributes:
        return ""
    try:
        stated = json.loads(attributes[NAME])
        found = checksums(attributes, channels)
        wrong = [name for name in {**found, **stated} if stated.get(name) != found.get(name)]
    except (ValueError, TypeError, AttributeError):
        return f"attribute {NAME}"
    return "" if not wrong else "a kinran: attribute" if wrong[0] == PREFIX else f"channel '{wrong[0]}'"
