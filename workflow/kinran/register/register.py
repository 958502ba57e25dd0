"""Register side views of a fabric to its front view: cameras, height, rectified views, and the shift that is left.

Takeda and Tanaka took all views as pictures of a plane, were left with an error of a few millimetres, and gave the
side views up (Takeda2008, §2.3). Calibrated cameras do not cure that, the height of the fabric does: 1.5 mm of it
are 2.6 mm of shift at 60°.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.files import InputError
from kinran.data.photographs import is_picture


@dataclass(frozen=True)
class Inputs:
    views: Annotated[tuple[Path, ...], "--views IMAGE", "pictures, the front view first"]
    board: Annotated[Path, "the target around the fabric (.yaml)"]


@dataclass(frozen=True)
class Options:
    field_mm: Annotated[str, "--field-mm W,H", "part of the opening (default: 90 % of its sides)"] = ""
    encoding: Annotated[str, "encoding of the pictures: srgb, linear or gamma:X"] = "srgb"


def main(
    inputs: Inputs,
    out: Annotated[Path, "OUT", "folder for cameras.json, height.exr, rectified/ and register.json"],
    options: Options = Options(),
) -> None:
    """Register the views, and print the shift that is left; `kinran.register.views.register` names the errors."""
    from kinran.register.views import register

    register(out, list(inputs.views), inputs.board, options.field_mm, options.encoding)


def find_views(folder: Path) -> list[Path]:
    """Pictures of a session's folder: the one named front, then the others by name.

    Raises
    ------
    InputError
        The folder is missing, it has not just one front view, or a name has letters that a rule cannot take.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the session's views")
    views = sorted(path for path in folder.iterdir() if is_picture(path))
    for path in views:
        if not re.fullmatch(r"[\w.-]+", path.name, re.ASCII):
            raise InputError(f"{path}: use only letters, digits, _, - and . in the name")
    if (fronts := sum(path.stem == "front" for path in views)) != 1:
        raise InputError(f"{folder}: has {fronts} pictures named front; name the front view so, and no other")
    return sorted(views, key=lambda path: path.stem != "front")
