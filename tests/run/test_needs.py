"""The question for the fit stays the same while the part of the answer that it uses does."""

from pathlib import Path

import pytest

from kinran.base.files import write_json
from kinran.data.needed_regions import Footprint, Need, SeenRegion
from kinran.run import needs
from kinran.run.needs import Uses, question

BEFORE = "what was asked before"


def need(factor: int, *shown: bool) -> Need:
    return Need(tuple(SeenRegion(label, needed) for label, needed in enumerate(shown)), Footprint(factor))


@pytest.fixture
def template(tmp_path: Path) -> Path:
    """A template whose fabric was fitted for texels in pairs, both regions shown."""
    path = tmp_path / "scene.xml"
    path.write_text("<scene/>")
    told = need(2, True, True)
    regions = [{"label": region.label, "needed": region.needed} for region in told.regions]
    footprint = {"coarsest_factor": told.footprint.coarsest_factor}
    write_json(tmp_path / "fit" / "need.json", {"regions": regions, "footprint": footprint, "asked": BEFORE})
    return path


@pytest.mark.parametrize(
    ("found", "texels", "regions", "stays"),
    [
        (need(2, True, True), True, True, True),
        (need(3, True, True), True, False, False),
        (need(1, True, True), True, False, False),
        (need(3, True, True), False, True, True),
        (need(2, True, False), True, False, True),
        (need(2, True, False), False, True, False),
    ],
)
def test_what_the_fit_uses(
    template: Path, monkeypatch: pytest.MonkeyPatch, found: Need, texels: bool, regions: bool, stays: bool
) -> None:
    monkeypatch.setattr(needs, "_need", lambda results, template: found)
    asked = question(template.parent, template, Uses(texels, regions))
    assert asked == (BEFORE if stays else needs.need_key(template))


def test_a_scene_that_cannot_be_looked_at_is_a_new_question(template: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The job will say why."""
    monkeypatch.chdir(template.parent)
    assert question(template.parent, template, Uses(True, True)) == needs.need_key(template)
    assert question(template.parent / "none", template, Uses(True, True)) == needs.need_key(template)
