"""A scene's template with a cloth that needs no material: it shows the labels of its regions."""

import xml.etree.ElementTree as ET
from pathlib import Path

from kinran.base.files import InputError


def stand_in(template: Path, labels: Path) -> tuple[str, set[str]]:
    """The template with a diffuse cloth that shows its labels, so that no material is needed.

    Parameters
    ----------
    template
        Scene; its BSDFs of the type `kinran`, and what wraps them, are replaced.
    labels
        Label map with one channel (.exr).

    Returns
    -------
    xml, ids
        The scene and the ids of the BSDFs in place of the cloth's.

    Raises
    ------
    InputError
        The template is missing, no XML, or has no cloth.
    """
    try:
        root = ET.parse(template).getroot()
    except FileNotFoundError:
        raise InputError(f"{template}: no such file") from None
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InputError(f"{template}: is no XML ({error}); start again from scenes/drape.xml") from None
    ids: set[str] = set()
    _replace_cloth(root, labels, ids)
    if not ids:
        raise InputError(f'{template}: has no <bsdf type="kinran">; add it as in scenes/drape.xml')
    return ET.tostring(root, encoding="unicode"), ids


def _replace_cloth(parent: ET.Element, labels: Path, ids: set[str]) -> None:
    for index, child in enumerate(list(parent)):
        cloth = next((bsdf for bsdf in child.iter("bsdf") if bsdf.get("type") == "kinran"), None)
        if cloth is None:
            continue
        if child.tag != "bsdf":
            _replace_cloth(child, labels, ids)
            continue
        texture = ET.Element("texture", type="bitmap", name="reflectance")
        ET.SubElement(texture, "string", name="filename", value=str(labels))
        ET.SubElement(texture, "boolean", name="raw", value="true")
        ET.SubElement(texture, "string", name="filter_type", value="nearest")
        texture.extend(element for element in cloth if element.get("name") in ("wrap_mode", "to_uv"))
        name = child.get("id", f"kinran cloth {len(ids)}")
        parent[index] = ET.Element("bsdf", {**child.attrib, "type": "diffuse", "id": name})
        parent[index].append(texture)
        ids.add(name)
