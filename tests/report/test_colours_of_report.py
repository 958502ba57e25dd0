"""What the report says of a colour chart: every patch, why one is left out, and which matrix is used."""

import re

import pytest

from kinran.calibrate.colour_chart import PATCHES
from kinran.data.calibration import Calibration, Patch
from kinran.report.colours import chart_section

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def calibration(root: tuple[tuple[float, ...], ...] | None = None, lamp: str = "") -> Calibration:
    """A chart of which white is saturated and black lies on dirt; errors of 0.1 k."""
    why = {18: "saturated", 23: "contradicted by the others"}
    chart = tuple(
        Patch((k / 23, 0.2, 0.2), (k / 23, 0.2, 0.4), 0.1 * k, 0.2 * k, why.get(k, "")) for k in range(len(PATCHES))
    )
    used = tuple(k for k in range(len(PATCHES)) if k not in why)
    errors = tuple(chart[k].delta_e for k in used)
    return Calibration("silk", "", 4, 4, "", "", None, "camera", IDENTITY, errors, used, root, chart=chart, lamp=lamp)


def test_all_patches_are_shown() -> None:
    """Two halves of a colour each, the error below, and the reason in the tip and the table."""
    section = chart_section(calibration())
    assert section is not None
    picture = section["swatches"]
    assert len(re.findall(r'fill="rgb\(', picture)) == 2 * 24
    assert "<title>white: ΔE00 1.80, left out: saturated</title>" in picture
    assert len(re.findall("left out: ", picture)) == 2
    rows = dict(section["rows"])
    assert rows["left out: white"] == "saturated"
    assert rows["left out: black"] == "contradicted by the others"
    assert rows["patches used"] == "22 of 24"
    assert rows["ΔE00, each patch left out in turn"] == "1.07 mean, 2.20 worst"  # of the 22
    assert rows["the same of a root polynomial"] == "2.14 mean, 4.40 worst"
    assert rows["reference"] == "published colours (D50, adapted)"


@pytest.mark.parametrize(
    ("root", "says"), [(None, "would not be better"), (((1.0,) * 6,) * 3, "fits this chart better")]
)
def test_which_map_is_used(root: tuple[tuple[float, ...], ...] | None, says: str) -> None:
    section = chart_section(calibration(root, "xenon"))
    assert section is not None
    assert says in section["note"]
    assert "The material and all that follows from it have the 3×3 matrix" in section["note"]
    assert dict(section["rows"])["reference"] == "spectra under xenon"


def test_photographs_have_no_chart() -> None:
    photographs = Calibration("icon", "", 4, 4, "srgb", "", None, "linear Rec. 709", IDENTITY, ())
    assert chart_section(photographs) is None
