"""Values of a fabric's report, gathered from the files of the stages."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.base.drawing.plots import colour
from kinran.base.exr import read_exr
from kinran.base.files import read_json
from kinran.base.page import embed, embed_file
from kinran.data.calibration import Calibration, read_calibration
from kinran.data.capture_plan import Plan, read_plan
from kinran.data.fabric import Fabric
from kinran.data.verdict import verdict
from kinran.report import drawings
from kinran.report.colours import chart_section
from kinran.report.maps import maps, rec709
from kinran.report.relit import relit_section
from kinran_bsdf.material import Material, read_material

MAP_WIDTH = 240
"""Pixels across each map."""

Values = dict[str, Any]


def gather(results: Path, captures: Path, choice: Path | None = None) -> Values:
    """Values of the template `fabric.html`."""
    plan = read_plan(captures / "plan.json")
    material = read_material(results / "material.exr")
    errors: Values = read_json(results / "evaluation.json")
    calibration = read_calibration(results / "calibration.json")
    judged = {name: method for name, method in errors["methods"].items() if "psnr" in method}
    return {
        "title": errors["fabric"],
        "plan": plan,
        "material": material,
        "render": embed_file(results / "render.png"),
        "rendered": read_json(results / "render.json"),
        "sweep": embed_file(results / "sweep.png"),
        "relit": relit_section(material),
        "lights": drawings.lights(plan, errors["held_out"]).svg("Light directions; rings are held out"),
        "capture": _capture(plan, captures, calibration),
        "colours": chart_section(calibration),
        **_regions(Fabric(results), material, calibration),
        "maps": [(caption, embed(pictures.enlarge(p, MAP_WIDTH))) for caption, p in maps(material)],
        "clamped": bool((material.channels["bound"] < 1).any()),
        "errors": errors,
        "verdict": verdict(errors),
        "judged": [(name, colour(k), method) for k, (name, method) in enumerate(judged.items())],
        "by_region": drawings.by_region(errors, judged).svg("Relative error by region") if judged else "",
        "by_angle": drawings.by_angle(judged, plan).svg("PSNR over θ") if judged else "",
        "evaluation": embed_file(results / "evaluation.png"),
        "choice": choice_section(choice),
        "certainty": certainty_section(results / "fit"),
        "chart": chart.svg("Relative error against time") if (chart := drawings.against_time(errors)) else "",
        "stages": drawings.stages(results / "benchmarks").svg("Seconds of each stage"),
        "mesh": read_json(results / "mesh.json"),
        "need": _need(read_json(results / "need.json")),
        "theta_max": f"{math.degrees(material.theta_max):.0f}°",
    }


def choice_section(path: Path | None) -> Values | None:
    """Values of `choice.html`, from the files of `kinran choice`; None where the config sets the lobes."""
    return {"found": read_json(path), "picture": embed_file(path.with_suffix(".png"))} if path else None


def certainty_section(fit: Path) -> Values | None:
    """Values of `certainty.html`, from the files of `kinran sigma`; None where no slope lobes were fitted."""
    path = fit / "slope.sigma.json"
    return {"regions": read_json(path), "picture": embed_file(path.with_suffix(".png"))} if path.is_file() else None


def _capture(plan: Plan, captures: Path, calibration: Calibration) -> list[tuple[str, str]]:
    manifests = [read_json(path) for path in sorted((captures / "groups").glob("*.json"))]
    shots = [shot for manifest in manifests for shot in manifest["shots"]]
    again = sum(shot["revision"] > 0 for shot in shots)
    size = sum(frame["bytes"] for shot in shots for frame in shot["frames"])
    rows = [
        ("lights", str(len(plan.lights))),
        ("groups", str(len(manifests))),
        ("frames", f"{sum(len(shot['frames']) for shot in shots)} ({size / 1e6:.3g} MB)"),
        ("shot again", str(again)),
    ]
    if plan.duration_s:
        rows.append(("planned duration", f"{plan.duration_s / 3600:.1f} h"))
    if plan.light_dose_s:
        rows.append(("fabric under the lamp", f"{plan.light_dose_s / 60:.0f} min"))
    readings = [shot["photodiode"] for shot in shots if shot["kind"] == "monitor" and shot["photodiode"]]
    if readings:
        spread = 100 * (max(readings) / min(readings) - 1)
        rows.append(("lamp drift over the session, removed", f"{spread:.1f} %"))
    if calibration.camera:
        camera = calibration.camera
        rows += [
            (
                "exposures, measured",
                ", ".join(f"1/{1 / exposure.seconds:.4g} s" for exposure in camera.exposures),
            ),
            (
                "saturation / read noise",
                f"{camera.response.saturation:.0f} / {camera.response.read:.2f} counts",
            ),
        ]
        if not calibration.encoding:
            rows.append(("defective sites", str(len(camera.bad))))
    if calibration.delta_e:
        mean, worst = np.mean(calibration.delta_e), max(calibration.delta_e)
        rows.append(("colour chart, ΔE00 leave-one-out", f"{mean:.2f} (worst {worst:.2f})"))
    else:
        rows.append(("colours, with no chart", calibration.colour))
    rows.append(("lamps and camera", _geometry(plan)))
    return rows


def _geometry(plan: Plan) -> str:
    """Sentence on where lamps and camera stand."""
    distances = [math.hypot(*light.position_mm) for light in plan.lights if light.position_mm]
    if not distances:
        return "only directions are known: taken to be far away"
    near, far = min(distances), max(distances)
    lamps = f"{near:.0f} mm" if far - near < 1 else f"{near:.0f} to {far:.0f} mm"
    camera = f"{plan.camera_mm:.0f} mm" if plan.camera_mm else "far away"
    return f"lamps {lamps}, camera {camera}, field {plan.field_mm:.4g} mm wide"


def _regions(fabric: Fabric, material: Material, calibration: Calibration) -> Values:
    statistics = read_exr(fabric.folder / "statistics.exr")
    median = np.stack([statistics[f"median.{c}"] for c in "RGB"], -1)
    rgb = rec709(median @ calibration.matrix.T)
    models = {region["label"]: region["model"] for region in material.regions}
    palette = pictures.region_colours(np.array([region.colour for region in fabric.regions]))
    rows = []
    for region in fabric.regions:
        own = np.clip(np.array(region.colour), 0, None)
        shown = pictures.SRGB.encode(own / max(own.max(), 0.5)) * 255
        rows.append((region, models[region.label], _css(palette[region.label]), _css(shown)))
    return {
        "regions": rows,
        "texels": fabric.labels.size,
        "label_map": embed(pictures.enlarge(pictures.label_map(fabric.labels, palette), MAP_WIDTH)),
        "photograph": embed(pictures.enlarge(pictures.photograph(rgb, pictures.auto_exposure(rgb)), MAP_WIDTH)),
    }


def _need(need: Values) -> list[tuple[str, str]]:
    """Rows on the needs of the scene, in words."""
    narrow, factor = need["footprint"]["narrow"], need["footprint"]["coarsest_factor"]
    coarsest = "no coarser texel would do" if factor == 1 else f"texels {factor} times as large would do"
    shares = ", ".join(f"{region['name']} {100 * region['share']:.1f} %" for region in need["regions"])
    half = need["half_vector"]
    outside = (
        "not known" if half["outside"] in (None, "all") else f"{100 * half['outside']:.0f} % of the cloth's pixels"
    )
    return [
        ("cloth in the picture", f"{100 * need['cloth_share']:.0f} % of the pixels"),
        ("regions seen", shares),
        ("texels a pixel", f"{narrow['median']:.2g} ({coarsest})"),
        ("view from the normal", f"{math.degrees(need['view']['median']):.0f}° in the middle"),
        ("half vectors beyond what was measured", outside),
    ]


def _css(rgb: NDArray[Any]) -> str:
    r, g, b = (int(v) for v in rgb)
    return f"rgb({r},{g},{b})"
