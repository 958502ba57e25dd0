import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from scene_fabrics import TEMPLATE, F
from scipy.spatial import cKDTree

from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.scene.mesh import prepare
from kinran.scene.placement import placement
from kinran.scene.scene import assemble
from kinran.virtual.scan import scan, write_scan

FRONTAL = """<scene version="3.9.1">
    <default name="mesh" value=""/> <default name="material" value=""/> <default name="wrap" value=""/>
    <default name="repeat_x" value="1"/> <default name="repeat_y" value="1"/>
    <default name="shift_x" value="0"/> <default name="shift_y" value="0"/>
    <!-- looks straight at a panel of 60 × 90 mm, a pixel a millimetre -->
    <integrator type="path"> <integer name="max_depth" value="2"/> </integrator>
    <sensor type="orthographic">
        <transform name="to_world">
            <scale x="30" y="30"/> <lookat origin="0, 0, 100" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="60"/> <integer name="height" value="90"/> <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="constant"> <spectrum name="radiance" value="1"/> </emitter>
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


def default(scene: Path, name: str) -> str:
    element = ET.parse(scene).getroot().find(f"default[@name='{name}']")
    assert element is not None
    return element.attrib["value"]


def test_a_swatch_of_known_size_repeats() -> None:
    assert placement((64, 80), 0.1, (60, 90)) == {
        "repeat_x": "0.125",
        "repeat_y": "0.15625",
        "shift_x": "0",
        "shift_y": "0",
        "wrap": "repeat",
    }


@pytest.mark.parametrize("shape", [(90, 60), (50, 50), (20, 300), (300, 20)])
def test_a_picture_of_unknown_size_covers_the_width_once_from_the_top(shape: tuple[int, int]) -> None:
    lie = {k: float(v) for k, v in placement(shape, None, (60, 90)).items() if k != "wrap"}
    left, right = lie["shift_x"] * lie["repeat_x"], (60 + lie["shift_x"]) * lie["repeat_x"]
    assert (left, right) == (0, pytest.approx(1))
    assert (90 + lie["shift_y"]) * lie["repeat_y"] == pytest.approx(1)
    assert lie["repeat_x"] / lie["repeat_y"] == pytest.approx(shape[0] / shape[1])


@pytest.mark.usefixtures("scalar")
def test_the_scene_loads_from_anywhere_and_moves_with_its_files(
    tmp_path: Path, make_material, flat_mesh: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    material = make_material(F * 0.8, texel_mm=1.0)
    scene = assemble(TEMPLATE, flat_mesh, material, tmp_path / "deep" / "scene")
    assert default(scene, "mesh") == "../../flat.ply"
    assert default(scene, "material") == "../../material.exr"
    assert sorted(path.name for path in scene.parent.iterdir()) == ["scene.xml"]
    assert "<!-- The picture -->" in scene.read_text()
    mi.load_file(str(scene))
    monkeypatch.chdir("/")
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    for path in (flat_mesh, material, tmp_path / "deep"):
        shutil.move(path, moved / path.name)
    loaded = mi.load_file(str(moved / "deep" / "scene" / "scene.xml"), spp="4")
    assert loaded.sensors()[0].sampler().sample_count() == 4


@pytest.mark.usefixtures("llvm")
def test_a_picture_is_upright_and_unmirrored(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    """The rendered F against the picture: a correlation over 0.85, and under 0.6 for every flip of it."""
    (tmp_path / "frontal.xml").write_text(FRONTAL, encoding="utf-8")
    scene = assemble(tmp_path / "frontal.xml", flat_mesh, make_material(F * 0.9), tmp_path / "scene")
    image = np.array(mi.render(mi.load_file(str(scene)), spp=4, seed=0))[..., 1]
    want = np.kron(F[::-1], np.ones((10, 10)))  # top row first
    alike = [np.corrcoef(image.ravel(), w.ravel())[0, 1] for w in (want, want[::-1], want[:, ::-1])]
    assert alike[0] > 0.85
    assert max(alike[1:]) < 0.6


@pytest.fixture(scope="module")
def draped(tmp_path_factory: pytest.TempPathFactory):
    """A cleaned scan with its true uv at points of the mesh."""
    folder = tmp_path_factory.mktemp("draped")
    vertices, faces, truth = scan(seed=1)
    write_scan(folder / "scan.ply", vertices, faces)
    motion = np.array(prepare(folder / "scan.ply", folder / "mesh.ply")["scan_to_mesh"])
    return folder / "mesh.ply", truth.points @ motion[:3, :3].T + motion[:3, 3], truth.uv


@pytest.mark.usefixtures("scalar")
@pytest.mark.parametrize("texel_mm", [None, 2.0])
def test_the_picture_lies_right_on_the_cleaned_scan(
    tmp_path: Path, make_material, draped, texel_mm: float | None
) -> None:
    """Rays at 600 points, against the picture at the true uv: over 93 % alike; not so for a mirrored one."""
    mesh, points, uv = draped
    material = make_material(F * 0.9, texel_mm=texel_mm)
    scene = mi.load_file(str(assemble(TEMPLATE, mesh, material, tmp_path / "scene")))
    panel = next(shape for shape in scene.shapes() if shape.id() == "panel")
    parameters = mi.traverse(panel)
    vertices = np.array(parameters["vertex_positions"]).reshape(-1, 3)
    faces = np.array(parameters["faces"]).reshape(-1, 3)
    tree, context = cKDTree(points), mi.BSDFContext()
    seen, want, mirrored = [], [], []
    for face in np.random.default_rng(5).integers(0, len(faces), 600):
        a, b, c = vertices[faces[face]]
        middle, normal = (a + b + c) / 3, np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        si = scene.ray_intersect(mi.Ray3f((middle + normal).tolist(), (-normal).tolist()))
        si.wi = mi.Vector3f(0, 0, 1)
        seen.append(np.array(panel.bsdf().eval(context, si, mi.Vector3f(0, 0, 1)))[1] * np.pi > 0.45)
        place = uv[tree.query(middle)[1]] / (10 if texel_mm is None else texel_mm)
        column, row = (place % [6, 9]).astype(int)
        want.append(F[row, column])
        mirrored.append(F[row, 5 - column])
    assert np.mean(np.array(seen) == want) > 0.93
    assert np.mean(np.array(seen) == mirrored) < 0.85


@pytest.mark.usefixtures("scalar")
def test_unfitted_regions_are_a_texture_behind_a_mask(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    """BSDF at the middle of every texel: the plain diffuse colour where F is, the fitted BSDF elsewhere."""
    albedo = np.linspace(0.1, 0.9, 54).reshape(9, 6)
    material = make_material(albedo, labels=F, models=("slope", "lambert"), texel_mm=1.0)
    scene = assemble(TEMPLATE, flat_mesh, material, tmp_path / "scene")
    mask = read_exr(tmp_path / "scene" / "fitted.exr")["Y"]
    assert np.array_equal(mask, 1 - F)
    loaded = mi.load_file(str(scene))
    bsdf = next(shape for shape in loaded.shapes() if shape.id() == "panel").bsdf()
    plain = mi.load_dict({"type": "kinran", "filename": str(material)})
    context, up = mi.BSDFContext(), mi.Vector3f(0, 0, 1)
    for row in range(9):
        for column in range(6):
            x, y = column + 0.5 + 12, row + 0.5 + 18  # two repeats in
            si = loaded.ray_intersect(mi.Ray3f([x - 30, y - 45, 10], [0, 0, -1]))
            assert np.array(si.uv) == pytest.approx([x, y], abs=1e-3)
            si.wi = up
            got = np.array(bsdf.eval(context, si, up))
            if F[row, column]:
                texture = read_exr(tmp_path / "scene" / "texture.exr")["G"]
                assert texture[row, column] == pytest.approx(albedo[row, column], abs=0.002)
                assert got[1] * np.pi == pytest.approx(albedo[row, column], abs=0.002)
            else:
                si.uv = [(column + 0.5) / 6, (row + 0.5) / 9]
                assert got == pytest.approx(np.array(plain.eval(context, si, up)), rel=1e-4)
                assert got[1] > 0.4  # the lobe


@pytest.mark.usefixtures("scalar")
def test_all_regions_plain_need_no_mask(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    material = make_material(F * 0.5, labels=F, models=("lambert", "lambert"))
    scene = assemble(TEMPLATE, flat_mesh, material, tmp_path / "scene")
    assert "blendbsdf" not in scene.read_text()


@pytest.mark.usefixtures("llvm")
@pytest.mark.parametrize(("slope", "axis"), [((0.25, 0.0), "key_weft"), ((0.0, 0.25), "key_warp")])
def test_facets_that_lean_to_an_axis_shine_when_the_light_is_there(
    tmp_path: Path, make_material, flat_mesh: Path, slope: tuple[float, float], axis: str
) -> None:
    """A lobe that leans to +weft is brightest with the key light to the right, one to +warp with it above."""
    material = make_material(F * 0.1, models=("slope",), slope=slope)
    scene = assemble(TEMPLATE, flat_mesh, material, tmp_path / "scene")
    bright = {}
    for name in ("key_weft", "key_warp"):
        for angle in (-28, 28):
            light = {"key_weft": "0", "key_warp": "0", name: str(angle)}
            loaded = mi.load_file(str(scene), **light, width="36", height="27", fill="0.001")
            bright[name, angle] = np.array(mi.render(loaded, spp=4, seed=0))[10:20, 12:24].mean()
    best = bright.pop((axis, 28))
    assert best > 1.5 * max(bright.values())


@pytest.mark.usefixtures("scalar")
def test_a_mesh_without_uv_is_refused(tmp_path: Path, make_material) -> None:
    lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {c}" for c in "xyz")]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    (tmp_path / "bare.ply").write_text("\n".join([*lines, "0 0 0", "1 0 0", "0 1 0", "3 0 1 2", ""]))
    with pytest.raises(InputError, match=r"bare\.ply: has no texture coordinates"):
        assemble(TEMPLATE, tmp_path / "bare.ply", make_material(F * 0.5), tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


@pytest.mark.usefixtures("scalar")
@pytest.mark.parametrize(
    ("broken", "content", "message"),
    [
        ("template.xml", None, "no such file"),
        ("template.xml", "<scene>", "is no XML"),
        ("template.xml", "<html/>", "root is <html>"),
        ("template.xml", '<scene><default name="mesh" value=""/></scene>', 'no <default name="material"'),
        ("flat.ply", None, "no such file"),
        ("flat.ply", "ply\nnonsense", "Mitsuba cannot read it"),
        ("material.exr", None, "no such file"),
        ("material.exr", "nonsense", "cannot be read as EXR"),
    ],
)
def test_broken_inputs_stop_before_anything_is_written(
    tmp_path: Path, make_material, flat_mesh: Path, broken: str, content: str | None, message: str
) -> None:
    shutil.copy(TEMPLATE, tmp_path / "template.xml")
    material = make_material(F * 0.5)
    (tmp_path / broken).unlink()
    if content is not None:
        (tmp_path / broken).write_text(content)
    with pytest.raises(InputError, match=message) as error:
        assemble(tmp_path / "template.xml", flat_mesh, material, tmp_path / "scene")
    assert broken in str(error.value)
    assert not (tmp_path / "scene").exists()


@pytest.mark.usefixtures("scalar")
def test_a_template_without_cloth_cannot_take_a_mask(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    (tmp_path / "template.xml").write_text(FRONTAL.replace('bsdf type="kinran"', 'bsdf type="kinnran"'))
    material = make_material(F * 0.5, labels=F, models=("slope", "lambert"))
    with pytest.raises(InputError, match='no <bsdf type="kinran">'):
        assemble(tmp_path / "template.xml", flat_mesh, material, tmp_path / "scene")


@pytest.mark.usefixtures("scalar")
def test_an_absurd_texel_size_is_refused(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    with pytest.raises(InputError, match="texel_mm is 5000"):
        assemble(TEMPLATE, flat_mesh, make_material(F * 0.5, texel_mm=5000.0), tmp_path / "scene")
