"""The section of the report that says how well the lights fix the lobes."""

from pathlib import Path
from typing import Any

from kinran.files import read_json
from kinran.report.page import embed_file


def certainty_section(fit: Path) -> dict[str, Any] | None:
    """Picture and table of `kinran sigma`; None where no slope lobes were fitted."""
    summary, picture = fit / "slope.sigma.json", fit / "slope.sigma.png"
    if not summary.is_file():
        return None
    rows = [
        {
            "region": region,
            "lobe": lobe.removeprefix("lobe"),
            "texels": f"{100 * value['share_of_texels']:.0f} %",
            "normal": "no bound" if value["normal_degrees"] is None else f"{value['normal_degrees']:.2f}°",
            "amplitude": "no bound"
            if value["amplitude_relative"] is None
            else f"{100 * value['amplitude_relative']:.1f} %",
            "unresolved": f"{100 * value['unresolved']:.1f} %",
        }
        for region, lobes in read_json(summary).items()
        for lobe, value in lobes.items()
    ]
    return {"picture": embed_file(picture), "rows": rows}
