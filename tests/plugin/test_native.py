"""The compiled plugin is the one in Python, in another language."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from plugin_fabrics import random_material

from kinran_bsdf import native, write_material
from kinran_bsdf.models import MODELS, TAILS
from kinran_bsdf.residual import Residual

LOOK_UP = """
import json, sys
import numpy as np
import mitsuba as mi
import drjit as dr

plugin, variant, files = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
mi.set_variant(variant)
if plugin == "python":
    import kinran_bsdf
else:
    mi.file_resolver().append(plugin)
n, rng = 200, np.random.default_rng(3)
z = rng.uniform(-0.2, 1, (2, n))
turn = rng.uniform(0, 2 * np.pi, (2, n))
r = np.sqrt(1 - z * z)
directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)
numbers = rng.random((n, 5))


def look_up(bsdf, wi, wo, uv, u1, u2):
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv, si.wi = mi.Point2f(uv), mi.Vector3f(wi)
    si.sh_frame = mi.Frame3f([0, 0, 1])
    si.dp_du, si.dp_dv = [1, 0, 0], [0, 1, 0]
    si.wavelengths = [450, 530, 610, 700] if mi.is_spectral else []
    context = mi.BSDFContext()
    sample, weight = bsdf.sample(context, si, mi.Float(u1), mi.Point2f(u2))
    wo = mi.Vector3f(wo)
    values = bsdf.eval(context, si, wo), bsdf.pdf(context, si, wo), sample.wo, sample.pdf, weight
    return np.concatenate([np.array(value, float).reshape(-1, np.size(u1)) for value in values]).T


rows = []
for file in files:
    bsdf = mi.load_dict({"type": "kinran", **file})
    arguments = *directions, numbers[:, :2], numbers[:, 2], numbers[:, 3:]
    if dr.is_jit_v(mi.Float):
        rows += look_up(bsdf, *(a.T for a in arguments)).tolist()
    else:
        rows += [look_up(bsdf, *(a[k].tolist() for a in arguments))[0].tolist() for k in range(n)]
print(json.dumps(rows))
"""


TWINS = [name for name in MODELS if f'"{name}"' in (native.HERE / "models.h").read_text(encoding="utf-8")]
"""Models that have a compiled twin; the others are refused by it."""


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if reason := native.missing():
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp("native")
    native.build(folder)
    return folder


@pytest.fixture(scope="module")
def fabrics(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    """Files of each model, its tails and numbers of lobes, one with a residual, and constants of each model."""
    folder = tmp_path_factory.mktemp("fabrics")
    kinds = [(name, lobes, tail) for name in TWINS for lobes in MODELS[name].counts for tail in TAILS]
    found: list[dict[str, object]] = [{"model": name} for name in TWINS]
    for number, (model, lobes, tail) in enumerate(kinds):
        path = folder / f"{number}.exr"
        write_material(path, random_material(model, lobes, tail, seed=number))
        found.append({"filename": str(path)})
    material = random_material("slope", 2, "ggx", seed=9)
    rng = np.random.default_rng(5)
    for k in range(3):
        material.channels.update({f"residual{k}.{c}": rng.normal(0, 0.05, (5, 7)).astype(np.float32) for c in "RGB"})
    lights = rng.uniform(-0.6, 0.6, (12, 2))
    material = type(material)(
        **{**vars(material), "residual": Residual("log:1.5", 0.75, lights, rng.normal(0, 0.1, (15, 2)))}
    )
    write_material(folder / "residual.exr", material)
    return [*found, {"filename": str(folder / "residual.exr")}]


def look_up(plugin: str, variant: str, fabrics: list[dict[str, object]]) -> np.ndarray:
    run = subprocess.run(
        [sys.executable, "-c", LOOK_UP, plugin, variant, json.dumps(fabrics)], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    return np.array(json.loads(run.stdout))


@pytest.mark.parametrize("variant", ["scalar_rgb", "scalar_spectral", "scalar_spectral_polarized", "llvm_ad_mono"])
def test_it_is_the_plugin_in_python(variant: str, compiled: Path, fabrics: list[dict[str, object]]) -> None:
    assert {"takeda2008", "slope", "lambert"} <= set(TWINS)
    python, found = (look_up(plugin, variant, fabrics) for plugin in ("python", str(compiled)))
    assert (python[:, 0] > 0).mean() > 0.5
    np.testing.assert_allclose(found, python, rtol=2e-4, atol=2e-5)


def test_a_stale_plugin_is_told(compiled: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """By its sources, and by the version of Mitsuba; `kinran doctor` asks this of the one in the folder native."""
    library = compiled / "plugins" / "kinran.so"
    assert not native.stale(library)
    with monkeypatch.context() as patched:
        patched.setattr(native, "version", lambda name: "3.9.9")
        assert native.stale(library)
    shutil.copytree(native.HERE, tmp_path / "sources")
    (tmp_path / "sources" / "models.h").write_text("// other formulas")
    monkeypatch.setattr(native, "HERE", tmp_path / "sources")
    assert native.stale(library)


def test_mitsuba_renders_without_python(compiled: Path, fabrics: list[dict[str, object]], tmp_path: Path) -> None:
    scene = tmp_path / "scene.xml"
    scene.write_text(
        f"""<scene version="3.0.0"><integrator type="path"/>
        <sensor type="perspective"><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/>
        </transform><film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
        </sensor>
        <emitter type="constant"/><shape type="rectangle"><bsdf type="kinran">
        <string name="filename" value="{fabrics[-1]["filename"]}"/></bsdf></shape></scene>"""
    )
    command = [str(Path(sys.executable).parent / "mitsuba"), "-m", "scalar_rgb", "-a", str(compiled), str(scene)]
    run = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": ""})
    assert run.returncode == 0, run.stdout + run.stderr
    assert (tmp_path / "scene.exr").stat().st_size > 500


def test_a_damaged_material_is_refused(compiled: Path, tmp_path: Path) -> None:
    """One float in its last bit, or another attribute, under the checksums of the sound file."""
    for name, change in (("channel 'diffuse.x'", {}), ("a kinran: attribute", {"kinran:tail": "gaussian"})):
        path = tmp_path / "a.exr"
        write_material(path, random_material("slope", 1, "ggx"))
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = {k: v for k, v in file.header().items() if k.startswith("kinran:")}
            planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        if not change:
            planes["diffuse.x"][2, 3] = np.nextafter(planes["diffuse.x"][2, 3], 2, dtype=np.float32)
        with OpenEXR.File({**header, **change, "type": OpenEXR.scanlineimage}, planes) as file:
            file.write(str(path))
        run = subprocess.run(
            [sys.executable, "-c", LOOK_UP, str(compiled), "scalar_rgb", json.dumps([{"filename": str(path)}])],
            capture_output=True,
            text=True,
        )
        assert run.returncode != 0
        assert f"a.exr: {name} does not match the checksum" in run.stderr + run.stdout
