"""Measure the BSDF, as JSON: time per sample, variance, table interpolation, compilation, memory.

Run with `python benchmarks/bsdf.py [--out FILE] [--large] [--variant cuda_ad_rgb]`. Times are process CPU times,
on a GPU wall times; the contenders take turns, and medians of the rounds count. Only ratios within one run mean
anything.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import kinran_bsdf
from kinran_bsdf import Material
from kinran_bsdf.material import COLOUR
from kinran_bsdf.relight import relight

ROUNDS = 9
"""Rounds of all BSDFs in turn, whose medians count. A choice."""


def material(size: int, model: str = "slope", lobes: int = 1, width: float = 0.15, tail: str = "gaussian") -> Material:
    """Material of woven gold on silk: slopes along the ribs of a twill, amplitudes that vary from texel to texel."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:size, :size].astype(np.float32)
    rib = np.sin(2 * np.pi * (x + y) / 8)
    one = np.ones((size, size), np.float32)
    maps = {"label": 0 * one, "bound": one, "diffuse.x": 0.1 * rib, "diffuse.y": 0 * one}
    colours = {"diffuse": (0.5, 0.1, 0.08), "lobe1": (1.0, 0.75, 0.35), "lobe2": (1.0, 0.8, 0.5)}
    for name in ["diffuse"] + [f"lobe{k + 1}" for k in range(lobes)]:
        maps |= {f"{name}.{c}": v * one for c, v in zip("RGB", colours[name], strict=True)}
        maps[f"{name}.amplitude"] = rng.uniform(0.5, 1, (size, size)) * (0.3 if name == "diffuse" else 0.05 / width**2)
    for k in range(1, lobes + 1):
        w = width * k
        if model == "takeda2008":
            shape = {"theta": 0.3 + 0.1 * rib, "phi": 0.5 * rib, "dt": w * one, "dp": 2 * w * one}
        else:
            shape = {"x": 0.25 * rib, "y": 0.1 * one, "xx": w**2 * one, "xy": 0 * one, "yy": 2 * w**2 * one}
        maps |= {f"lobe{k}.{name}": value for name, value in shape.items()}
    return Material(
        channels={name: np.asarray(value, np.float32) for name, value in maps.items()},
        model=model,
        tail=tail,
        lobes=lobes,
        regions=[{"label": 0, "name": "twill", "model": model}],
        colour=COLOUR,
        from_stack=np.eye(3),
        texel_mm=None,
        source="0" * 64,
        theta_max=float(np.radians(80)),
    )


def cloth(folder: Path, cells: int = 256) -> dict[str, Any]:
    """Mesh of a wavy sheet of 2 · cells² triangles, with +u along +x."""
    t = np.linspace(0, 1, cells + 1)
    u, v = np.meshgrid(t, t)
    z = 0.08 * np.sin(9 * u) * np.cos(7 * v)
    mesh = mi.Mesh("cloth", u.size, 2 * cells * cells, has_vertex_texcoords=True)
    p = mi.traverse(mesh)
    p["vertex_positions"] = np.stack([2 * u - 1, 2 * v - 1, z], -1).ravel().astype(np.float32)
    p["vertex_texcoords"] = np.stack([u, v], -1).ravel().astype(np.float32)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    faces = np.stack([i, i + 1, i + cells + 2, i, i + cells + 2, i + cells + 1], -1)
    p["faces"] = faces.ravel().astype(np.uint32)
    p.update()
    mesh.write_ply(str(folder / "cloth.ply"))
    return {"type": "ply", "filename": str(folder / "cloth.ply")}


def scene(shape: dict[str, Any], bsdf: dict[str, Any], size: int, light: str, depth: int = 4) -> Any:
    lamp = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at(origin=[1, 1, 2.5], target=[0, 0, 0], up=[0, 1, 0])
        @ mi.ScalarTransform4f().scale([0.3, 0.3, 1]),
        "emitter": {"type": "area", "radiance": 20.0},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth},
            "sensor": {
                "type": "perspective",
                "fov": 45,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, -1.2, 2.4], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
            },
            "light": lamp if light == "area" else sky(light),
            "cloth": shape | {"bsdf": {"type": "twosided", "bsdf": bsdf}},
        }
    )


def sky(light: str) -> dict[str, Any]:
    if light == "constant":
        return {"type": "constant"}
    y, x = np.mgrid[:64, :128]
    sun = 400 * np.exp(-((x - 40) ** 2 + (y - 20) ** 2) / 8.0)
    picture = np.repeat((0.3 + 0.2 * np.cos(y / 10) + sun)[..., None], 3, -1).astype(np.float32)
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": mi.Bitmap(picture), "to_world": turn}


def picture(size: int, bands: int, low: float, high: float) -> dict[str, Any]:
    values = np.random.default_rng(2).uniform(low, high, (size, size, bands)).astype(np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": bands == 1, "filter_type": "bilinear"}


def contenders(folder: Path, size: int) -> dict[str, dict[str, Any]]:
    result: dict[str, dict[str, Any]] = {
        "diffuse": {"type": "diffuse", "reflectance": picture(size, 3, 0.2, 0.8)},
        "principled": {
            "type": "principled",
            "base_color": picture(size, 3, 0.2, 0.8),
            "roughness": picture(size, 1, 0.3, 0.5),
            "anisotropic": picture(size, 1, 0.2, 0.8),
            "metallic": 0.7,
        },
        "roughconductor": {
            "type": "roughconductor",
            "specular_reflectance": picture(size, 3, 0.2, 0.8),
            "alpha_u": picture(size, 1, 0.1, 0.2),
            "alpha_v": picture(size, 1, 0.2, 0.4),
        },
    }
    for name, model, lobes, tail in (
        ("slope one lobe", "slope", 1, "gaussian"),
        ("slope one lobe, GGX", "slope", 1, "ggx"),
        ("slope two lobes", "slope", 2, "gaussian"),
        ("takeda2008", "takeda2008", 1, "gaussian"),
    ):
        path = folder / f"{size}-{name.replace(' ', '-')}.exr"
        kinran_bsdf.write_material(path, material(size, model, lobes, tail=tail))
        result[name] = {"type": "kinran", "filename": str(path)}
    return result


def rendered(scene: Any, spp: int) -> None:
    """Render, and wait for it."""
    dr.eval(mi.render(scene, spp=spp, seed=1))


def on_gpu() -> bool:
    return str(mi.variant()).startswith("cuda")


def clock() -> float:
    """Seconds: of the CPU, or of the wall where a GPU works."""
    dr.sync_thread()
    return time.perf_counter() if on_gpu() else time.process_time()


def spent(run: Callable[[], Any]) -> float:
    start = clock()
    run()
    return clock() - start


def interleaved(runs: dict[str, Callable[[], Any]], rounds: int = ROUNDS) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(rounds):
        for name, run in runs.items():
            times[name].append(spent(run))
    return times


def ratios(times: dict[str, list[float]], base: str) -> dict[str, float]:
    """Ratio of each contender's time to that of `base` within a round, median over the rounds."""
    return {
        name: round(statistics.median(a / b for a, b in zip(t, times[base], strict=True)), 3)
        for name, t in times.items()
    }


def cost(folder: Path) -> dict[str, Any]:
    """Time of path tracing one scene, 512 × 512 pixels with 8 samples each (on a GPU 256)."""
    shape, result, spp = cloth(folder), {}, 256 if on_gpu() else 8
    for size in (128, 2048):
        scenes = {name: scene(shape, bsdf, 512, "area") for name, bsdf in contenders(folder, size).items()}
        times = interleaved({n: partial(rendered, s, spp) for n, s in scenes.items()})
        samples = 512 * 512 * spp
        result[f"{size}x{size}"] = {
            "ns_per_sample": {n: round(statistics.median(t) / samples * 1e9, 1) for n, t in times.items()},
            "over_diffuse": ratios(times, "diffuse"),
            "over_roughconductor": ratios(times, "roughconductor"),
        }
    return result


def register_cosine() -> None:
    """Register a BSDF that is evaluated as the one inside it, and sampled by the cosine."""

    class Cosine(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.inner = props["inner"]
            self.m_flags = self.inner.flags()
            self.m_components = [self.inner.flags(k) for k in range(self.inner.component_count())]

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            bs: Any = dr.zeros(mi.BSDFSample3f)
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf, bs.eta = bs.wo.z * dr.inv_pi, 1.0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            value = self.inner.eval(ctx, si, bs.wo, active) / dr.maximum(bs.pdf, 1e-8)
            return bs, value & (active & (si.wi.z > 0))

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.inner.eval(ctx, si, wo, active)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return dr.select(active & (si.wi.z > 0) & (wo.z > 0), wo.z * dr.inv_pi, 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    mi.register_bsdf("cosine", lambda props: Cosine(props))


def gain(folder: Path) -> dict[str, Any]:
    """Equal-time gain of sampling the lobe: variance · time of cosine sampling over that of lobe sampling.

    Light is direct only: with bounces, a few paths that find the sun by chance make up most of the variance.
    """
    register_cosine()
    shape, result = cloth(folder, 64), {}
    for width in (0.15, 0.05, 0.02):
        for model in ("slope", "takeda2008"):
            path = folder / f"gain-{model}-{width}.exr"
            kinran_bsdf.write_material(path, material(64, model, width=width))
            lobe = {"type": "kinran", "filename": str(path)}
            for light in ("constant", "envmap", "area"):
                work, means = {}, {}
                for name, bsdf in (("lobe", lobe), ("cosine", {"type": "cosine", "inner": lobe})):
                    s = scene(shape, bsdf, 96, light, depth=2)
                    mi.render(s, spp=32)
                    start = clock()
                    images = [np.array(mi.render(s, spp=32, seed=k)) for k in range(8)]
                    work[name] = float(np.var(images, 0, ddof=1).mean()) * (clock() - start)
                    means[name] = float(np.mean(images))
                result[f"{model}, width {width}, {light}"] = {
                    "gain": round(work["cosine"] / work["lobe"], 2),
                    "mean_ratio": round(means["cosine"] / means["lobe"], 4),
                }
    return result


def table(folder: Path) -> dict[str, Any]:
    """Time of a look-up against that of interpolation in a table of the paper's 1153 directions, 128 × 128 texels.

    The table is interpolated as the nearest published plugin does it: a search for the three nearest directions
    and a weighted mean, in NumPy.
    """
    from scipy.spatial import cKDTree

    size, n = 128, 1 << 18
    grid = [(0.0, 0.0)] + [(t, p) for t in range(5, 81, 5) for p in range(0, 360, 5)]
    theta, phi = np.radians(np.array(grid, float)).T
    lights = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    path = folder / "table.exr"
    m = material(size)
    kinran_bsdf.write_material(path, m)
    values = relight(m, lights).reshape(len(lights), -1, 3)
    tree, rng = cKDTree(lights), np.random.default_rng(3)
    bsdf = mi.load_dict({"type": "kinran", "filename": str(path), "filter": "nearest"})
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.Vector3f(0, 0, 1)
    si.uv = mi.Point2f(rng.random((2, n)).astype(np.float32))
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.random((2, n)).astype(np.float32)))
    dr.eval(si, wo)

    def interpolate() -> None:
        uv, light = np.array(si.uv), np.array(wo).T
        texel = (uv[1] * size).astype(int) * size + (uv[0] * size).astype(int)
        distance, index = tree.query(light, 3)
        weight = 1 / (distance + 1e-6)
        mean = (values[index, texel[:, None]] * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
        dr.eval(mi.Color3f(mean.T.astype(np.float32)))

    runs = {
        "kinran": lambda: dr.eval(bsdf.eval(mi.BSDFContext(), si, wo)),
        "table": interpolate,
    }
    times = interleaved(runs)
    return {
        "ns_per_look_up": {k: round(statistics.median(t) / n * 1e9, 1) for k, t in times.items()},
        "table_over_kinran": ratios(times, "kinran")["table"],
        "bytes_per_texel": {"kinran": 13 * 4, "table": len(lights) * 3 * 4},
    }


def compile_cold(folder: Path) -> Any:
    """Milliseconds that the backend takes to compile the render kernels of one scene, with an empty cache."""
    if os.environ.get("DRJIT_CACHE_DIR") != str(folder.parent):  # Dr.Jit reads it when it starts
        with tempfile.TemporaryDirectory() as cache:
            environment = os.environ | {"DRJIT_CACHE_DIR": cache, "TMPDIR": cache}
            command = [sys.executable, __file__, "--only", "compile", "--variant", str(mi.variant())]
            run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
            return json.loads(run.stdout)["compile"]
    shape, result = cloth(folder, 8), {}
    for name, bsdf in contenders(folder, 16).items():
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(mi.render(scene(shape, bsdf, 16, "area"), spp=1))
            history = [h for h in dr.kernel_history() if h["type"] == dr.KernelType.JIT]
        result[name] = round(sum(h["backend_time"] for h in history if not h["cache_hit"]), 1)
    return result


def memory(folder: Path, size: int) -> dict[str, float]:
    """Memory in MB of loading and rendering one fabric: that of Dr.Jit's arrays, and the peak of the process."""
    path = folder / f"memory-{size}.exr"
    if not path.exists():
        kinran_bsdf.write_material(path, material(size))
    code = f"""
import drjit as dr, mitsuba as mi
def status(key):
    line = next(line for line in open("/proc/self/status") if line.startswith(key))
    return int(line.split()[1]) / 1e3
mi.set_variant({mi.variant()!r})
import kinran_bsdf
before = status("VmRSS")
bsdf = mi.load_dict({{"type": "kinran", "filename": {str(path)!r}}})
si = dr.zeros(mi.SurfaceInteraction3f, 1000)
si.wi = mi.Vector3f(0, 0, 1)
dr.eval(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)))
dr.sync_thread()
print(status("VmRSS") - before, status("VmHWM") - before)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    held, peak = (round(float(v)) for v in out.split())
    return {
        "file": round(path.stat().st_size / 1e6, 1),
        "maps": round(size * size * 15 * 4 / 1e6),
        "held": held,
        "peak": peak,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write (default: print)")
    parser.add_argument("--large", action="store_true", help="measure the memory of 4096² and 6144² fabrics too")
    parser.add_argument("--only", choices=["cost", "gain", "table", "compile", "memory"])
    parser.add_argument("--variant", default="llvm_ad_rgb", help="variant of Mitsuba: llvm_ad_rgb or cuda_ad_rgb")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        mi.set_variant(args.variant)
        sizes = [128, 2048, 4096, 6144] if args.large else [128, 2048]
        parts: dict[str, Callable[[], Any]] = {
            "compile": lambda: compile_cold(folder),
            "cost": lambda: cost(folder),
            "gain": lambda: gain(folder),
            "table": lambda: table(folder),
            "memory": lambda: {f"{n}x{n}": memory(folder, n) for n in sizes},
        }
        result: dict[str, Any] = {"mitsuba": mi.MI_VERSION, "drjit": version("drjit"), "cores": os.cpu_count()}
        for part, run in parts.items():
            if args.only in (None, part):
                result[part] = run()
                print(f"{part}: done, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024} MB", file=sys.stderr)
    text = json.dumps(result, indent=1, ensure_ascii=False)
    if args.out:
        args.out.write_text(text + "\n", encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
