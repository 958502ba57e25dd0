"""Write the Mitsuba scene of one fabric: a template, its mesh, and its material at its physical scale.

The scene is the template with its defaults filled in, so it stays an XML that people read and change. Its
paths are relative to its folder. Regions that nobody fitted are rendered by applying a texture (Takeda2008,
§4): their diffuse colour, behind a mask.
"""

import os
import xml.etree.ElementTree as ET
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kinran.base.checksums import comment
from kinran.base.exr import write_exr
from kinran.base.files import InputError, atomic
from kinran.scene.placement import placement, uv_size
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.models import MODELS

Map = NDArray[np.float32]

UNFITTED = ("texture", *(name for name, model in MODELS.items() if not any(model.counts)))
SMALLEST, LARGEST = 1e-4, 100.0
"""Believable size of a texel in mm: one in metres or micrometres falls outside."""


@dataclass(frozen=True)
class Inputs:
    template: Annotated[Path, "scene with defaults, such as scenes/drape.xml"]
    mesh: Annotated[Path, "PLY that kinran mesh made"]
    material: Annotated[Path, "material of the fabric (.exr)"]


def main(inputs: Inputs, out: Annotated[Path, "folder to write scene.xml to"]) -> None:
    """Write the scene of a fabric."""
    assemble(inputs.template, inputs.mesh, inputs.material, out)


def unfitted_labels(material: Material) -> list[int]:
    """Labels of the regions without a lobe, if there are others with one."""
    plain = [int(region["label"]) for region in material.regions if region["model"] in UNFITTED]
    return plain if len(plain) < len(material.regions) else []


def texture_and_mask(material: Material, labels: list[int]) -> tuple[Map, Map]:
    """Texture of the unfitted regions, and mask of the fitted ones.

    Parameters
    ----------
    material
        Material of the fabric; row 0 of its maps is v = 0.
    labels
        Labels of the unfitted regions.

    Returns
    -------
    texture : (y, x, 3) float32
        Albedo in linear Rec.709, in [0, 1]. Texels of other regions hold the nearest unfitted colour, so that
        bilinear lookups do not bleed.
    mask : (y, x) float32
        1 where the material is fitted, 0 where the texture is to be seen.
    """
    mask = ~np.isin(np.rint(material.channels["label"]), labels)
    diffuse = material.terms()[0][0]
    albedo = np.clip(np.pi * diffuse @ TO_REC709.T, 0, 1)
    nearest = distance_transform_edt(mask, return_distances=False, return_indices=True)
    return albedo[tuple(nearest)].astype(np.float32), mask.astype(np.float32)


def _read_material(path: Path) -> Material:
    try:
        return read_material(path)
    except ValueError as error:  # the plugin's, which knows nothing of the workflow
        raise InputError(str(error)) from None


def _element(tag: str, *children: ET.Element, **attributes: str) -> ET.Element:
    element = ET.Element(tag, attributes)
    element.extend(children)
    return element


def _bitmap(name: str, filename: str, raw: bool, filter_type: str, cloth: ET.Element) -> ET.Element:
    """A bitmap that lies on the cloth as the material does."""
    texture = _element(
        "texture",
        _element("string", name="filename", value=filename),
        _element("boolean", name="raw", value=str(raw).lower()),
        _element("string", name="filter_type", value=filter_type),
        type="bitmap",
        name=name,
    )
    if (wrap := cloth.find("string[@name='wrap_mode']")) is not None:
        texture.append(_element("string", name="wrap_mode", value=wrap.attrib["value"]))
    if (to_uv := cloth.find("transform[@name='to_uv']")) is not None:
        texture.append(deepcopy(to_uv))
    return texture


def blend(cloth: ET.Element) -> ET.Element:
    """A `blendbsdf` of a texture (weight 0) and a `kinran` BSDF (weight 1) in place of that BSDF."""
    inner = deepcopy(cloth)
    names = {key: inner.attrib.pop(key) for key in ("id", "name") if key in inner.attrib}
    texture = _element("bsdf", _bitmap("reflectance", "texture.exr", False, "bilinear", cloth), type="diffuse")
    return _element(
        "bsdf",
        _bitmap("weight", "fitted.exr", True, "nearest", cloth),
        _element("bsdf", texture, type="twosided"),
        inner,
        type="blendbsdf",
        **names,
    )


def _read_template(path: Path) -> ET.Element:
    try:
        parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        root = ET.parse(path, parser).getroot()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no XML ({error}); start again from scenes/drape.xml") from None
    if root.tag != "scene":
        raise InputError(f"{path}: its root is <{root.tag}>, not <scene>; start again from scenes/drape.xml")
    return root


def _fill_in(root: ET.Element, template: Path, values: dict[str, str]) -> None:
    for name, value in values.items():
        default = root.find(f"default[@name='{name}']")
        if default is None:
            raise InputError(f'{template}: has no <default name="{name}" …/>; add it as in scenes/drape.xml')
        default.set("value", value)


def _replace_cloth(root: ET.Element, template: Path) -> None:
    found = False
    depth = {child: (parent, level) for parent, level in _levels(root) for child in parent}
    for cloth, (parent, level) in depth.items():
        if cloth.tag == "bsdf" and cloth.get("type") == "kinran":
            blended = blend(cloth)
            blended.tail = cloth.tail
            parent[list(parent).index(cloth)] = blended
            ET.indent(blended, "    ", level + 1)
            found = True
    if not found:
        raise InputError(f'{template}: has no <bsdf type="kinran">; add it as in scenes/drape.xml')


def _levels(element: ET.Element, level: int = 0) -> list[tuple[ET.Element, int]]:
    return [(element, level)] + [pair for child in element for pair in _levels(child, level + 1)]


def assemble(template: Path, mesh: Path, material: Path, out: Path) -> Path:
    """Write `scene.xml`, and the texture and mask that it may need, to a folder.

    Parameters
    ----------
    template
        A scene with defaults `mesh`, `material`, `repeat_x`, `repeat_y`, `shift_x`, `shift_y` and `wrap`, and
        a BSDF of type `kinran`; see scenes/drape.xml.
    mesh
        PLY whose s, t are millimetres along weft and warp, from (0, 0).
    material
        Material EXR.
    out
        Folder for `scene.xml`; `texture.exr` and `fitted.exr` only if some regions are not fitted.

    Returns
    -------
    Path
        The scene.

    Raises
    ------
    InputError
        One of the files is missing, unreadable, or lacks what the scene needs.
    """
    root = _read_template(template)
    fabric = _read_material(material)
    labels = unfitted_labels(fabric)
    if fabric.texel_mm is not None and not SMALLEST < fabric.texel_mm < LARGEST:
        raise InputError(f"{material}: kinran:texel_mm is {fabric.texel_mm:g}; give the size of a texel in millimetres")
    cloth = uv_size(mesh)
    paths = {
        "mesh": Path(os.path.relpath(mesh, out)).as_posix(),
        "material": Path(os.path.relpath(material, out)).as_posix(),
    }
    _fill_in(root, template, {**paths, **placement(fabric.size, fabric.texel_mm, cloth)})
    if labels:
        _replace_cloth(root, template)
        texture, mask = texture_and_mask(fabric, labels)
        write_exr(out / "texture.exr", {name: texture[..., k] for k, name in enumerate("RGB")})
        write_exr(out / "fitted.exr", {"Y": mask})
    scene = out / "scene.xml"
    with atomic(scene) as temporary:
        body = (ET.tostring(root, encoding="unicode") + "\n").encode()
        temporary.write_bytes(body + f"<!-- {comment(body)} -->\n".encode())
    return scene
