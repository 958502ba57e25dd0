"""What photographs say against their encoding and the axes of their lights, and that shiny ones do not cry wolf."""

import zlib
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from PIL import Image
from raw_frames import write

from kinran.base.encoding import parse, to_srgb
from kinran.base.files import InputError
from kinran.capture import axes_evidence, encoding_evidence, ingest
from kinran.capture.doubts import doubts
from kinran.capture.encoding_evidence import LOUD, Evidence, weigh
from kinran.capture.photograph_set import Known, inspect
from kinran.capture.sampled_set import sample

RINGS = ((10, 4), (25, 8), (40, 10), (55, 10), (70, 8))
"""θ in degrees and number of the lights of a dome."""
SIDE = 48


def dome(rings: tuple[tuple[int, int], ...] = RINGS) -> np.ndarray:
    """Unit vectors (light, 3) of a dome."""
    rows = []
    for theta, count in rings:
        phi = np.arange(count) * 2 * np.pi / count + theta
        t = np.radians(theta)
        rows.append(np.stack([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), np.full(count, np.cos(t))], 1))
    return np.concatenate(rows)


def photograph(lights: np.ndarray, matt: float = 0.5, gloss: float = 0.3, width: float = 0.12) -> np.ndarray:
    """Linear light (light, y, x), top row first, of bumps with painted spots, a highlight, and light from the room."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[SIDE - 1 : -1 : -1, :SIDE] / SIDE  # y is up
    height = sum(
        0.012 * np.sin(2 * np.pi * (fx * x + fy * y) + phase)
        for fx, fy, phase in ((2, 1, 0.3), (1, 3, 1.0), (3, -2, 2.0), (1, 1, 4.0))
    )
    q, p = np.gradient(height, -1 / SIDE, 1 / SIDE)
    normals = np.stack([-p, -q, np.ones_like(p)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    half = lights + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cosine = np.maximum(np.einsum("yxc,lc->lyx", normals, lights), 0)
    off = np.arccos(np.clip(np.einsum("yxc,lc->lyx", normals, half), -1, 1))
    paint = np.kron(rng.uniform(0.3, 1, (8, 8)), np.ones((SIDE // 8, SIDE // 8)))
    light = matt * paint * cosine + gloss * np.exp(-((off / width) ** 2)) * (cosine > 0) + 0.002
    return np.clip(light * rng.normal(1, 0.01, light.shape), 0, 1)


def make_set(folder: Path, light: np.ndarray, lights: np.ndarray, srgb: bool, suffix: str = "png") -> Path:
    """A folder of photographs, sRGB of 8 bits or linear of 16, and their `.lp`."""
    folder.mkdir()
    rows = [str(len(lights))]
    for k, (plane, vector) in enumerate(zip(light, lights, strict=True)):
        codes = (to_srgb(plane) * 255 + 0.5).astype(np.uint8) if srgb else (plane * 65535 + 0.5).astype(np.uint16)
        values = np.ascontiguousarray(codes[..., None].repeat(3, -1))
        encode = imagecodecs.jpeg8_encode if suffix == "jpg" else imagecodecs.png_encode
        (folder / f"{k:02d}.{suffix}").write_bytes(encode(values))
        rows.append(f"{k:02d}.{suffix} {' '.join(f'{part:.6f}' for part in vector)}")
    (folder / "dome.lp").write_text("\n".join(rows) + "\n")
    return folder


def said(folder: Path, known: Known) -> str:
    """What is said of a set."""
    found = inspect(folder, known, 0)
    return " ".join(doubts(found, ingest.plan("cloth", found, known)))


@pytest.mark.parametrize("srgb", [True, False])
def test_an_encoding_is_doubted_where_the_other_explains_the_photographs(tmp_path: Path, srgb: bool) -> None:
    lights = dome()
    folder = make_set(tmp_path / "set", photograph(lights), lights, srgb)
    right, wrong = ("srgb", "linear") if srgb else ("linear", "srgb")
    assert said(folder, Known(right)) == ""
    looks = "encoded for screens, not linear" if srgb else "linear, not srgb"
    assert f"the photographs look {looks}: they differ from Lambert's law by" in said(folder, Known(wrong))


def test_a_shiny_surface_of_srgb_does_not_pass_for_linear(tmp_path: Path) -> None:
    """Broad highlights fall with θ as linear light of a matt surface does, but fit Lambert's law worse."""
    lights = dome()
    folder = make_set(tmp_path / "set", photograph(lights, 0.02, 0.9, 0.36), lights, True, "jpg")
    found = inspect(folder, Known(), 0)
    evidence = weigh(sample(ingest.plan("cloth", found, Known()), [frames[0] for frames in found.frames.values()]))
    assert evidence is not None
    assert evidence.ratio < -LOUD  # by the ratio alone, it would
    assert said(folder, Known()) == ""


def test_what_nothing_tells_is_said(tmp_path: Path) -> None:
    """A narrow cone of lights shows too little of the cosine: a line for files that say nothing, none for JPEG."""
    lights = dome(((8, 4), (20, 8)))
    light = photograph(lights, gloss=0)
    says = "does not say how its values encode light, and the photographs do not tell for sure"
    assert says in said(make_set(tmp_path / "png", light, lights, True), Known())
    assert said(make_set(tmp_path / "jpg", light, lights, True, "jpg"), Known()) == ""


@pytest.mark.parametrize(("signs", "mirrored"), [((1, -1), True), ((-1, 1), True), ((-1, -1), False)])
def test_mirrored_lights_are_seen_by_the_relief(tmp_path: Path, signs: tuple[int, int], mirrored: bool) -> None:
    """One axis turned is seen; two make the relief hollow, which slopes cannot tell."""
    lights = dome()
    folder = make_set(tmp_path / "set", photograph(lights), lights * [*signs, 1], True)
    assert ("the lights look mirrored: the slopes that they give" in said(folder, Known())) == mirrored


def test_what_a_file_states_stands_over_a_guess(tmp_path: Path) -> None:
    """Linear values under a linear profile raise no doubt; sRGB that a file states is named to who says otherwise."""
    lights = dome()
    folder = make_set(tmp_path / "set", photograph(lights), lights, False)
    for path in folder.glob("*.png"):
        data = path.read_bytes()
        path.write_bytes(data[:33] + chunk(b"gAMA", (100_000).to_bytes(4)) + data[33:])
    assert said(folder, Known()) == ""
    folder = make_set(tmp_path / "srgb", photograph(lights), lights, True)
    for path in folder.glob("*.png"):
        data = path.read_bytes()
        path.write_bytes(data[:33] + chunk(b"sRGB", b"\0") + data[33:])
    assert "says that it is sRGB (chunk sRGB)" in said(folder, Known("linear"))
    assert "does not say" not in said(folder, Known())


def chunk(name: bytes, body: bytes) -> bytes:
    """A chunk of a PNG."""
    return len(body).to_bytes(4) + name + body + zlib.crc32(name + body).to_bytes(4)


def test_mirrored_lights_of_raw_files(tmp_path: Path) -> None:
    lights = dome()
    for flip in (1, -1):
        folder = tmp_path / str(flip)
        folder.mkdir()
        rows = [str(len(lights))]
        for k, (plane, (x, y, z)) in enumerate(zip(photograph(lights), lights, strict=True)):
            counts = np.kron(256 + plane[::-1] * 3400, np.ones((2, 2))).astype(np.uint16)
            write(folder / f"{k:02d}.dng", counts, 100, orientation=4)  # shown with its rows backwards
            rows.append(f"{k:02d}.dng {x:.6f} {flip * y:.6f} {z:.6f}")
        (folder / "dome.lp").write_text("\n".join(rows) + "\n")
        assert ("look mirrored" in said(folder, Known())) == (flip < 0)


@pytest.mark.parametrize(
    ("evidence", "doubted"),
    [
        (Evidence(0.02, 0.06, -1.1, 0.2, 48), True),
        (Evidence(0.02, 0.06, -1.1, 0.02, 48), False),  # flat
        (Evidence(0.02, 0.06, -1.1, 0.2, 16), False),  # few lights
        (Evidence(0.04, 0.12, -1.1, 0.2, 48), False),  # shiny
    ],
)
def test_linear_light_is_named_only_of_what_no_metal_imitates(evidence: Evidence, doubted: bool) -> None:
    assert bool(encoding_evidence.doubt(evidence, parse("srgb"))) == doubted


@pytest.mark.parametrize(
    ("correlation", "error", "doubted"), [(-0.5, 0.05, True), (-0.5, 0.2, False), (-0.05, 0.001, False)]
)
def test_mirrored_lights_are_named_only_of_a_sure_correlation(correlation: float, error: float, doubted: bool) -> None:
    assert bool(axes_evidence.doubt(correlation, error)) == doubted


def test_a_set_of_mixed_orientations_is_refused(tmp_path: Path) -> None:
    lights = dome()
    folder = make_set(tmp_path / "set", photograph(lights), lights, True)
    exif = Image.Exif()
    exif[274] = 3
    with Image.open(folder / "05.png") as image:
        image.copy().save(folder / "05.png", exif=exif)
    with pytest.raises(InputError, match=r"05\.png: is shown in orientation 3 of EXIF but 00\.png in 1"):
        inspect(folder, Known(), 0)
