"""The section of the report on colour: the chart's patches beside their references, and the ΔE00 between them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinran.base import pictures
from kinran.calibrate.colour_chart import COLUMNS, PATCHES
from kinran.data.calibration import Calibration
from kinran.report import drawings
from kinran_bsdf.colours import TO_REC709


def chart_section(calibration: Calibration) -> dict[str, Any] | None:
    """Values of the section on the colour chart; None without a chart."""
    patches = calibration.chart
    if not patches:
        return None
    used = [patch for patch in patches if not patch.left_out]
    left_out = [(PATCHES[k], patch.left_out) for k, patch in enumerate(patches) if patch.left_out]
    rows = [
        ("ΔE00, each patch left out in turn", _spread([patch.delta_e for patch in used])),
        ("the same of a root polynomial", _spread([patch.root_delta_e for patch in used])),
        ("patches used", f"{len(used)} of {len(patches)}"),
        *((f"left out: {name}", why) for name, why in left_out),
        ("reference", f"spectra under {calibration.lamp}" if calibration.lamp else _published(calibration)),
    ]
    if calibration.camera:
        rows.append(("veiling glare, removed", f"{calibration.camera.glare:.2%} of the mean light"))
    cells = [
        (PATCHES[k], _css(patch.colour), _css(patch.reference), patch.delta_e, patch.left_out)
        for k, patch in enumerate(patches)
    ]
    return {
        "swatches": drawings.swatches(cells, COLUMNS).svg("Colour chart: seen beside its reference"),
        "rows": rows,
        "note": _note(calibration),
    }


def _published(calibration: Calibration) -> str:
    return f"published colours (D50, adapted), chart {calibration.generation}".removesuffix(", chart ")


def _note(calibration: Calibration) -> str:
    """Sentences on which map from camera RGB to colours is used where."""
    matrix = "The material and all that follows from it have the 3×3 matrix, which is exact for sums of light."
    if calibration.root_polynomial is None:
        return f"{matrix} A root polynomial would not be better."
    return (
        f"{matrix} A root polynomial fits this chart better; pictures of single lights have it by"
        " `kinran export --calibration`."
    )


def _spread(errors: Sequence[float]) -> str:
    return f"{np.mean(errors):.2f} mean, {max(errors):.2f} worst"


def _css(acescg: Sequence[float]) -> str:
    """Colour in sRGB, clipped to what a screen shows."""
    r, g, b = np.round(255 * pictures.SRGB.encode(np.clip(TO_REC709 @ np.array(acescg), 0, 1))).astype(int)
    return f"rgb({r},{g},{b})"
