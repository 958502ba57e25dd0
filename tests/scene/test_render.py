import logging
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from scene_fabrics import TEMPLATE, F

from kinran.base.exr import read_exr
from kinran.base.files import InputError, read_json
from kinran.scene import render
from kinran.scene.scene import assemble

LIT_WALL = """<scene version="3.9.1">
    <integrator type="path"/>
    <sensor type="perspective">
        <transform name="to_world"> <lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/> </transform>
        <sampler type="independent"> <integer name="sample_count" value="12"/> </sampler>
        <film type="hdrfilm"> <integer name="width" value="8"/> <integer name="height" value="6"/> </film>
    </sensor>
    <emitter type="constant"> <spectrum name="radiance" value="0.5"/> </emitter>
    <shape type="rectangle">
        <bsdf type="diffuse"> <rgb name="reflectance" value="0.4, 0.4, 0.4"/> </bsdf>
    </shape>
</scene>"""


@pytest.fixture
def wall(tmp_path: Path) -> Path:
    (tmp_path / "wall.xml").write_text(LIT_WALL)
    return tmp_path / "wall.xml"


def test_a_picture_is_linear_exr_png_and_json(wall: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "kinran")
    render.picture(wall, wall.with_name("out.exr"), variant="scalar_rgb")
    image = read_exr(wall.with_name("out.exr"))
    assert image["R"].shape == (6, 8)
    assert image["G"][2:4, 2:6].mean() == pytest.approx(0.5 * 0.4, rel=0.15)  # furnace: radiance × albedo
    with Image.open(wall.with_name("out.png")) as png:
        assert png.size == (8, 6)
        shown = render.develop(np.stack([image[c] for c in "RGB"], -1))
        assert np.array_equal(np.asarray(png), shown)
    told = read_json(wall.with_name("out.json"))
    assert told.items() >= {"variant": "scalar_rgb", "width": 8, "height": 6, "spp": 12}.items()
    assert told["seconds_render"] >= 0
    assert "render wall.xml: 1 of 1 passes" in caplog.text


def test_samples_can_be_chosen(wall: Path) -> None:
    render.picture(wall, wall.with_name("out.exr"), spp=3, variant="scalar_rgb")
    assert read_json(wall.with_name("out.json"))["spp"] == 3


def test_passes_differ_and_average(wall: Path) -> None:
    """64 samples in four passes: less than 0.75 of the noise of one pass (0.5 expected)."""
    mi.set_variant("scalar_rgb")
    scene = render.load(wall)
    truth = render.render(scene, 512)[0]
    noise = [np.std(render.render(scene, samples)[0] - truth) for samples in (16, 64)]
    assert noise[1] < 0.75 * noise[0]


def test_develop_shows_low_values_as_they_are_and_rolls_off_high_ones() -> None:
    levels = np.linspace(0, 20, 20_001)
    grey = render.develop(np.repeat(levels[:, None, None], 3, -1).astype(np.float32))[:, 0, 0].astype(int)
    assert (np.diff(grey) >= 0).all()
    assert grey[0] == 0
    assert grey[200] == 124
    assert grey[700] == round(255 * (1.055 * 0.7 ** (1 / 2.4) - 0.055))
    assert grey[1000] < 245  # diffuse white leaves room
    assert grey[900] < grey[1100] < grey[1400]
    assert np.array_equal(render.develop(np.full((1, 1, 3), 0.1)), render.develop(np.full((1, 1, 3), 0.05), 2))
    assert render.develop(np.full((1, 1, 3), -1.0)).max() == 0


def test_the_cloth_renders_by_command(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    """Through the command line, to the default names, with what is on the cloth in the picture."""
    from kinran.__main__ import main

    scene = assemble(TEMPLATE, flat_mesh, make_material(F * 0.8), tmp_path / "scene")
    text = scene.read_text().replace('name="width" value="720"', 'name="width" value="72"')
    scene.write_text(text.replace('name="height" value="540"', 'name="height" value="54"'))
    assert main(["render", str(scene), "--spp", "8"]) == 0
    assert sorted(path.name for path in scene.parent.iterdir()) == [
        "scene.exr",
        "scene.json",
        "scene.png",
        "scene.xml",
    ]
    image = read_exr(tmp_path / "scene" / "scene.exr")["G"]
    assert np.isfinite(image).all()
    assert np.quantile(image, 0.98) > 3 * np.quantile(image, 0.3)


def test_a_sweep_is_one_sheet(tmp_path: Path, make_material, flat_mesh: Path, monkeypatch) -> None:
    monkeypatch.setattr(render, "SWEEP_SIZE", (32, 24))
    monkeypatch.setattr(render, "SWEEP_SPP", 2)
    scene = assemble(TEMPLATE, flat_mesh, make_material(F * 0.8), tmp_path / "scene")
    render.sweep(scene, tmp_path / "sweep.png", 2)
    with Image.open(tmp_path / "sweep.png") as sheet:
        assert sheet.size == (64, 48)
        frames = np.asarray(sheet, float)[8:].reshape(-1, 64, 3)
    assert np.abs(frames[:, :32] - frames[:, 32:]).mean() > 1  # the light has moved


def test_a_frame_of_a_sweep_is_the_scene_as_it_was_loaded(tmp_path: Path, make_material, flat_mesh: Path) -> None:
    """Numbers that become variables of the kernel stay the same numbers."""
    scene = assemble(TEMPLATE, flat_mesh, make_material(F * 0.8), tmp_path / "scene")
    render.use_variant(None)
    as_loaded, varied = (render.load(scene, key_weft="20", width="32", height="24") for _ in range(2))
    render._to_variables(varied)
    pictures = [render.render(one, 4) for one in (as_loaded, varied)]
    assert pictures[0].max() > 0.1
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-4, atol=1e-5)


def test_a_sweep_needs_a_light_that_moves(wall: Path) -> None:
    with pytest.raises(InputError, match="key_w"):
        render.sweep(wall, wall.with_name("sweep.png"), 2, "scalar_rgb")
    assert not wall.with_name("sweep.png").exists()


@pytest.mark.parametrize(
    ("content", "arguments", "message"),
    [
        (None, {}, "no such file"),
        ("<scene", {}, "Mitsuba cannot load it"),
        ('<scene version="3.9.1"><bsdf type="kinran"/><bsdf type="velvet"/></scene>', {}, "velvet"),
        (LIT_WALL, {"variant": "scalar_taupe"}, "variant 'scalar_taupe': Mitsuba has only"),
        (LIT_WALL, {"spp": 0}, "--spp 0"),
    ],
)
def test_bad_scenes(tmp_path: Path, content: str | None, arguments: dict, message: str) -> None:
    scene = tmp_path / "bad.xml"
    if content is not None:
        scene.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        render.picture(scene, tmp_path / "out" / "bad.exr", **{"variant": "scalar_rgb", **arguments})
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_without_llvm_it_says_so_and_renders_all_the_same(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nonexistent/libLLVM.so")
    assert render.choose_variant() == "scalar_rgb"
    (told,) = caplog.messages
    assert told.startswith("warning: LLVM cannot be used (")
    assert "install libllvm19" in told
