"""The plugin is installed alone: it needs Mitsuba and NumPy, never the workflow."""

import subprocess
import sys
import venv
from importlib.metadata import distribution
from pathlib import Path

import mitsuba as mi
from plugin_fabrics import random_material

from kinran_bsdf import write_material

PLUGINS = Path(__file__).parents[2] / "plugins"
RENDER = """
import importlib.util, sys
import kinran_bsdf, mitsuba as mi, numpy as np

assert importlib.util.find_spec("kinran") is None
assert all(path.startswith((sys.prefix, sys.base_prefix)) for path in sys.path), sys.path
assert kinran_bsdf.__file__.startswith(sys.prefix), kinran_bsdf.__file__
mi.set_variant("scalar_rgb")
scene = mi.cornell_box()
scene["back"]["bsdf"] = {"type": "kinran", "filename": sys.argv[1]}
scene["sensor"]["film"] |= {"width": 8, "height": 8}
scene = mi.load_dict(scene)
assert "Kinran[" in str(scene)
picture = np.array(mi.render(scene, spp=2))
assert np.isfinite(picture).all() and picture.mean() > 0.01
"""


def link(name: str, site: Path) -> None:
    """Have an installed distribution in another environment too."""
    found = distribution(name)
    for top in {file.parts[0] for file in found.files or [] if file.parts[0] not in ("..", "__pycache__")}:
        (site / top).symlink_to(Path(str(found.locate_file(top))))


def test_pip_installs_the_plugin_in_an_empty_environment(tmp_path: Path) -> None:
    """Its dependencies stand in for an index: with one of them missing, pip refuses."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", "--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", str(tmp_path)]
    subprocess.run([*wheel, str(PLUGINS)], check=True, capture_output=True)
    venv.create(tmp_path / "empty", symlinks=True)
    python = tmp_path / "empty" / "bin" / "python"
    site = next((tmp_path / "empty" / "lib").glob("python*/site-packages"))
    assert list(site.iterdir()) == []
    install = [*pip, "--python", str(python), "install", "--no-index", *map(str, tmp_path.glob("*.whl"))]
    link("drjit", site)
    link("mitsuba", site)
    refused = subprocess.run(install, capture_output=True, text=True)
    assert refused.returncode
    assert "numpy" in refused.stderr
    link("numpy", site)
    subprocess.run(install, check=True, capture_output=True)
    mi.set_variant("scalar_rgb")
    write_material(tmp_path / "a.exr", random_material())
    run = subprocess.run([str(python), "-I", "-c", RENDER, "a.exr"], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
