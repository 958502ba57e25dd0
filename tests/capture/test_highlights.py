"""Lamps from the highlights on mirror spheres, in path-traced photographs whose lamps stand where they are known to."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from kinran.__main__ import main
from kinran.base.encoding import parse
from kinran.capture.highlights_drawing import SEEN, WRONG
from kinran.data.light import LpLight, directions
from kinran.data.light_files import read_lights

WIDTH, HEIGHT, FIELD, CAMERA = 960, 640, 240.0, 700.0
SPHERES = (((-85.0, 45.0), 22.0), ((85.0, -40.0), 22.0))
"""Centre on the fabric and radius (mm)."""
DOME = 400.0


def lamps() -> np.ndarray:
    theta, phi = np.radians([20.0, 35, 50, 62, 40]), np.radians([10.0, 95, 170, 250, 330])
    return DOME * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five photographs: two chrome spheres on a grey table, and a round lamp of 16 mm."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    folder = tmp_path_factory.mktemp("spheres")
    transform = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    base = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2},
        "sensor": {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(FIELD / 2 / CAMERA))),
            "to_world": transform().look_at([0, 0, CAMERA], [0, 0, 0], [0, 1, 0]),
            "film": film,
            "sampler": {"type": "independent", "sample_count": 8},
        },
        "table": {"type": "rectangle", "to_world": transform().scale(400), "bsdf": {"type": "diffuse"}},
    }
    for k, ((x, y), radius) in enumerate(SPHERES):
        base[f"sphere{k}"] = {
            "type": "sphere",
            "center": [x, y, radius],
            "radius": radius,
            "bsdf": {"type": "conductor"},
        }
    for k, lamp in enumerate(lamps()):
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": 500.0}}
        scene = {**base, "lamp": {"type": "sphere", "center": lamp.tolist(), "radius": 8.0, "emitter": emitter}}
        light = np.array(mi.render(mi.load_dict(scene), seed=k))
        codes = np.round(255 * parse("srgb").encode(np.clip(light, 0, 1))).astype(np.uint8)
        Image.fromarray(codes).save(folder / f"p{k}.jpg", quality=92)
    return folder


def outline(k: int) -> str:
    """Circle of as many pixels as see the sphere, around their centre: what a user draws."""
    (cx, cy), radius = SPHERES[k]
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    plane = np.stack([(x - WIDTH / 2) * FIELD / WIDTH, (HEIGHT / 2 - y) * FIELD / WIDTH, np.zeros_like(x)], -1)
    ray = plane - [0, 0, CAMERA]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    to = np.array([cx, cy, radius - CAMERA])
    hit = to @ to - (ray @ to) ** 2 < radius**2
    return f"{x[hit].mean():.2f},{y[hit].mean():.2f},{np.sqrt(hit.sum() / np.pi):.2f}"


def run(folder: Path, out: Path, *options: str) -> list[LpLight]:
    assert main(["highlights", str(folder), "--out", str(out), *options]) == 0
    return read_lights(out).lights


def degrees(lights: list[LpLight], truth: np.ndarray) -> np.ndarray:
    cosine = (directions(lights) * truth / np.linalg.norm(truth, axis=1, keepdims=True)).sum(1)
    return np.degrees(np.arccos(np.minimum(cosine, 1)))


def found_spheres(log: str) -> list[tuple[float, float, float]]:
    """Circles that a run states in the form that --sphere takes."""
    line = next(line for line in log.splitlines() if line.startswith("found "))
    parts = line.split()[2::2]
    return [(x, y, radius) for x, y, radius in (map(float, part.split(",")) for part in parts)]


BOTH = ("--sphere", outline(0), "--sphere", outline(1))
KNOWN = ("--field-mm", f"{FIELD}", "--camera-mm", f"{CAMERA}")


def test_two_spheres_give_positions(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """To 0.6° from the middle of the field and 10 mm at 400 mm, and the run says how well they agree."""
    lights = run(folder, tmp_path / "two.lp", *BOTH, *KNOWN)
    assert [light.file for light in lights] == [f"p{k}.jpg" for k in range(5)]
    found = directions(lights) * np.array([light.length for light in lights])[:, None]

    assert degrees(lights, lamps()).max() < 0.6
    assert np.linalg.norm(found - lamps(), axis=1).max() < 10
    assert "positions in mm (kinran rti --lamp-mm 1 …); the spheres agree to 0." in capsys.readouterr().err


def test_one_sphere_in_a_dome(folder: Path, tmp_path: Path) -> None:
    """With the dome's radius a sphere at the edge gives the direction from the middle, to 0.6°."""
    lights = run(folder, tmp_path / "one.lp", *BOTH[:2], *KNOWN, "--lamp-mm", f"{DOME}")

    assert degrees(lights, lamps()).max() < 0.6
    np.testing.assert_allclose([light.length for light in lights], DOME, rtol=1e-6)


def seen_from_the_highlight(k: int) -> np.ndarray:
    """Lamps from the points of a sphere that mirror them into the camera."""
    (x, y), radius = SPHERES[k]
    centre = np.array([x, y, radius])
    view = np.array([0, 0, CAMERA]) - centre
    points = np.tile(centre, (len(lamps()), 1))
    for _ in range(20):
        half = sum(v / np.linalg.norm(v, axis=1, keepdims=True) for v in (lamps() - points, view + centre - points))
        points = centre + radius * half / np.linalg.norm(half, axis=1, keepdims=True)
    return lamps() - points


def test_a_sphere_alone_gives_directions_from_where_it_lies(folder: Path, tmp_path: Path) -> None:
    """To 0.5° from the highlight; from the middle of the field they are off by what the sphere lies beside it: 13°."""
    lights = run(folder, tmp_path / "far.lp", *BOTH[:2], *KNOWN)

    assert degrees(lights, seen_from_the_highlight(0)).max() < 0.5
    assert degrees(lights, lamps()).max() > 12
    np.testing.assert_allclose([light.length for light in lights], 1, rtol=1e-6)


def test_spheres_are_found(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """To a pixel, and lamps as from given ones, to 0.6°."""
    lights = run(folder, tmp_path / "found.lp", *KNOWN)
    found = sorted(found_spheres(capsys.readouterr().err))

    np.testing.assert_allclose(found, [list(map(float, outline(k).split(","))) for k in range(2)], atol=1)
    assert degrees(lights, lamps()).max() < 0.6
    stated = [word for circle in found for word in ("--sphere", ",".join(map(str, circle)))]
    assert degrees(run(folder, tmp_path / "given.lp", *stated, *KNOWN), directions(lights)).max() < 0.01


def test_one_is_used_where_the_width_is_unknown(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "small").mkdir()
    for path in folder.glob("*.jpg"):
        Image.open(path).reduce(2).save(tmp_path / "small" / path.name)
    assert len(run(tmp_path / "small", tmp_path / "one.lp")) == 5
    log = capsys.readouterr().err
    assert len(found_spheres(log)) == 2
    assert "is used, the largest: without --field-mm" in log


def test_what_is_no_lamp_is_left_out(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mask of the spheres, a dark frame and one under a window; their picture shows what was found."""
    (tmp_path / "set").mkdir()
    for path in folder.glob("*.jpg"):
        (tmp_path / "set" / path.name).symlink_to(path)
    mask = Image.new("RGB", (WIDTH, HEIGHT))
    for k in range(2):
        x, y, radius = map(float, outline(k).split(","))
        ImageDraw.Draw(mask).circle((x, y), radius, fill="white")
    dark = Image.new("RGB", (WIDTH, HEIGHT), (3, 3, 3))
    window = Image.open(folder / "p0.jpg").copy()
    for k in range(2):
        x, y, radius = map(float, outline(k).split(","))
        ImageDraw.Draw(window).rectangle((x - radius / 2, y - radius / 2, x, y), fill="white")
    for name, picture in (("mask", mask), ("p5dark", dark), ("p6window", window), ("small", dark.resize((96, 64)))):
        picture.save(tmp_path / "set" / f"{name}.png")
    lights = run(tmp_path / "set", tmp_path / "found.lp", *KNOWN)
    log = capsys.readouterr().err

    assert [light.name for light in lights] == [f"p{k}" for k in range(5)]
    assert degrees(lights, lamps()).max() < 0.6
    for line in (
        "mask.png: has no compact highlight on the sphere; it is left out",
        "p5dark.png: has no highlight on the sphere; it is left out",
        "p6window.png: has no compact highlight on the sphere; it is left out",
        "small.png: is 96x64, not 960x640 as most; it is left out",
    ):
        assert line in log
    shown = np.asarray(Image.open(tmp_path / "found.png"))
    green, red = (np.all(shown == colour, -1).sum() for colour in (SEEN, WRONG))
    assert green > red > 0


def test_without_the_cameras_distance(folder: Path, tmp_path: Path) -> None:
    """The failure that `--camera-mm` mends: the sphere at the edge is seen askew, and lamps are off by degrees."""
    lights = run(folder, tmp_path / "ortho.lp", *BOTH[:2], "--field-mm", f"{FIELD}", "--lamp-mm", f"{DOME}")

    assert degrees(lights, lamps()).max() > 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--sphere", "1,2"], "sphere '1,2': give X,Y,RADIUS"),
        (["--sphere", "50,50,3"], "too small to say a direction"),
        (["--sphere", "940,50,40"], "is not whole in the photographs of 960x640"),
        (["--sphere", "480,320,40"], "p0.jpg: has no highlight on the sphere 480,320,40"),
        ([*BOTH], "--field-mm: is missing"),
    ],
)
def test_what_must_stop(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    assert main(["highlights", str(folder), "--out", str(tmp_path / "x.lp"), *options]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert not (tmp_path / "x.lp").exists()
