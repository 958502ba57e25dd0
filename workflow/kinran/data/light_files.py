"""Files of a set's lights: `.lp`, as domes and RTI programs write it, and those of photometric sets."""

import math
import re
from pathlib import Path, PurePosixPath

from kinran.base.distances import Vector
from kinran.base.files import InputError
from kinran.data.light import LpLight
from kinran.data.light_list import AS_THEY_ARE, LightFile, numbered, over_horizon, with_intensities
from kinran.data.light_projects import LED_PARAMETERS, PROJECTS, read_led_parameters, read_project

SUFFIX = re.compile(r"[.][A-Za-z]{3,4}[\"']?$")
"""Pattern of an image's suffix at the end of a word."""
DECIMAL_COMMA = re.compile(r"^[+-]?\d*,\d+([eE][+-]?\d+)?$")
"""Pattern of a number that is written with a comma, as many countries do."""
DIRECTIONS, NAMES, INTENSITIES = "light_directions.txt", "filenames.txt", "light_intensities.txt"
"""Files of a photometric set (DiLiGenT): directions, the images in their order, and the light of each lamp."""
PROJECT = ("assembly-files", "lp", "LP")
"""Folders where projects keep their `.lp` (RTIBuilder, RelightLab), where none lies beside the photographs."""


def find_lights(folder: Path, given: Path | None = None, signs: Vector = AS_THEY_ARE) -> LightFile:
    """Read the lights of a folder of photographs, or those of a file that is given.

    Parameters
    ----------
    folder
        Folder of the photographs.
    given
        File of the lights; None for the one in the folder.
    signs
        1 or -1 for each of x, y, z, by which a file with other axes is brought to Kinran's.

    Raises
    ------
    InputError
        The folder is missing, has no file of lights, or several, or the file is wrong.
    """
    path = given or lights_file(folder)
    if path.suffix.lower() in PROJECTS:
        return read_project(path, signs)
    readers = {DIRECTIONS: read_directions, LED_PARAMETERS: read_led_parameters}
    return readers.get(path.name, read_lights)(path, signs)


def lights_file(folder: Path) -> Path:
    """Return the only `.lp` file of a folder, or of its project's folder of such files, or what else says its lights.

    Raises
    ------
    InputError
        The folder is missing, or has none or several.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    for place in (folder, *(folder / name for name in PROJECT)):
        found = sorted(path for path in place.glob("*") if path.suffix.lower() == ".lp" and not _hidden(path))
        if len(found) > 1:
            raise InputError(f"{place}: has {found[0].name} and {found[1].name}; keep one .lp file, or give --lp FILE")
        if found:
            return found[0]
    for name in (DIRECTIONS, LED_PARAMETERS):
        if (folder / name).is_file():
            return folder / name
    projects = sorted(path for path in folder.glob("*.relight") if not _hidden(path))
    if len(projects) == 1:
        return projects[0]
    raise InputError(
        f"{folder}: has no .lp file; add one with the number of lights and 'file x y z' for each, or give --lp FILE"
    )


def _hidden(path: Path) -> bool:
    """Return whether a file is what macOS keeps beside another (``._NAME``), or hidden otherwise."""
    return path.name.startswith(".")


def read_lights(path: Path, signs: Vector = AS_THEY_ARE) -> LightFile:
    """Read a `.lp` file: the number of lights, then a line ``file x y z`` for each.

    File names may hold spaces, quotes and folders (either slash); folders of another machine are ignored. Lines that
    begin with # are comments. Vectors may have any length, which is kept beside their direction, and decimal commas.
    The number may be missing. Lights at or under the horizon are left out, with a remark; where all are under it, z
    points away from the camera, and is turned.

    Raises
    ------
    InputError
        The file cannot be read, the count is wrong, a vector is zero or not finite, a line has more numbers than a
        vector, or a name stands twice.
    """
    try:
        lines = _text(path.read_bytes()).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a text file of light positions") from None
    numbered = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip()]
    rows = [(number, words) for number, words in numbered if not words[0].startswith("#") or _vector(words[-3:])]
    remarks = []
    if rows and len(rows[0][1]) == 1 and rows[0][1][0].isdigit():
        count, rows = int(rows[0][1][0]), rows[1:]
        if count != len(rows):
            raise InputError(f"{path}: the first line says {count} lights but {len(rows)} follow; correct one")
    elif rows and len(rows[0][1]) > 3 and _vector(rows[0][1][-3:]):
        remarks.append(f"{path}: does not begin with the number of lights; all {len(rows)} lines are taken")
    else:
        raise InputError(f"{path}: the first line is not the number of lights; a .lp starts with it")
    named: list[tuple[PurePosixPath, Vector]] = []
    seen: dict[str, int] = {}
    for number, words in rows:
        file, vector = _parse(path, number, words)
        if file.stem in seen:
            raise InputError(
                f"{path}: line {number} names '{file.stem}' again (first in line {seen[file.stem]});"
                " give each image one light"
            )
        seen[file.stem] = number
        named.append((file, vector))
    return over_horizon(path, named, remarks, signs)


def read_directions(path: Path, signs: Vector = AS_THEY_ARE) -> LightFile:
    """Read the directions of a photometric set: a line ``x y z`` for each image of ``filenames.txt``.

    Without that file, photographs go by their order.

    Raises
    ------
    InputError
        A file is missing or wrong, or their lines differ in number.
    """
    rows = _table(path)
    names_file = path.with_name(NAMES)
    names = numbered(len(rows))
    if names_file.is_file():
        names = [line.strip() for line in _lines(names_file) if line.strip()]
    if len(names) != len(rows):
        raise InputError(f"{path}: has {len(rows)} lights but {NAMES} {len(names)} images; correct one")
    named = [(PurePosixPath(name), (x, y, z)) for name, (x, y, z) in zip(names, rows, strict=True)]
    found = over_horizon(path, named, [], signs)
    intensities = path.with_name(INTENSITIES)
    if not intensities.is_file():
        return found
    light = dict(zip(names, _table(intensities), strict=False))
    if len(light) != len(names):
        raise InputError(f"{intensities}: has {len(light)} lines for {len(names)} images; correct it")
    return with_intensities(found, light)


def _table(path: Path) -> list[Vector]:
    """Return the numbers of a file with three in each line."""
    rows = []
    for number, line in enumerate(_lines(path), 1):
        if not line.strip():
            continue
        vector = _vector(line.split())
        if vector is None or not all(map(math.isfinite, vector)):
            raise InputError(f"{path}: line {number} is not three numbers: {line.strip()!r}")
        rows.append(vector)
    return rows


def _lines(path: Path) -> list[str]:
    try:
        return _text(path.read_bytes()).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); a set with {DIRECTIONS} has it") from None


def _text(data: bytes) -> str:
    """Decode UTF-8, UTF-16 with a byte order mark, or else Windows-1252."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def _vector(words: list[str]) -> Vector | None:
    """Return three words as numbers, which may have decimal commas; None where they are none."""
    if any(DECIMAL_COMMA.match(word) for word in words):
        words = [word.replace(",", ".") if DECIMAL_COMMA.match(word) else word for word in words]
    try:
        x, y, z = (float(word) for word in words)
    except ValueError:
        return None
    return x, y, z


def _parse(path: Path, number: int, words: list[str]) -> tuple[PurePosixPath, Vector]:
    """Return the image of a line and its vector."""
    given = PurePosixPath(" ".join(words[:-3]).strip("\"'").replace("\\", "/"))
    vector = _vector(words[-3:])
    if not given.name or vector is None:
        raise InputError(f"{path}: line {number} is not 'file x y z': {' '.join(words)!r}")
    if any(SUFFIX.search(word) for word in words[:-4]) and _vector(words[-4:-1]):
        raise InputError(f"{path}: line {number} has more than three numbers: {' '.join(words)!r}; give 'file x y z'")
    length = math.hypot(*vector)
    if not math.isfinite(length) or length == 0:
        x, y, z = vector
        raise InputError(f"{path}: line {number} ({given.name}) has the light vector {x} {y} {z}; give a direction")
    return given, vector


def write_lp(path: Path, lights: list[LpLight]) -> None:
    """Write a `.lp` file: directions times lengths, and the image of each with its folder."""
    vectors = [[light.length * part for part in light.direction] for light in lights]
    names = [str(PurePosixPath(light.folder, light.file or light.name)) for light in lights]
    rows = [f"{name} {' '.join(f'{part:.9f}' for part in v)}" for name, v in zip(names, vectors, strict=True)]
    path.write_text("\n".join([str(len(lights)), *rows]) + "\n", encoding="utf-8")
