"""The plugin is installed alone: it needs Mitsuba and NumPy, never the workflow."""

import os
import subprocess
import sys
from pathlib import Path

PLUGINS = Path(__file__).parents[2] / "plugins"


def test_pip_installs_the_plugin_alone(tmp_path: Path) -> None:
    """Into an empty folder, without its dependencies, which are here already; then it renders a texel."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "--target", str(tmp_path), str(PLUGINS)], check=True, capture_output=True)
    code = f"""
import sys
sys.modules["kinran"] = None  # importing it now fails
import kinran_bsdf, mitsuba as mi
assert kinran_bsdf.__file__.startswith({str(tmp_path)!r}), kinran_bsdf.__file__
mi.set_variant("scalar_rgb")
bsdf = mi.load_dict({{"type": "kinran", "model": "takeda2008"}})
si = mi.SurfaceInteraction3f()
si.wi = [0, 0, 1]
assert bsdf.eval(mi.BSDFContext(), si, [0, 0, 1])[0] > 0
"""
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
