"""What counts of a template, and for what."""

import re
from collections.abc import Callable
from pathlib import Path

import mitsuba as mi
import pytest

from kinran.base.project import ROOT
from kinran.scene.template import Template, read_template

DRAPE = (ROOT / "scenes" / "drape.xml").read_text()
COUNT = '<integer name="sample_count" value="$spp"/>'


Read = Callable[[str], Template]


@pytest.fixture
def read(tmp_path: Path) -> Read:
    """Function that reads a template from its text."""

    def of(text: str) -> Template:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.xml"
        path.write_text(text)
        return read_template(path)

    return of


def replaced(old: str, new: str, text: str = DRAPE) -> str:
    assert old in text
    return text.replace(old, new, 1)


LITERAL = replaced(COUNT, '<integer name="sample_count" value="24"/>')


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A panel of cloth", "A piece of cloth"),
        ("    <integrator", "\t<!-- how -->\n\n\t<integrator"),
        ('<default name="width" value="720"/>', "<default  value='720' name='width'></default>"),
    ],
)
def test_comments_and_layout_count_for_nothing(read: Read, old: str, new: str) -> None:
    assert read(replaced(old, new)) == read(DRAPE)


@pytest.mark.parametrize(("text", "samples"), [(DRAPE, "36"), (LITERAL, "24")])
def test_samples_stand_apart(read: Read, text: str, samples: str) -> None:
    more = replaced(f'"{samples}"', '"1000"', text)
    assert (read(text).samples, read(more).samples) == (int(samples), 1000)
    assert read(text).digest == read(more).digest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name="fov" value="12"', 'name="fov" value="12.1"'),
        ('name="width" value="720"', 'name="width" value="721"'),
        ('name="key" value="23"', 'name="key" value="24"'),
        ('<integrator type="path">', '<integrator type="volpath">'),
    ],
)
def test_all_else_counts(read: Read, old: str, new: str) -> None:
    changed = read(replaced(old, new))
    assert changed.samples == 36
    assert changed.digest != read(DRAPE).digest


@pytest.mark.parametrize(
    "text",
    [
        replaced("$width", "$spp"),  # the same default sizes the picture
        replaced('<default name="spp" value="36"/>', '<default name="spp" value="6"/><default name="spp" value="36"/>'),
        replaced('<default name="spp" value="36"/>', '<default name="a" value="16"/><default name="spp" value="$a"/>'),
        replaced('"$spp"', '"1$spp"'),
        replaced('type="multijitter"', 'type="stratified"'),
        replaced("<film", '<include filename="more.xml"/><film'),
        replaced(COUNT, ""),
        replaced(COUNT, '<integer name="sample_count" value="many"/>'),
        "<scene",
    ],
)
def test_samples_that_do_not_stand_apart_count_with_the_rest(read: Read, text: str) -> None:
    assert read(text).samples is None
    changed = text.replace('"16"', '"17"')
    assert changed == text or read(changed).digest != read(text).digest


@pytest.mark.parametrize("text", [DRAPE, LITERAL, DRAPE.replace('"spp"', '"many"').replace("$spp", "$many")])
def test_it_is_the_number_that_mitsuba_reads(read: Read, text: str) -> None:
    mi.set_variant("scalar_rgb")
    without_cloth = re.sub(r'<shape type="ply".*?</shape>', "", text, flags=re.DOTALL)
    scene = mi.load_string(without_cloth)
    assert scene.sensors()[0].sampler().sample_count() == read(text).samples
