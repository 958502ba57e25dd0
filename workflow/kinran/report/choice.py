"""The section of the report that says which lobes were chosen, and what the others would have given."""

from pathlib import Path
from typing import Any

from kinran.files import read_json
from kinran.report.page import embed_file


def choice_section(path: Path | None) -> dict[str, Any] | None:
    """Picture and table of `kinran choice`, its picture beside its file; None where the config says the lobes."""
    if path is None:
        return None
    value = read_json(path)
    rows = [
        {
            "region": region,
            "lobes": name,
            "chosen": name == found["chosen"],
            "psnr": f"{judged['psnr']:.2f} dB",
            "relative": f"{judged['relative_error']:.3f}",
            "bic": f"{judged['bic']:.0f}",
            "texels": f"{100 * judged['texels']:.0f} %",
        }
        for region, found in value["regions"].items()
        for name, judged in found.items()
        if name != "chosen"
    ]
    cost = f"A byte a texel has to gain {value['decibels_a_byte']:.3g} dB."
    return {"picture": embed_file(path.with_suffix(".png")), "rows": rows, "cost": cost}
