import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from needy_fabrics import METER, ORTHOGRAPHIC, POINT, perspective, write_fabric, write_scene
from scene_fabrics import TEMPLATE

from kinran.base.files import InputError
from kinran.data.needed_regions import needed_labels
from kinran.scene.need import axes, need, spread

HALVES = np.zeros((40, 60), np.intp)
HALVES[:, 45:] = 1  # a quarter of the weft, all along the warp

Needs = Callable[..., dict[str, Any]]


@pytest.fixture
def needs(tmp_path: Path, flat_mesh: Path) -> Needs:
    """What a scene needs of a panel of 60 × 90 mm, by 4096 rays; the panel's normal is +z."""

    def ask(
        labels: np.ndarray = HALVES,
        texel_mm: float | None = 0.5,
        theta_max: float = 80.0,
        **scene: str,
    ) -> dict[str, Any]:
        fabric = write_fabric(tmp_path, labels, texel_mm, theta_max)
        return need(write_scene(tmp_path / "template.xml", **scene), flat_mesh, fabric, rays=4096)

    return ask


def test_rays_cover_the_picture_evenly() -> None:
    """Each of 16 × 16 cells has 16 of 4096 points, give or take 4 (random ones: give or take 12)."""
    points = spread(4096, 4)
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=16, range=[[0, 1], [0, 1]])
    assert np.abs(counts - 16).max() <= 4


def test_axes_are_those_of_a_pixel_in_texels() -> None:
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    narrow, wide = axes(np.array([turn @ np.diag([3.0, 5.0]), np.full((2, 2), np.nan)]))
    assert (narrow.tolist(), wide.tolist()) == ([pytest.approx(3)], [pytest.approx(5)])


def test_a_frontal_camera_of_known_scale(needs: Needs) -> None:
    """A pixel of 1 mm on texels of 0.0625 mm: 16 texels a pixel, so 5 × 5 can be averaged."""
    result = needs(texel_mm=0.0625)
    footprint = result["footprint"]
    for axis in ("narrow", "wide"):
        assert footprint[axis] == {at: pytest.approx(16, rel=1e-4) for at in ("p5", "median", "p95")}
    assert (footprint["texel_mm"], footprint["coarsest_factor"], footprint["coarsest_mm"]) == (0.0625, 5, 0.3125)
    assert result["cloth_share"] == result["front_share"] == 1
    assert result["view"] == {"unit": "rad", "median": 0, "p95": 0, "max": 0}
    assert result["camera"] == {"width": 60, "height": 60}


@pytest.mark.parametrize("tilt", [0.0, 60.0])
def test_a_perspective_camera_of_known_scale(needs: Needs, tilt: float) -> None:
    """Tilted, a pixel is longer on the cloth by 1 / cos θ_v along the weft and nothing else: within 3 %."""
    result = needs(texel_mm=0.1, camera=perspective(60, tilt))
    pixel = 2 * 60 * np.tan(np.radians(10)) / 50
    assert result["footprint"]["narrow"]["median"] == pytest.approx(pixel / 0.1, rel=0.03)
    assert result["footprint"]["wide"]["median"] == pytest.approx(pixel / 0.1 / np.cos(np.radians(tilt)), rel=0.03)
    middle = np.radians(tilt) if tilt else 0.140  # straight ahead, half of the square lies within 8° of its middle
    assert result["view"]["median"] == pytest.approx(middle, abs=0.01)


def test_a_closer_camera_needs_finer_texels(needs: Needs) -> None:
    far, near = (needs(texel_mm=0.02, camera=perspective(distance)) for distance in (120, 30))
    assert far["footprint"]["narrow"]["median"] == pytest.approx(4 * near["footprint"]["narrow"]["median"], rel=0.01)
    assert far["footprint"]["coarsest_factor"] == 14  # of 42 texels a pixel
    assert near["footprint"]["coarsest_factor"] == 3  # of 10.5


def test_averaged_texels_lose_a_tenth_of_the_contrast_at_most(needs: Needs) -> None:
    """Of the finest grating that pixels of 12 texels carry, the factor leaves 0.91, and twice as much 0.69."""
    factor = needs(texel_mm=1 / 12)["footprint"]["coarsest_factor"]
    grating = np.cos(np.pi * (np.arange(960) + 0.5) / 12 - 0.7)

    def left(side: int) -> float:
        coarse = np.repeat(grating.reshape(-1, side).mean(1), side)
        return float(abs(np.fft.rfft(coarse)[40] / np.fft.rfft(grating)[40]))

    assert factor == 4
    assert left(factor) == pytest.approx(0.91, abs=0.01)
    assert left(2 * factor) == pytest.approx(0.69, abs=0.01)


def test_regions_of_known_share(needs: Needs) -> None:
    """A quarter of the weft: 25 % of a panel of whole repeats, within 0.5 % with 4096 rays."""
    rows = needs(texel_mm=0.5)["regions"]  # 30 mm: two repeats in the 60 mm that are seen
    assert [(row["label"], row["name"], row["needed"]) for row in rows] == [(0, "r0", True), (1, "r1", True)]
    assert rows[1]["share"] == pytest.approx(0.25, abs=0.005)
    assert rows[0]["share"] + rows[1]["share"] == pytest.approx(1, abs=1e-4)


def test_the_map_is_neither_mirrored_nor_upside_down(needs: Needs) -> None:
    """A picture that covers the cloth once, looked at in its upper right quarter alone."""
    quarters = np.repeat(np.repeat(np.array([[0, 1], [2, 3]]), 45, 0), 30, 1)  # row 0 is the bottom
    camera = perspective(100).replace("0, 0, 100.0", "15, 22, 60").replace('target="0, 0, 0"', 'target="15, 22, 0"')
    shares = [row["share"] for row in needs(labels=quarters, texel_mm=None, camera=camera)["regions"]]
    assert shares == [0, 0, 0, 1]


def test_a_region_out_of_the_picture_is_not_needed(needs: Needs, tmp_path: Path) -> None:
    """A region at the right rim is needed only from a camera that sees it."""
    rim = np.zeros((90, 60), np.intp)
    rim[:, 50:] = 1
    for distance, labels in ((60, [0]), (200, [0, 1])):
        result = needs(labels=rim, texel_mm=None, camera=perspective(distance))
        (tmp_path / "need.json").write_text(json.dumps(result))
        assert needed_labels(tmp_path / "need.json", rim) == labels


@pytest.mark.parametrize("theta", [0.0, 40.0, 70.0])
def test_half_vectors_of_a_lamp_far_away(needs: Needs, theta: float) -> None:
    """With V = N and a lamp at θ, θ_h = θ / 2 within 0.2° wherever it meets the cloth."""
    x, z = 2e4 * np.sin(np.radians(theta)), 2e4 * np.cos(np.radians(theta))
    half = needs(lights=POINT.format(x=x, y=0, z=z), theta_max=60)["half_vector"]
    assert half["measured"] == pytest.approx(np.radians(30), abs=1e-5)  # a light at 65° is held out
    assert half["all"] is False
    (lamp,) = half["emitters"]
    assert (lamp["id"], lamp["kind"], lamp["lit"]) == ("lamp", "point", 1)
    for at in ("median", "p95", "max"):
        assert half[at] == lamp[at] == pytest.approx(np.radians(theta / 2), abs=np.radians(0.2))
    assert half["outside"] == lamp["outside"] == (1 if theta > 60 else 0)


def test_half_vectors_of_a_near_lamp(needs: Needs) -> None:
    """A lamp 20 mm over the middle: outside where it is seen under more than 2 θ_h, beyond a circle of known size."""
    half = needs(lights=POINT.format(x=0, y=0, z=20), theta_max=50)["half_vector"]
    radius = 20 * np.tan(np.radians(50))
    assert half["outside"] == pytest.approx(1 - np.pi * radius**2 / 60**2, abs=0.005)
    assert half["max"] == pytest.approx(np.arctan(np.hypot(30, 30) / 20) / 2, abs=0.01)


def test_an_area_light_is_sampled_and_an_environment_is_all(needs: Needs) -> None:
    """A panel of light from θ = 26.6° to 45° about the weft: half vectors in between; another turned away: none."""
    panel = """<shape type="rectangle" id="{id}">
        <transform name="to_world">
            <scale x="2500" y="1"/> <rotate y="1" angle="{turn}"/> <translate x="7500" z="10000"/>
        </transform>
        <emitter type="area"> <rgb name="radiance" value="1"/> </emitter>
    </shape>"""
    lights = panel.format(id="window", turn=180) + panel.format(id="away", turn=0)
    half = needs(lights=lights + '<emitter type="constant"/>')["half_vector"]
    rows = {row["id"]: row for row in half["emitters"]}
    window = rows["window"]
    assert (window["kind"], window["lit"]) == ("area", 1)
    assert window["max"] == pytest.approx(np.radians(45 / 2), abs=np.radians(0.2))
    assert window["median"] == pytest.approx(np.arctan(0.75) / 2, abs=np.radians(0.3))
    assert (rows["away"]["lit"], rows["away"]["median"]) == (0, None)
    (around,) = (row for row in half["emitters"] if row["kind"] == "environment")
    assert around["lit"] == around["median"] == around["outside"] == "all"
    assert half["all"] is True
    assert half["max"] == window["max"]


def test_a_lamp_behind_something_does_not_count(needs: Needs) -> None:
    place = '<transform name="to_world"> <scale value="500"/> <translate z="200"/> </transform>'
    screen = f'<shape type="disk"> {place} </shape>'
    half = needs(lights=POINT.format(x=100, y=0, z=900) + screen)["half_vector"]
    assert (half["emitters"][0]["lit"], half["outside"], half["max"]) == (0, 0, None)


def test_the_back_of_the_cloth_has_no_half_vectors(needs: Needs) -> None:
    result = needs(camera=perspective(60, 180), lights=POINT.format(x=0, y=0, z=-500))
    assert result["front_share"] == 0
    assert result["view"]["median"] is result["half_vector"]["median"] is None


def test_the_shipped_scene_can_be_asked(tmp_path: Path, flat_mesh: Path) -> None:
    """Under the weave of the demo: nearly two texels a pixel, so the finest are needed; a key light with a place."""
    fabric = write_fabric(tmp_path, np.zeros((80, 80), np.intp), 0.06)
    result = need(TEMPLATE, flat_mesh, fabric, rays=1024)
    assert result["footprint"]["coarsest_factor"] == 1
    assert 1.5 < result["footprint"]["narrow"]["median"] < 2.5
    assert [row["id"] for row in result["half_vector"]["emitters"]] == ["key_light", "fill_light"]
    assert json.dumps(result, allow_nan=False)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"template": "none.xml"}, "none.xml: no such file"),
        ({"mesh": "none.ply"}, "none.ply: no such file"),
        ({"gone": "labels.exr"}, "labels.exr: no such file"),
        ({"gone": "regions.json"}, "regions.json: no such file"),
        ({"gone": "radiance.zarr/zarr.json"}, "radiance.zarr: is no radiance stack"),
        ({"text": ("<scene", "<scen")}, "is no XML"),
        ({"text": ('type="kinran"', 'type="diffuse"')}, 'has no <bsdf type="kinran">'),
        ({"text": ('type="ply"', 'type="plyy"')}, "Mitsuba cannot load it"),
        ({"text": ('target="0, 0, 0"', 'target="0, 0, 200"')}, "its camera does not see the cloth"),
        ({"text": (ORTHOGRAPHIC, METER)}, "use a perspective camera"),
        ({"other": True}, "its 60 × 40 texels are not the 40 × 60 of the stack"),
        ({"fewer": True}, "has no region 1"),
    ],
)
def test_what_cannot_be_used_is_one_sentence(
    tmp_path: Path, flat_mesh: Path, change: dict[str, Any], says: str
) -> None:
    template, mesh = write_scene(tmp_path / "template.xml"), flat_mesh
    fabric = write_fabric(tmp_path, HALVES, 0.5)
    if "text" in change:
        assert change["text"][0] in template.read_text()
        template.write_text(template.read_text().replace(*change["text"]))
    elif "gone" in change:
        (tmp_path / change["gone"]).unlink()
    elif "other" in change:
        (tmp_path / "other").mkdir()
        write_fabric(tmp_path / "other", HALVES.T, 0.5).labels_path.replace(fabric.labels_path)
    elif "fewer" in change:
        fabric.regions_path.write_text(json.dumps(json.loads(fabric.regions_path.read_text())[:1]))
    template, mesh = tmp_path / change.get("template", template), tmp_path / change.get("mesh", mesh)
    with pytest.raises(InputError, match=r"^[^\n]+$") as error:
        need(template, mesh, fabric, rays=64)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "is not valid JSON"),
        ("[]", "is not what a scene needs"),
        ('{"regions": [{"label": 0}]}', r"regions\[0\]: Object missing required field `needed`"),
        (
            '{"regions": [{"label": 0, "needed": true}], "footprint": {"coarsest_factor": 1}}',
            "says nothing of the label 1",
        ),
    ],
)
def test_an_answer_that_is_not_this_fabrics(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "need.json").write_text(text)
    with pytest.raises(InputError, match=says):
        needed_labels(tmp_path / "need.json", HALVES)
