"""The report's table of lobes: each region's candidates, the chosen one told apart."""

import re
from pathlib import Path

import numpy as np

from kinran.base.files import write_json
from kinran.base.page import render
from kinran.base.pictures import write_png
from kinran.report import contents
from kinran.report.contents import choice_section


def test_all_candidates_of_a_region_and_the_chosen_one(tmp_path: Path) -> None:
    judged = {"psnr": 28.851, "relative_error": 0.083, "bic": -4532.8, "aic": -4596.7, "texels": 0.84}
    regions = {"gold": {"chosen": "one GGX lobe", "lambert": {**judged, "psnr": 11.5}, "one GGX lobe": judged}}
    write_json(tmp_path / "choice.json", {"decibels_a_byte": 0.01875, "regions": regions})
    write_png(tmp_path / "choice.png", np.zeros((4, 4, 3), np.uint8))
    text = render(
        Path(contents.__file__).with_name("choice.html"), {"choice": choice_section(tmp_path / "choice.json")}
    )
    told = [re.findall("<td>(.*?)</td>", line) for line in text.splitlines() if line.startswith("<tr><td>")]
    errors = ["0.083", "-4533", "84 %"]
    assert told == [
        ["gold", "lambert", "11.50 dB", *errors],
        ["gold", "<b>one GGX lobe</b>", "28.85 dB", *errors],
    ]
    assert 'src="data:image/png;base64,' in text
    assert "0.0187 dB" in text


def test_none_where_the_config_says_the_lobes() -> None:
    assert choice_section(None) is None
