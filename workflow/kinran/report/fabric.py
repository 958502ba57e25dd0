"""What the report of a fabric says, gathered from the files of its stages."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinran import pictures
from kinran.exr import read_exr
from kinran.files import read_json
from kinran.labels import Region, read_labels, read_regions
from kinran.plans import Plan, read_plan
from kinran.radiance.calibration import Calibration, read_calibration
from kinran.report import charts
from kinran.report.certainty import certainty_section
from kinran.report.choice import choice_section
from kinran.report.colours import chart_section
from kinran.report.page import embed, embed_file
from kinran.report.relit import relit_section
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material, read_material

MAP_WIDTH = 240

Values = dict[str, Any]


def gather(fabric: str, results: Path, captures: Path, choice: Path | None = None) -> Values:
    """Values of the template `fabric.html`."""
    plan = read_plan(captures / "plan.json")
    material = read_material(results / "material.exr")
    errors = read_json(results / "evaluation.json")
    calibration = read_calibration(results / "calibration.json")
    regions = read_regions(results / "regions.json")
    return {
        "title": fabric,
        "fabric": fabric,
        "source": _source(plan, material),
        "render": embed_file(results / "render.png"),
        "sweep": embed_file(results / "sweep.png"),
        "evaluation": embed_file(results / "evaluation.png"),
        "render_caption": _render_caption(results, material),
        "numbers": _numbers(errors),
        "relit": relit_section(material),
        "lights": Markup(charts.lights(_lights(plan, errors["held_out"]))),
        "capture": _capture(plan, captures, calibration),
        "colours": chart_section(calibration),
        **_regions(results, regions, material, calibration),
        "model": material.model,
        "maps": [(caption, embed(pictures.enlarge(p, MAP_WIDTH))) for caption, p in _maps(material)],
        "clamped": bool((material.channels["bound"] < 1).any()),
        **_errors(errors, plan),
        "choice": choice_section(choice),
        "certainty": certainty_section(results / "fit"),
        **_costs(errors),
        "stages": Markup(charts.bars(stage_times(results / "benchmarks"))),
        "mesh": [(key.replace("_", " "), _plain(value)) for key, value in _mesh(results).items()],
        "need": _need(read_json(results / "need.json")),
        "theta_max": f"{math.degrees(material.theta_max):.0f}°",
    }


def _source(plan: Plan, material: Material) -> str:
    height, width = material.size
    size = f"{width} × {height} texels" + (f" of {material.texel_mm:g} mm" if material.texel_mm else "")
    if plan.kind == "grid":
        return f"From the rig: {len(plan.lights)} light directions × {len(plan.exposures_s)} exposures, {size}."
    crop = f", crop {plan.crop}" if plan.crop else ""
    brackets = f" × {len(plan.exposures_s)} exposures" if len(plan.exposures_s) > 1 else ""
    return f"From photographs under {len(plan.lights)} known lights{brackets} ({plan.encoding}{crop}), {size}."


def _render_caption(results: Path, material: Material) -> str:
    info = read_json(results / "render.json")
    return (
        f"Path-traced by Mitsuba with the material of this page ({material.model}): "
        f"{info['spp']} samples a pixel, {info['seconds_render']:.1f} s in {info['variant']}."
    )


def _numbers(errors: Values) -> list[tuple[str, str]]:
    method = errors["methods"][errors["default"]]
    fit = method["fit"]
    numbers = []
    if "psnr" in method:
        numbers += [
            (f"{method['psnr']:.1f} dB", f"PSNR on {len(errors['held_out'])} held-out lights"),
            (f"{100 * method['relative_error']:.1f} %", "relative error there"),
        ]
    return [
        *numbers,
        (f"{fit['microseconds_per_texel']:.0f} µs", "CPU time of the fit, a texel"),
        (f"{fit['bytes_per_texel']}", "bytes a texel at half precision"),
        (str(errors["training_lights"]), "lights fitted"),
    ]


def _lights(plan: Plan, held_out: list[str]) -> list[tuple[str, float, float, bool]]:
    held = set(held_out)
    return [
        (light.name, math.radians(light.theta), math.radians(light.phi), light.name in held) for light in plan.lights
    ]


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
    """What is known of where lamps and camera stand."""
    distances = [math.hypot(*light.position_mm) for light in plan.lights if light.position_mm]
    if not distances:
        return "directions alone: as if they stood far away"
    near, far = min(distances), max(distances)
    lamps = f"{near:.0f} mm" if far - near < 1 else f"{near:.0f} to {far:.0f} mm"
    camera = f"{plan.camera_mm:.0f} mm" if plan.camera_mm else "far away"
    return f"lamps {lamps}, camera {camera}, field {plan.field_mm:.4g} mm wide"


def _regions(results: Path, regions: list[Region], material: Material, calibration: Calibration) -> Values:
    labels = read_labels(results / "labels.exr")
    statistics = read_exr(results / "statistics.exr")
    median = np.stack([statistics[f"median.{c}"] for c in "RGB"], -1)
    rgb = _rec709(median @ calibration.matrix.T)
    models = {region["label"]: region["model"] for region in material.regions}
    rows = []
    palette = pictures.region_colours(np.array([region.colour for region in regions]))
    for region in regions:
        colour = np.clip(np.array(region.colour), 0, None)
        shown = pictures.SRGB.encode(colour / max(colour.max(), 0.5)) * 255
        rows.append(
            {
                "name": region.name,
                "texels": region.texels,
                "share": f"{100 * region.texels / labels.size:.1f} %",
                "shininess": f"{region.shininess:.2f}",
                "model": models[region.label],
                "swatch": _css(palette[region.label]),
                "colour": _css(shown),
            }
        )
    return {
        "regions": rows,
        "label_map": embed(pictures.enlarge(pictures.label_map(labels, palette), MAP_WIDTH)),
        "photograph": embed(pictures.enlarge(pictures.photograph(rgb, pictures.auto_exposure(rgb)), MAP_WIDTH)),
    }


def _maps(material: Material) -> list[tuple[str, pictures.Picture]]:
    channels = material.channels
    maps = []

    def colour(part: str, caption: str) -> None:
        light = (
            np.pi * channels[f"{part}.amplitude"][..., None] * np.stack([channels[f"{part}.{c}"] for c in "RGB"], -1)
        )
        light = _rec709(light)
        maps.append((caption, pictures.photograph(light, pictures.auto_exposure(light))))

    colour("diffuse", "Diffuse colour C_d")
    for k in range(1, material.lobes + 1):
        lobe = f"lobe{k}"
        which = "the lobe" if material.lobes == 1 else f"lobe {k}"
        colour(lobe, f"Colour C_s of {which}")
        if f"{lobe}.x" in channels:
            slope = pictures.directions_map(channels[f"{lobe}.x"], channels[f"{lobe}.y"])
            maps.append((f"Slope of the facets of {which}: hue is its direction (red: +weft), full at 0.6", slope))
            wide, narrow = _widths(*(channels[f"{lobe}.{name}"] for name in ("xx", "xy", "yy")))
            maps.append((f"Width of {which} along its long axis, to 0.6", pictures.heat(wide, 0.6)))
            maps.append((f"Width of {which} along its short axis, to 0.6", pictures.heat(narrow, 0.6)))
    if "lobe1.theta" in channels:
        tangent = np.tan(np.clip(channels["lobe1.theta"], 0, 1.2))
        phi = channels["lobe1.phi"]
        maps.append(
            (
                "Normal of Eq. 3: hue is its azimuth",
                pictures.directions_map(tangent * np.cos(phi), tangent * np.sin(phi)),
            )
        )
        maps.append(("dt, to 0.6 rad", pictures.heat(channels["lobe1.dt"], 0.6)))
        maps.append(("dp, to π", pictures.heat(channels["lobe1.dp"], math.pi)))
    if (channels["bound"] < 1).any():
        maps.append(("Where the albedo bound clamps (pale: by half)", pictures.heat(1 - channels["bound"], 0.5)))
    return maps


def _widths(
    xx: NDArray[np.float32], xy: NDArray[np.float32], yy: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    middle, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return np.sqrt(middle + spread), np.sqrt(np.maximum(middle - spread, 0))


def _errors(errors: Values, plan: Plan) -> Values:
    theta = {light.name: light.theta for light in plan.lights}
    judged = {name: m for name, m in errors["methods"].items() if "psnr" in m}
    rows = [
        {
            "name": name,
            "swatch": charts.colour(k),
            "relative": f"{m['relative_error']:.3f}",
            "psnr": f"{m['psnr']:.2f}",
            "worst": f"{m['psnr_min']:.2f}",
            "median": f"{m['texel_median']:.3f}",
            "p95": f"{m['texel_p95']:.3f}",
            "above": f"{100 * m['texels_above_1']:.2f} %",
        }
        for k, (name, m) in enumerate(judged.items())
    ]
    names = list(errors["regions"])
    series = [(name, [m["regions"][region]["relative_error"] for region in names]) for name, m in judged.items()]
    angles = [(name, [(theta[light], e["psnr"]) for light, e in m["lights"].items()]) for name, m in judged.items()]
    return {
        "methods": rows,
        "error_note": (
            f"Relative error is √(Σ w (m − g)² / Σ w g²) in linear light, so highlights decide it; PSNR is that of"
            f" {errors['psnr_of']}. 'above 1' is the share of texels whose own relative error is more than 1."
        ),
        "by_region": Markup(charts.grouped(names, series, "relative error")) if judged else "",
        "by_angle": Markup(charts.by_angle(angles, "PSNR, dB")) if judged else "",
    }


def _costs(errors: Values) -> Values:
    rows, points = [], []
    for name, method in errors["methods"].items():
        fit = method["fit"]
        rows.append(
            {
                "name": name,
                "us": f"{fit['microseconds_per_texel']:.1f}",
                "seconds": f"{fit['cpu_seconds']:.2f}",
                "reading": f"{fit['read_seconds']:.2f}",
                "peak": fit["peak_mb"],
                "bytes": fit["bytes_per_texel"],
                "clamped": f"{100 * fit['clamped_share']:.1f} %",
            }
        )
        if method.get("relative_error", 0) > 0:
            points.append((name, max(fit["microseconds_per_texel"], 0.01), method["relative_error"]))
    chart = charts.scatter(points, "fit, µs CPU a texel", "relative error, held-out lights") if points else ""
    note = f"Down and to the left is better. {errors['training_lights']} lights were fitted."
    return {"costs": rows, "chart": Markup(chart), "chart_note": note}


def stage_times(folder: Path) -> list[tuple[str, float, str]]:
    """Seconds of each stage from the benchmark files of its jobs, longest first."""
    seconds: dict[str, float] = {}
    memory: dict[str, float] = {}
    for path in sorted(folder.glob("*.tsv")):
        stage = path.name.split(".")[0]
        with path.open(newline="") as file:
            for row in csv.DictReader(file, delimiter="\t"):
                seconds[stage] = seconds.get(stage, 0) + float(row["s"])
                try:
                    memory[stage] = max(memory.get(stage, 0), float(row["max_rss"]))
                except ValueError:  # a job too short to be measured
                    continue
    rows = sorted(seconds.items(), key=lambda item: -item[1])
    return [(stage, s, f"{s:.1f} s" + (f", {memory[stage]:.0f} MB" if stage in memory else "")) for stage, s in rows]


def _mesh(results: Path) -> Values:
    value: Values = read_json(results / "mesh.json")
    return {key: v for key, v in value.items() if not isinstance(v, dict | list)}


def _need(need: Values) -> list[tuple[str, str]]:
    """What the scene asks of the fabric, in words."""
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


def _plain(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _rec709(acescg: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(acescg @ TO_REC709.T, np.float32)


def _css(rgb: NDArray[Any]) -> str:
    r, g, b = (int(v) for v in rgb)
    return f"rgb({r},{g},{b})"
