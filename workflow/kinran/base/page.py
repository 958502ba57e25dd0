"""Pages: one HTML file each that needs no network, made from templates beside the stages that write them.

All templates extend `page.html`. Values are escaped unless they are marked as markup.
"""

import base64
import io
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image

from kinran.base.checksums import comment
from kinran.base.files import atomic
from kinran.base.pictures import Picture, check_png


def embed(picture: Picture) -> str:
    """Return a picture as a data URL, so that a page is one file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", optimize=True)
    return data_url(buffer.getvalue())


def embed_file(path: Path) -> str:
    """Return a PNG file as a data URL.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    check_png(path)
    return data_url(path.read_bytes())


def data_url(data: bytes, kind: str = "png") -> str:
    """Return the bytes of a picture of this kind as a data URL."""
    return f"data:image/{kind};base64," + base64.b64encode(data).decode()


def render(template: Path, values: dict[str, Any]) -> str:
    """Fill a template, which may include others of its folder."""
    environment = Environment(
        loader=FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["percent"] = lambda share, digits=1: f"{100 * share:.{digits}f} %"
    return environment.get_template(template.name).render(values)


def write_page(path: Path, template: Path, values: dict[str, Any]) -> None:
    """Fill a template and write the page, atomically."""
    body = (render(template, values) + "\n").encode()
    with atomic(path) as temporary:
        temporary.write_bytes(body + f"<!-- {comment(body)} -->\n".encode())
