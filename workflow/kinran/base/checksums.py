"""Checksums inside files: a flipped bit is an error that names the file, and never another value.

All are CRC-32, which tells every flipped bit and every burst of up to 32 bits from sound data. It is the one of
zlib, which Python has and the compiled plugin can compute in a few lines.

* JSON has no comments, and others read its keys; so its last line is white space: 32 blanks and tabs, which are the
  bits of the checksum of all lines before.
* A PLY, XML or HTML file has a comment ``kinran:crc32 1a2b3c4d``: the checksum of all its other lines.
* An EXR has the attribute ``kinran:crc32`` (`kinran.base.exr`).

A file without a checksum was written by hand or by another program, and is read as it is.
"""

import re
import zlib

JSON_LINE = re.compile(rb"\n([ \t]{32})\n\Z")
"""Last line of a JSON file that has a checksum."""
MARK = b"kinran:crc32 "
"""What stands before the eight hexadecimal digits of a checksum in a comment."""


def json_line(body: bytes) -> bytes:
    """Return the last line of a JSON file, the checksum of `body`, which are all lines before it."""
    return f"{zlib.crc32(body):032b}\n".encode().translate(bytes.maketrans(b"01", b" \t"))


def json_damaged(data: bytes) -> bool:
    """Return whether the bytes of a JSON file contradict their checksum; never where they have none."""
    line = JSON_LINE.search(data)
    return line is not None and json_line(data[: line.start(1)]) != data[line.start(1) :]


def comment(*bodies: bytes) -> str:
    """Return the text of the comment for a file that consists, beside its line, of these parts."""
    checksum = 0
    for body in bodies:
        checksum = zlib.crc32(body, checksum)
    return f"kinran:crc32 {checksum:08x}"


def comment_damaged(data: bytes) -> bool:
    """Return whether the bytes of a file contradict the checksum in a comment; never where they have none."""
    mark = data.find(MARK)
    if mark < 0:
        return False
    first, last = data.rfind(b"\n", 0, mark) + 1, data.find(b"\n", mark) + 1 or len(data)
    return comment(data[:first], data[last:]).encode() != data[mark : mark + len(MARK) + 8]
