"""A path-traced woven fabric, the ground truth of the virtual rig: micro-geometry, never the model that is fitted."""

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.digest import digest
from kinran.base.files import atomic
from kinran.base.frames import direction
from kinran.base.shared_results import made
from kinran.virtual import yarn

Image = NDArray[np.float32]

COLOURS = {
    "red": {"red": (0.50, 0.030, 0.025), "blue": (0.03, 0.06, 0.35), "white": (0.70, 0.68, 0.60)},
    "indigo": {"red": (0.020, 0.035, 0.16), "blue": (0.48, 0.16, 0.045), "white": (0.62, 0.62, 0.52)},
    "moss": {"red": (0.075, 0.13, 0.030), "blue": (0.22, 0.035, 0.17), "white": (0.66, 0.52, 0.20)},
}
"""Linear Rec. 709 colours of the silk by the name of the threads. They are made up, for a ground with threads of other
colours (Takeda2008, §2.1). The materials have the names of the red fabric's colours in all."""
DEPTH = 6
"""Longest path of light in segments, meant to leave out only light under the noise of the frames. No measurement stands
behind it."""


@dataclass(frozen=True)
class VirtualFabric:
    """A brocade of micro-geometry before a camera and a lamp at finite distances.

    Attributes
    ----------
    field_mm
        Side of the square field.
    texels
        Texels along each side.
    samples
        Paths per texel.
    seed
        Seed of the threads' irregularities.
    lamp_mm, camera_mm
        Distances of the point lamp and of the pinhole from the middle of the field.
    motif
        Figure that the floats draw, one of `yarn.MOTIFS`.
    threads
        Colours of the silk, one of `COLOURS`.
    """

    field_mm: float = 4.8
    texels: int = 80
    samples: int = 32
    seed: int = 7
    lamp_mm: float = 600.0
    camera_mm: float = 600.0
    motif: str = "comma"
    threads: str = "red"

    names = yarn.MATERIALS
    """Names of the labels."""

    def digest(self) -> str:
        """Return a digest of the parameters and the code of the scene, 16 hexadecimal digits."""
        key = json.dumps([digest("kinran.virtual.weave"), asdict(self)], sort_keys=True)
        return hashlib.sha256(key.encode()).hexdigest()[:16]

    def trace(self, light: ArrayLike) -> Image:
        """Path-trace the field under a lamp in this direction.

        Parameters
        ----------
        light : (3,) float
            Unit vector from the middle of the field to the lamp.

        Returns
        -------
        (texels, texels, 3) float32
            π·T, linear Rec. 709: a white diffuser that faces the lamp in the middle of the field reads 1.
            Row 0 is v = 0, the bottom. The same direction gives the same values.
        """
        import mitsuba as mi

        vector = np.asarray(light, float)
        parameters = self._parameters
        parameters["lamp.position"] = mi.Point3f(*(self.lamp_mm * vector).tolist())
        parameters.update()
        seed = int.from_bytes(hashlib.sha256(np.round(vector, 6).tobytes()).digest()[:4], "little")
        image = np.array(mi.render(self._scene, spp=self.samples, seed=seed), np.float32)
        return np.ascontiguousarray(np.pi * image[::-1])

    def frame(self, theta_mdeg: int, phi_mdeg: int, cache: Path) -> Image:
        """Return `trace` of a pose in millidegrees, from the folder `cache` where it was traced before."""
        pose = (theta_mdeg, phi_mdeg % 360_000 if theta_mdeg else 0)
        path = cache / self.digest() / f"{pose[0]}_{pose[1]}.npy"
        with suppress(OSError, ValueError, EOFError):  # not yet there, or cut off
            return np.asarray(np.load(path, allow_pickle=False), np.float32)

        def write() -> None:
            image = self.trace(direction(*np.radians(np.array(pose) / 1000)))
            with atomic(path) as temporary, temporary.open("wb") as file:
                np.save(file, image)

        def follows() -> Any:
            import drjit

            return self, pose, drjit.detail.llvm_version()  # the compiler is the system's, which no lock file has

        made("pictures of the virtual fabric", "kinran.virtual.weave", follows, {"picture.npy": path}, write)
        return np.asarray(np.load(path, allow_pickle=False), np.float32)

    def labels(self) -> tuple[NDArray[np.uint8], Image]:
        """Return the true label map: the material that most of 6 × 6 rays through a texel meet first.

        Returns
        -------
        label : (texels, texels) uint8
            Index into `names`; row 0 is v = 0.
        purity : (texels, texels) float32
            Share of the rays that meet this material.
        """
        import drjit as dr
        import mitsuba as mi

        rays, scene = 6, self._scene
        n = self.texels * rays
        index = dr.arange(mi.UInt32, n * n)
        film = mi.Point2f((mi.Float(index % n) + 0.5) / n, (mi.Float(index // n) + 0.5) / n)
        ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, film, mi.Point2f(0.5, 0.5))
        met = np.array(dr.reinterpret_array(mi.UInt32, scene.ray_intersect(ray).shape))
        material = np.zeros(met.shape, int)
        for shape in scene.shapes():
            name = shape.id().split("-")[0]
            if name in self.names:
                handle = np.array(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)))[0]
                material[met == handle] = self.names.index(name)
        grid = material.reshape(self.texels, rays, self.texels, rays).transpose(0, 2, 1, 3)[::-1]
        share = np.stack([(grid == k).mean((2, 3)) for k in range(len(self.names))], -1)
        return share.argmax(-1).astype(np.uint8), share.max(-1).astype(np.float32)

    @cached_property
    def _scene(self) -> Any:
        return load_scene(self, yarn.weave(self.field_mm, self.seed, self.motif))

    @cached_property
    def _parameters(self) -> Any:
        import mitsuba as mi

        return mi.traverse(self._scene)


def load_scene(fabric: VirtualFabric, surfaces: list[yarn.Surface]) -> Any:
    """Return a Mitsuba scene of surfaces on a dark backing, before the camera and under the lamp of `fabric`."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    bsdfs = {name: mi.load_dict(material) for name, material in _materials(fabric.threads).items()}
    half = fabric.field_mm / 2 + yarn.MARGIN
    transform = mi.ScalarTransform4f
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 20},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(fabric.field_mm / 2 / fabric.camera_mm))),
            "near_clip": 0.9 * fabric.camera_mm,
            "far_clip": 2 * fabric.camera_mm,
            "to_world": transform().look_at([0, 0, fabric.camera_mm], [0, 0, 0], [0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": fabric.texels,
                "height": fabric.texels,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
        },
        "lamp": {
            "type": "point",
            "position": [0, 0, fabric.lamp_mm],
            "intensity": {"type": "rgb", "value": fabric.lamp_mm**2},  # irradiance 1 in the middle
        },
        "backing": {
            "type": "rectangle",
            "to_world": transform().translate([0, 0, -0.25]) @ transform().scale([half, half, 1]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.15, 0.02, 0.02]}},
        },
    }
    for k, surface in enumerate(surfaces):
        name = yarn.MATERIALS[surface.material]
        scene[f"{name}-{k}"] = _mesh(f"{name}-{k}", surface, bsdfs[name])
    return mi.load_dict(scene)


def _materials(threads: str) -> dict[str, dict[str, Any]]:
    silk = {
        name: {
            "type": "principled",
            "base_color": {"type": "rgb", "value": list(colour)},
            "roughness": 0.42 if name == "red" else 0.38,
            "anisotropic": 0.8,
            "specular": 0.5,
            "spec_tint": 0.2,
            "sheen": 0.3,
            "sheen_tint": 0.5,
        }
        for name, colour in COLOURS[threads].items()
    }
    leaf = {
        "type": "roughconductor",
        "material": "Au",
        "distribution": "ggx",
        "alpha_u": 0.10,
        "alpha_v": 0.20,
    }
    return {**silk, "gold": {"type": "twosided", "bsdf": leaf}}


def _mesh(name: str, surface: yarn.Surface, bsdf: Any) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = bsdf
    faces = surface.faces()
    size = surface.points.shape[0] * surface.points.shape[1]
    mesh = mi.Mesh(name, size, len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = surface.points.astype(np.float32).ravel()
    values["vertex_normals"] = surface.normals.astype(np.float32).ravel()
    values["vertex_texcoords"] = surface.uv.astype(np.float32).ravel()
    values["faces"] = faces.ravel()
    values.update()
    return mesh
