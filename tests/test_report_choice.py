"""The report's table of lobes: each region's candidates, the chosen one told apart."""

from pathlib import Path

import numpy as np

from kinran.files import write_json
from kinran.pictures import write_png
from kinran.report.choice import choice_section


def test_all_candidates_of_a_region_and_the_chosen_one(tmp_path: Path) -> None:
    judged = {"psnr": 28.851, "relative_error": 0.083, "bic": -4532.8, "aic": -4596.7, "texels": 0.84}
    regions = {"gold": {"chosen": "one GGX lobe", "lambert": {**judged, "psnr": 11.5}, "one GGX lobe": judged}}
    write_json(tmp_path / "choice.json", {"decibels_a_byte": 0.01875, "regions": regions})
    write_png(tmp_path / "choice.png", np.zeros((4, 4, 3), np.uint8))
    section = choice_section(tmp_path / "choice.json")
    assert section is not None
    told = [(row["region"], row["lobes"], row["chosen"], row["psnr"], row["texels"]) for row in section["rows"]]
    assert told == [("gold", "lambert", False, "11.50 dB", "84 %"), ("gold", "one GGX lobe", True, "28.85 dB", "84 %")]
    assert section["picture"].startswith("data:image/png;base64,")
    assert "0.0187 dB" in section["cost"]


def test_none_where_the_config_says_the_lobes() -> None:
    assert choice_section(None) is None
