"""Find what a scene needs of a fabric, before any fit, so that no more is modelled than is seen.

The template is loaded with the mesh and the label map in place of a material, and rays are shot from the camera
to the cloth and from there to the lights, without path tracing. The answer is a JSON:

template        name of the scene
asked           a digest of what the template says, and one of the code that answers
camera          width, height: pixels of the picture
rays            number of rays from the camera, spread evenly over the picture
cloth_share     share of the picture's pixels, in [0, 1], that show the cloth
front_share     share of the cloth's pixels that show its front; only these count in view and half_vector
shown_from      least share of the cloth's pixels from which a region counts as shown
regions         a row each: label, name, share of the cloth's pixels, needed: whether it is shown
footprint       of a pixel on the cloth
    unit            "texels a pixel", of the lengths narrow and wide
    narrow, wide    p5, median, p95 of the short and the long axis of the footprint in texels
    texel_mm        side of a texel as it lies on the cloth, mm
    coarsest_factor whole number of texels, along a side, that can be averaged to one unseen: a third of narrow's p5,
                    at least 1
    coarsest_mm     side of such a texel on the cloth, mm
view            unit "rad"; median, p95, max of θ_v, the angle of the view from the shading normal
half_vector     unit "rad"
    measured        θ_h up to which the stack has lights to fit: half of their largest θ_l
    all             whether light comes from all around (environment), and so half vectors from everywhere
    median, p95, max    of θ_h over the lights that have a place; null if none of them reaches the cloth
    outside         share of the pixels with a half vector beyond `measured`, from any of these lights
    emitters        a row each: id; kind (point, directional, area or environment); lit: share of the pixels that
                    it reaches, outside: as above, for this one; median, p95, max of θ_h. For an environment
                    the word "all" stands in place of each.
"""

import logging
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import mitsuba
import numpy as np
from numpy.typing import NDArray

from kinran.base.exr import write_exr
from kinran.base.files import InputError, write_json
from kinran.data.fabric import Fabric
from kinran.data.labels import LabelMap, Region
from kinran.data.needed_regions import SHOWN
from kinran.scene.placement import placement, uv_size
from kinran.scene.stand_in import stand_in
from kinran.scene.template import need_key

mi: Any = mitsuba  # its types are those of the variant, at run time

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

RAYS = 1 << 15
"""Rays from the camera: where the cloth fills the picture, a region that fills a thousandth of it
(`needed_regions.SHOWN`) is met by about thirty."""
COARSE = 1 / 3
"""Side of a coarse texel, in pixels, that nobody sees: the finest grating that pixels can carry keeps sinc²(1/6) = 0.91
of its contrast when it is averaged over such texels and their averages are held."""
SHARP = 5
"""Percentage of the pixels that may be sharper than the one that decides: a few pixels at the rim of the cloth or where
it bulges to the camera do not make all maps finer. No measurement stands behind the percentage."""
ENVIRONMENT = "environment"
HIGH = {"median": 50, "p95": 95, "max": 100}
AROUND = {"p5": 5, "median": 50, "p95": 95}


@dataclass(frozen=True)
class Inputs:
    template: Annotated[Path, "scene with defaults, such as scenes/drape.xml"]
    mesh: Annotated[Path, "PLY that kinran mesh made"]
    fabric: Annotated[Path, "folder of radiance stack, label map and regions"]


@dataclass(frozen=True)
class Options:
    asked: Annotated[str | None, "what to note as the question; that of the template if not given"] = None


def main(
    inputs: Inputs, out: Annotated[Path, "OUT", "needs of the scene (.json)"], options: Options = Options()
) -> None:
    """Write the needs of the scene, and log them in one line."""
    result = need(inputs.template, inputs.mesh, Fabric(inputs.fabric))
    write_json(out, {**result, "asked": options.asked or need_key(inputs.template)})
    unseen = [row["name"] for row in result["regions"] if not row["needed"]]
    log.info(
        "need: %.2f texels a pixel, %d can be averaged; not shown: %s",
        result["footprint"]["narrow"]["median"],
        result["footprint"]["coarsest_factor"],
        ", ".join(unseen) or "none",
    )


@dataclass(frozen=True)
class SceneLight:
    """A light of the scene: its id (or kind and number), its kind, and Mitsuba's emitter."""

    id: str
    kind: str
    emitter: Any


@dataclass(frozen=True)
class Sight:
    """Hits of the camera's rays on the cloth.

    Attributes
    ----------
    labels : (ray,) int
        Label of the region.
    cos_v : (ray,) float
        Cosine of the angle between view and shading normal; negative where the cloth shows its back.
    footprint : (ray, 2, 2) float
        Steps in texels, along columns and rows of the map, for one pixel to the right and one pixel down.
    theta_h : (ray, light) float
        Angle between half vector and shading normal in radians; NaN where the light does not reach the front.
    """

    labels: NDArray[np.intp]
    cos_v: Array
    footprint: Array
    theta_h: Array


def spread(count: int, dimensions: int) -> Array:
    """Points (count, dimensions) that cover the unit cube evenly, without a period that could match that of a weave.

    They are the additive recurrence of the x with x^(dimensions + 1) = x + 1, the golden ratio in one dimension.
    """
    ratio = 2.0
    for _ in range(64):
        ratio = (1 + ratio) ** (1 / (dimensions + 1))
    steps = ratio ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.arange(count)[:, None] * steps) % 1)


def load(template: Path, mesh: Path, labels: LabelMap, lie: dict[str, str]) -> tuple[Any, set[str]]:
    """Load the template with the mesh and, in place of a material, the labels.

    Parameters
    ----------
    template, mesh
        The same files that `kinran scene` takes; other files of the template are looked for beside the mesh, where
        the scene will be.
    labels : (y, x) int
        Row 0 is v = 0.
    lie
        Defaults of the template that place the maps on the cloth.

    Returns
    -------
    scene, ids
        The scene, in `scalar_rgb`, and the ids of the cloth's BSDFs.

    Raises
    ------
    InputError
        Mitsuba refuses the template.
    """
    mi.set_variant("scalar_rgb")
    resolver = mi.file_resolver()
    beside = mi.FileResolver(resolver)
    beside.prepend(str(mesh.parent.resolve()))
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "labels.exr"
        write_exr(picture, {"Y": labels.astype(np.float32)})
        xml, ids = stand_in(template, picture)
        mi.set_file_resolver(beside)
        try:
            return mi.load_string(xml, optimize=False, mesh=str(mesh.resolve()), **lie), ids
        except Exception as error:  # Mitsuba raises bare RuntimeError
            reason = " ".join(str(error).split())
            raise InputError(
                f"{template}: Mitsuba cannot load it ({reason}); compare it with scenes/drape.xml"
            ) from None
        finally:
            mi.set_file_resolver(resolver)


def lights_of(scene: Any) -> list[SceneLight]:
    """The lights of a scene; an area light has the id of its shape."""
    kinds = {
        ENVIRONMENT: mi.EmitterFlags.Infinite,
        "directional": mi.EmitterFlags.DeltaDirection,
        "point": mi.EmitterFlags.DeltaPosition,
    }
    lights = []
    for number, emitter in enumerate(scene.emitters()):
        kind = next((name for name, flag in kinds.items() if mi.has_flag(emitter.flags(), flag)), "area")
        shape = emitter.get_shape()
        lights.append(SceneLight(emitter.id() or (shape and shape.id()) or f"{kind} {number}", kind, emitter))
    return lights


def look(scene: Any, cloth: set[str], lights: list[SceneLight], size: tuple[int, int], rays: int) -> Sight:
    """Shoot rays from the camera to the cloth, and from there one to each light.

    Parameters
    ----------
    scene, cloth
        Scene and ids of the cloth's BSDFs, as `load` gives them.
    lights
        Lights with a place.
    size
        Rows and columns of the label map.
    rays
        Number of rays from the camera.

    Raises
    ------
    InputError
        The camera has no pixels of one size (such as a radiance meter).
    """
    sensor = scene.sensors()[0]
    to_texels: dict[str, Array] = {}
    labels, cos_v, footprint, theta_h = [], [], [], []
    for x, y, a, b in spread(rays, 4).tolist():
        ray, _ = sensor.sample_ray_differential(0, 0.5, [x, y], [0.5, 0.5])
        if not ray.has_differentials:
            raise InputError(f"{sensor.class_name()}: its rays have no width; use a perspective camera")
        si = scene.ray_intersect(ray)
        bsdf = si.bsdf() if si.is_valid() else None
        if bsdf is None or (name := bsdf.id()) not in cloth:
            continue
        if name not in to_texels:
            matrix = np.array(mi.traverse(bsdf)["reflectance.to_uv"].matrix)[:2, :2]
            to_texels[name] = np.array(size[::-1])[:, None] * matrix
        si.compute_uv_partials(ray)
        labels.append(round(bsdf.eval_diffuse_reflectance(si)[0]))
        cos_v.append(si.wi.z)
        footprint.append(to_texels[name] @ np.array([si.duv_dx, si.duv_dy], float).T)
        theta_h.append([_theta_h(scene, si, light.emitter, [a, b]) for light in lights])
    return Sight(
        np.array(labels, np.intp),
        np.array(cos_v, float),
        np.array(footprint, float).reshape(-1, 2, 2),
        np.array(theta_h, float).reshape(len(labels), len(lights)),
    )


def _theta_h(scene: Any, si: Any, emitter: Any, sample: list[float]) -> float:
    """Angle of the half vector for a point of a light, NaN where it does not reach the front of the cloth."""
    ds, weight = emitter.sample_direction(si, sample)
    light = si.to_local(ds.d)
    if min(si.wi.z, light.z) <= 0 or max(weight) <= 0 or scene.ray_test(si.spawn_ray_to(ds.p)):
        return float("nan")
    x, y, z = np.add(si.wi, light)
    return float(np.arctan2(np.hypot(x, y), z))


def axes(footprint: Array) -> tuple[Array, Array]:
    """Short and long axes (n,) of the footprints that linear maps (n, 2, 2) make of a pixel."""
    finite = footprint[np.isfinite(footprint).all((1, 2))]
    sizes = np.asarray(np.linalg.svd(finite, compute_uv=False), np.float64)
    return sizes[:, 1], sizes[:, 0]


def answer(
    sight: Sight,
    lights: list[SceneLight],
    placed: list[SceneLight],
    regions: list[Region],
    texel_mm: float,
    measured: float,
) -> dict[str, Any]:
    """Needs of the pixels that show the cloth: the part of the JSON above from `front_share` on.

    Parameters
    ----------
    sight
        Hits of the rays on the cloth; there is at least one.
    lights, placed
        All lights, and those that `sight` has half vectors for.
    regions
        Regions of the fabric.
    texel_mm
        Side of a texel on the cloth.
    measured
        Largest measured θ_h, in radians.
    """
    narrow, wide = axes(sight.footprint)
    side = COARSE * float(np.percentile(narrow, SHARP)) if len(narrow) else 0.0
    factor = max(1, int(round(side, 3)))  # 3.9999 texels in single precision are 4
    shares = {region.label: float((sight.labels == region.label).mean()) for region in regions}
    front = sight.cos_v > 0
    theta_h = sight.theta_h[front]
    outside = theta_h > measured  # NaN is not
    rows = []
    for light in lights:
        if light not in placed:
            values: dict[str, Any] = dict.fromkeys(("lit", "outside", *HIGH), "all")
        else:
            k = placed.index(light)
            values = {"lit": _mean(np.isfinite(theta_h[:, k])), "outside": _mean(outside[:, k]), **_high(theta_h[:, k])}
        rows.append({"id": light.id, "kind": light.kind, **values})
    return {
        "front_share": _mean(front),
        "shown_from": SHOWN,
        "regions": [
            {"label": r.label, "name": r.name, "share": round(shares[r.label], 5), "needed": shares[r.label] >= SHOWN}
            for r in regions
        ],
        "footprint": {
            "unit": "texels a pixel",
            "narrow": _spread(narrow),
            "wide": _spread(wide),
            "texel_mm": round(texel_mm, 5),
            "coarsest_factor": factor,
            "coarsest_mm": round(factor * texel_mm, 5),
        },
        "view": {"unit": "rad", **_high(np.arccos(np.clip(sight.cos_v[front], 0, 1)))},
        "half_vector": {
            "unit": "rad",
            "measured": round(measured, 5),
            "all": len(placed) < len(lights),
            **_high(theta_h),
            "outside": _mean(np.any(outside, axis=1)),
            "emitters": rows,
        },
    }


def _high(values: Array) -> dict[str, float | None]:
    return _percentiles(values, HIGH)


def _spread(values: Array) -> dict[str, float | None]:
    return _percentiles(values, AROUND)


def _percentiles(values: Array, which: dict[str, int]) -> dict[str, float | None]:
    known = values[np.isfinite(values)]
    return {name: round(float(np.percentile(known, at)), 5) if len(known) else None for name, at in which.items()}


def _mean(values: NDArray[np.bool_]) -> float:
    return round(float(values.mean()), 5) if len(values) else 0.0


def need(template: Path, mesh: Path, fabric: Fabric, rays: int = RAYS) -> dict[str, Any]:
    """Find what a scene needs of a fabric, and return the JSON above.

    Raises
    ------
    InputError
        A file is missing or damaged, label map and stack are of different fabrics, or the camera sees no cloth.
    """
    stack, labels, regions = fabric.stack, fabric.labels, fabric.regions
    if unknown := set(np.unique(labels).tolist()) - {region.label for region in regions}:
        raise InputError(
            f"{fabric.regions_path}: has no region {min(unknown)}, which {fabric.labels_path} has;"
            " make both with kinran segment"
        )
    trained = stack.directions[~stack.held_out]
    if not len(trained):
        raise InputError(f"{stack.path}: has no light to fit; hold out fewer")
    lie = placement(labels.shape, stack.texel_mm, uv_size(mesh))
    scene, cloth = load(template, mesh, labels, lie)
    lights = lights_of(scene)
    placed = [light for light in lights if light.kind != ENVIRONMENT]
    sight = look(scene, cloth, placed, labels.shape, rays)
    if not len(sight.labels):
        raise InputError(f"{template}: its camera does not see the cloth of {mesh}; point it there")
    width, height = scene.sensors()[0].film().crop_size()
    texel_mm = 1 / (float(lie["repeat_x"]) * stack.width)
    measured = float(np.arccos(np.clip(trained[:, 2].min(), -1, 1))) / 2
    return {
        "template": template.name,
        "camera": {"width": int(width), "height": int(height)},
        "rays": rays,
        "cloth_share": round(len(sight.labels) / rays, 5),
        **answer(sight, lights, placed, regions, texel_mm, measured),
    }
