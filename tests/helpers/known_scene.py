"""A capture made by hand: the simulated camera before a scene whose radiance is known."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinran.base.files import sha256, write_json
from kinran.data.capture_plan import Plan, Shot
from kinran.virtual.sensor import Sensor
from kinran.virtual.simulated_camera import SimulatedCamera
from kinran.virtual.weave import VirtualFabric

EXPOSURES = (1 / 25, 1 / 100, 1 / 250, 1 / 1000, 1 / 4000)
SCENE = {"texels": 32, "field_mm": 4.8, "lamp_mm": 600.0, "seed": 3}


@dataclass
class Rig:
    """A goniometer that stands where it is told, under a lamp that drifts."""

    pose: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    shutter_open: bool = True
    lamp_seconds: float = 600.0

    @property
    def lamp_output(self) -> float:
        return 1 + 0.02 * np.sin(self.lamp_seconds / 40) - 0.15 * np.exp(-self.lamp_seconds / 300)


def radiance(theta: float, phi: float, texels: int) -> np.ndarray:
    """A scene of known radiance (texels, texels, 3): dark silk, a bright lobe, a brighter corner."""
    y, x = np.meshgrid(np.linspace(0, 1, texels), np.linspace(0, 1, texels), indexing="ij")
    silk = 10.0 ** (-2.7 + 2.4 * x)
    sine = 0.3 * np.sin(theta)
    across, along = (x - 0.5 - sine * np.cos(phi)) / 0.08, (y - 0.5 - sine * np.sin(phi)) / 0.2
    lobe = 12 * np.exp(-(across**2 + along**2))
    value = (silk + lobe) * np.cos(theta) + (30.0 if theta else 0.0) * ((x < 0.1) & (y > 0.9))
    return (value[..., None] * np.array([1.0, 0.7, 0.4])).astype(np.float32)


def shoot(
    folder: Path, plan: Plan, groups: tuple[str, ...] = (), sensor: Sensor | None = None, texels: int = 32
) -> list[Path]:
    """Photograph a plan, or some groups of it; returns the manifests. Traced frames come from `radiance`."""
    cache, rig = folder / "cache", Rig()
    fabric = VirtualFabric(**{**SCENE, "texels": texels})
    camera = SimulatedCamera(rig, folder / "card", {**SCENE, "texels": texels}, cache)
    camera._sensor = sensor or Sensor()
    manifests = []
    for group in plan.groups:
        if groups and group.name not in groups:
            continue
        shots = []
        for shot in group.shots:
            rig.pose = (1000 * shot.theta, 1000 * shot.phi, 0.0, 0.0)
            _put(cache, fabric, shot)
            camera.place("fabric" if shot.kind in ("light", "monitor") else shot.kind)
            photodiode, time = 1e5 * rig.lamp_output, rig.lamp_seconds
            frames = []
            for seconds in plan.exposures_s:
                camera.expose(seconds)
                name = camera.card()[-1].name
                to = folder / "frames" / f"{shot.shot}_{round(1 / seconds)}.dng"
                to.parent.mkdir(exist_ok=True)
                camera.download(name, to)
                camera.delete(name)
                entry = {"file": f"frames/{to.name}", "sha256": sha256(to), "bytes": to.stat().st_size}
                frames.append({**entry, "exposure_s": seconds})
            rig.lamp_seconds += 12
            entry = {"shot": shot.shot, "kind": shot.kind, "light": shot.light, "revision": 0}
            pose = [round(p) for p in rig.pose]
            shots.append({**entry, "pose_mdeg": pose, "photodiode": photodiode, "time_s": time, "frames": frames})
        path = folder / "groups" / f"{group.name}.json"
        path.parent.mkdir(exist_ok=True)
        write_json(
            path,
            {
                "version": 1,
                "fabric": plan.fabric,
                "group": group.name,
                "plan_sha256": plan.sha256,
                "kind": plan.kind,
                "lights": list(group.lights),
                "shots": shots,
            },
        )
        manifests.append(path)
    return manifests


def _put(cache: Path, fabric: VirtualFabric, shot: Shot) -> None:
    theta, phi = round(1000 * shot.theta), round(1000 * shot.phi) if shot.theta else 0
    path = cache / fabric.digest() / f"{theta}_{phi}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, radiance(np.radians(theta / 1000), np.radians(phi / 1000), fabric.texels))


@dataclass
class Capture:
    """A capture on disk."""

    folder: Path
    plan: Plan
    plan_path: Path
    manifests: list[Path]

    def manifest(self, name: str) -> Path:
        return self.folder / "groups" / f"{name}.json"
