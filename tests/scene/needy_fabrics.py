"""Scenes and fabrics of which it is known what the scene needs."""

from pathlib import Path

import numpy as np

from kinran.base.exr import write_exr
from kinran.base.frames import direction
from kinran.data.fabric import Fabric
from kinran.data.labels import Region, write_regions
from kinran.data.radiance_stack import Light, Metadata, write_metadata

ORTHOGRAPHIC = """<sensor type="orthographic">
        <transform name="to_world">
            <scale x="30" y="30"/> <lookat origin="0, 0, 100" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm"> <integer name="width" value="60"/> <integer name="height" value="60"/> </film>
    </sensor>"""
"""A pixel is a millimetre, and 60 × 60 mm about the middle of the panel are seen."""

METER = """<sensor type="radiancemeter">
        <transform name="to_world"> <lookat origin="0, 0, 100" target="0, 0, 0" up="0, 1, 0"/> </transform>
        <film type="hdrfilm">
            <integer name="width" value="1"/> <integer name="height" value="1"/> <rfilter type="box"/>
        </film>
    </sensor>"""

POINT = """<emitter type="point" id="lamp"> <point name="position" x="{x}" y="{y}" z="{z}"/> </emitter>"""

SCENE = """<scene version="3.9.1">
    <default name="mesh" value=""/> <default name="material" value=""/> <default name="wrap" value=""/>
    <default name="repeat_x" value="1"/> <default name="repeat_y" value="1"/>
    <default name="shift_x" value="0"/> <default name="shift_y" value="0"/>
    {camera} {lights}
    <shape type="ply">
        <string name="filename" value="$mesh"/>
        <bsdf type="kinran">
            <string name="filename" value="$material"/> <string name="wrap_mode" value="$wrap"/>
            <transform name="to_uv">
                <translate x="$shift_x" y="$shift_y"/> <scale x="$repeat_x" y="$repeat_y"/>
            </transform>
        </bsdf>
    </shape>
</scene>"""


def perspective(distance: float, tilt: float = 0.0) -> str:
    """A camera of 20° and 50 × 50 pixels, so far from the panel's middle, turned by a tilt (degrees) about the warp."""
    x, z = distance * np.sin(np.radians(tilt)), distance * np.cos(np.radians(tilt))
    return f"""<sensor type="perspective">
        <float name="fov" value="20"/>
        <transform name="to_world"> <lookat origin="{x}, 0, {z}" target="0, 0, 0" up="0, 1, 0"/> </transform>
        <film type="hdrfilm"> <integer name="width" value="50"/> <integer name="height" value="50"/> </film>
    </sensor>"""


def write_scene(path: Path, camera: str = ORTHOGRAPHIC, lights: str = "") -> Path:
    """Write a template: the panel under a camera and lights."""
    path.write_text(SCENE.format(camera=camera, lights=lights), encoding="utf-8")
    return path


def write_fabric(folder: Path, labels: np.ndarray, texel_mm: float | None, theta_max: float = 80.0) -> Fabric:
    """Write label map, regions and a stack whose steepest light to fit is at `theta_max` (degrees)."""
    count = int(labels.max()) + 1
    write_exr(folder / "labels.exr", {"label": labels.astype(np.float32)})
    regions = [Region(k, f"r{k}", int((labels == k).sum()), (1.0, 1.0, 1.0), 1.0) for k in range(count)]
    write_regions(folder / "regions.json", regions)
    lights = [Light("up", (0.0, 0.0, 1.0))]
    for name, theta, held_out in (("steep", theta_max, False), ("steeper", min(theta_max + 5, 89.0), True)):
        x, y, z = direction(np.radians(theta), 0.3).tolist()
        lights.append(Light(name, (x, y, z), held_out=held_out))
    metadata = Metadata(tuple(lights), *labels.shape, texel_mm, "", "", "rgb", np.eye(3), {})
    write_metadata(folder / "radiance.zarr", metadata)
    return Fabric(folder)
