"""The files of a finished run, made by hand in a second: what stages read, with the checksums that stages write."""

from pathlib import Path

import numpy as np
from PIL import Image

from kinran.base.exr import write_exr, write_rgb
from kinran.base.files import sha256, write_json
from kinran.capture.grid import plan_grid
from kinran.capture.journal import Journal
from kinran.data.capture_plan import write_plan
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.scene.mesh import write_mesh
from kinran.virtual.scan import write_scan
from kinran_bsdf import Material, write_material

SIZE = (20, 24)
LIGHTS = tuple(Light(f"l{k}", (0.0, 0.6, 0.8), None, (0, k), k % 4 == 0) for k in range(19))


def write_run(folder: Path, fabric: str = "swatch") -> Path:
    """Write a run with captures and results of one fabric; returns the folder of its results."""
    results = folder / "results" / fabric
    rng = np.random.default_rng(1)
    write_captured(folder / "captures" / fabric, fabric, rng)
    write_stack(results, rng)
    labels = rng.integers(0, 2, SIZE)
    write_labels(results / "labels.exr", labels, np.ones(SIZE, np.float32), 1 - labels, np.ones(SIZE, np.float32))
    write_regions(results / "regions.json", [Region(k, f"thread {k}", 5, (0.1, 0.2, 0.3), 0.5) for k in range(2)])
    write_exr(results / "statistics.exr", {f"median.{c}": rng.random(SIZE).astype(np.float32) for c in "RGB"})
    write_rgb(results / "render.exr", rng.random((8, 8, 3)).astype(np.float32))
    Image.fromarray(rng.integers(0, 255, (8, 8, 3), np.uint8)).save(results / "render.png")
    (results / "fit").mkdir()
    for name in ("material.exr", "fit/slope.exr"):
        write_material(results / name, material(rng))
    for name in ("calibration", "evaluation", "need", "fit/prior", "fit/slope"):
        write_json(results / f"{name}.json", {"fabric": fabric, "values": rng.random(40).tolist()})
    x, y = (part.ravel() for part in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    corners = np.array([[k, k + 1 + 5 * turn, k + 6 - turn] for k in range(19) if k % 5 < 4 for turn in (0, 1)])
    vertices = np.stack([x, y, 0 * x], -1)
    write_mesh(results / "scene" / "mesh.ply", vertices, corners, vertices[:, :2])
    write_scan(results / "scan.ply", vertices, corners)
    return results


def material(rng: np.random.Generator) -> Material:
    """A diffuse material of random texels."""
    names = ("label", "bound", *(f"diffuse.{name}" for name in ("R", "G", "B", "amplitude", "x", "y")))
    return Material(
        channels={name: rng.uniform(0.1, 1, SIZE).astype(np.float32) for name in names},
        model="lambert",
        tail="gaussian",
        lobes=0,
        regions=[{"label": 0, "name": "cloth", "model": "lambert"}],
        colour="lin_ap1_scene",
        from_stack=np.eye(3),
        texel_mm=0.1,
        source="0" * 64,
        theta_max=1.4,
    )


def write_stack(results: Path, rng: np.random.Generator) -> None:
    """Write a stack of 19 lights, whose first two shards have a receipt as a merge job writes it."""
    stack = results / "radiance.zarr"
    values = rng.random((19, *SIZE, 3)).astype(np.float32)
    radiance = Radiance(values, rng.integers(0, 2, values.shape).astype(np.uint8))
    merged = write_shards(stack, 0, radiance[:16])
    write_shards(stack, 16, radiance[16:])
    write_metadata(stack, Metadata(LIGHTS, *SIZE, 0.06, "", "", "camera", np.eye(3), {"kind": "raw"}))
    digests = {path.relative_to(stack).as_posix(): sha256(path) for path in merged}
    write_json(results / "merged" / "00.json", {"group": "00", "shards": [0, 1], "sha256": digests, "lights": 16})


def write_captured(capture: Path, fabric: str, rng: np.random.Generator) -> None:
    """Write plan, journal, frames and manifests of a capture; its frames are PNG."""
    plan = plan_grid(fabric, (0, 40), 4, (1 / 25,), 4)
    write_plan(capture / "plan.json", plan)
    with Journal(capture / "journal.jsonl") as journal:
        journal.append({"t": "start", "plan": plan.sha256})
    for group in plan.groups:
        shots = []
        for shot in group.shots:
            path = capture / "frames" / group.name / f"{shot.shot}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(rng.integers(0, 255, (6, 7, 3), np.uint8)).save(path)
            frame = {"file": path.relative_to(capture).as_posix(), "sha256": sha256(path), "bytes": 1}
            entry = {"shot": shot.shot, "kind": shot.kind, "light": shot.light, "revision": 0}
            shots.append({**entry, "frames": [{**frame, "exposure_s": 0.04}]})
        manifest = {"version": 1, "group": group.name, "plan_sha256": plan.sha256, "kind": plan.kind, "shots": shots}
        write_json(capture / "groups" / f"{group.name}.json", manifest)
