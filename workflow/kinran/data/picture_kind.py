"""Kinds of picture files, told by their first bytes: suffixes are often wrong, and RAW files have many."""

import functools
from pathlib import Path

import tifffile

RAW = "RAW"
"""Kind of a file that LibRaw opens."""
READ = ("JPEG", "PNG", "TIFF", "EXR", "WebP", "BMP", "TGA", "JPEG 2000", RAW)
"""Kinds that are read."""
BEGINNINGS = (
    (0, b"\xff\xd8\xff", "JPEG"),
    (0, b"\x89PNG\r\n\x1a\n", "PNG"),
    (0, b"\x76\x2f\x31\x01", "EXR"),
    (8, b"WEBP", "WebP"),
    (0, b"BM", "BMP"),
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
    (0, b"\xff\x0a", "JPEG XL"),
    (4, b"ftypcrx", RAW),
    (4, b"ftypheic", "HEIC"),
    (4, b"ftypheix", "HEIC"),
    (4, b"ftypmif1", "HEIC"),
    (4, b"ftypavif", "AVIF"),
    (0, b"GIF8", "GIF"),
    (0, b"8BPS", "Photoshop"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (6, b"HEAPCCDR", RAW),
    (0, b"FUJIFILMCCD-RAW", RAW),
    (0, b"IIRO", RAW),
    (0, b"IIRS", RAW),
    (0, b"MMOR", RAW),
    (0, b"IIU\0", RAW),
    (0, b"FOVb", RAW),
    (0, b"\0MRM", RAW),
)
"""Where in a file which bytes tell its kind."""
SUFFIXES = {
    **dict.fromkeys((".jpg", ".jpeg", ".jpe", ".jfif"), "JPEG"),
    **dict.fromkeys((".tif", ".tiff"), "TIFF"),
    **dict.fromkeys((".jp2", ".j2k", ".jpf", ".jpx"), "JPEG 2000"),
    **{".png": "PNG", ".exr": "EXR", ".webp": "WebP", ".bmp": "BMP", ".tga": "TGA"},
    **dict.fromkeys((".heic", ".heif"), "HEIC"),
    **{".avif": "AVIF", ".jxl": "JPEG XL", ".gif": "GIF", ".psd": "Photoshop", ".hdr": "Radiance HDR"},
    **dict.fromkeys(
        (
            ".dng",
            ".cr2",
            ".cr3",
            ".crw",
            ".nef",
            ".nrw",
            ".arw",
            ".raf",
            ".orf",
            ".rw2",
            ".pef",
            ".srw",
            ".iiq",
            ".3fr",
        ),
        RAW,
    ),
}
"""Kinds by suffix, for files that their bytes do not tell: empty, cut off, or TGA, which begins in no certain way."""
DNG_VERSION, PHOTOMETRIC = 50706, 262
CFA = 32803
"""PhotometricInterpretation of a colour filter array (TIFF/EP)."""


def kind_of(path: Path) -> str:
    """Return the kind of a picture file, such as ``JPEG`` or ``HEIC``; empty where it is none that has a name here."""
    try:
        state = path.stat()
    except OSError:
        return SUFFIXES.get(path.suffix.lower(), "")
    return _kind(path, state.st_mtime_ns, state.st_size)


def is_raw(path: Path) -> bool:
    """Return whether a file is a RAW file."""
    return kind_of(path) == RAW


@functools.lru_cache(maxsize=1 << 14)
def _kind(path: Path, _mtime: int, _size: int) -> str:
    try:
        with path.open("rb") as file:
            start = file.read(32)
    except OSError:
        start = b""
    for offset, beginning, kind in BEGINNINGS:
        if start[offset:].startswith(beginning):
            return kind
    if start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return RAW if start[8:10] == b"CR" or _tiff_of_sensor(path) else "TIFF"
    return SUFFIXES.get(path.suffix.lower(), "")


def _tiff_of_sensor(path: Path) -> bool:
    """Return whether a TIFF file holds the counts of a sensor, as DNG, NEF, ARW and others do."""
    try:
        with tifffile.TiffFile(path) as file:
            pages = [page for first in file.pages for page in (first, *(first.pages or ()))]
            return any(
                DNG_VERSION in page.tags or (PHOTOMETRIC in page.tags and page.tags[PHOTOMETRIC].value == CFA)
                for page in pages
            )
    except Exception:  # a broken file: tifffile raises errors of many kinds
        return SUFFIXES.get(path.suffix.lower()) == RAW
