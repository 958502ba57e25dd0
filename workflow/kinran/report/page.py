"""Building blocks of the report's pages."""

import base64
import io
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image

from kinran.files import atomic
from kinran.pictures import Picture


def embed(picture: Picture) -> str:
    """Picture as a data URL, so that a page is one file."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "PNG", optimize=True)
    return _url(buffer.getvalue())


def embed_file(path: Path) -> str:
    """PNG file as a data URL."""
    return _url(path.read_bytes())


def _url(data: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(data).decode()


def write_page(path: Path, template: str, values: dict[str, Any]) -> None:
    """Fill a template of this folder, everything escaped but what is marked as markup, and write it."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    with atomic(path) as temporary:
        temporary.write_text(environment.get_template(template).render(values), encoding="utf-8")
