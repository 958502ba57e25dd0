"""The material file: what is written is read, by name, by others too; what is wrong is refused."""

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from kinran_bsdf import Material, read_material, write_material
from kinran_bsdf.material import channel_names

CASES = [
    ("slope", 1, "gaussian"),
    ("slope", 2, "ggx"),
    ("takeda2008", 1, "gaussian"),
    ("lambert", 0, "gaussian"),
]


@pytest.mark.parametrize(("model", "lobes", "tail"), CASES)
def test_read_gives_what_was_written(
    fabric: Callable[..., Material], tmp_path: Path, model: str, lobes: int, tail: str
) -> None:
    there = replace(fabric(model, lobes, tail), from_stack=np.diag([2.0, 1.0, 0.5]), crop="1,2,3,4", encoding="srgb")
    write_material(tmp_path / "a.exr", there)
    back = read_material(tmp_path / "a.exr")
    assert set(back.channels) == set(channel_names(there.reflection))
    for name, plane in there.channels.items():
        np.testing.assert_array_equal(back.channels[name], plane)
    np.testing.assert_array_equal(back.from_stack, there.from_stack)
    for name in (
        "model",
        "tail",
        "lobes",
        "regions",
        "colour",
        "texel_mm",
        "source",
        "theta_max",
        "crop",
        "encoding",
    ):
        assert getattr(back, name) == getattr(there, name)
    assert not list(tmp_path.glob(".*"))


def test_unknown_texel_size_is_none(fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", replace(fabric(), texel_mm=None))
    assert read_material(tmp_path / "a.exr").texel_mm is None


def test_other_software_reads_names_rows_and_header(fabric: Callable[..., Material], tmp_path: Path) -> None:
    m = fabric()
    write_material(tmp_path / "a.exr", m)
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        header = dict(file.header())
        planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    assert header["kinran:version"] == "1"
    assert header["kinran:cosine"] == "included"
    assert json.loads(header["kinran:regions"]) == m.regions
    for name, plane in m.channels.items():
        assert planes[name].dtype == np.float32
        np.testing.assert_array_equal(planes[name], plane)


def spoiled(m: Material, channel: str, value: float) -> Material:
    plane = m.channels[channel].copy()
    plane[0, 0] = value
    return replace(m, channels=m.channels | {channel: plane})


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda m: replace(m, model="phong"), "model 'phong' is not one of"),
        (lambda m: replace(m, tail="cauchy"), "tail 'cauchy'"),
        (lambda m: replace(m, lobes=3), "3 lobes do not go with"),
        (lambda m: replace(m, colour="srgb"), "colour space 'srgb'"),
        (lambda m: replace(m, from_stack=np.zeros((3, 3))), "invertible"),
        (
            lambda m: replace(m, channels={k: v for k, v in m.channels.items() if k != "lobe1.xy"}),
            "'lobe1.xy'",
        ),
        (lambda m: spoiled(m, "lobe1.x", np.nan), "'lobe1.x' holds values that are not finite"),
        (lambda m: spoiled(m, "diffuse.amplitude", -1), "'diffuse.amplitude' is negative"),
        (lambda m: spoiled(m, "bound", 0), "'bound' leaves"),
        (lambda m: spoiled(m, "lobe1.xx", -1), "1 texels of lobe1 have no positive width"),
    ],
)
def test_what_no_model_can_render_is_refused(
    fabric: Callable[..., Material], tmp_path: Path, spoil: Callable[[Material], Material], says: str
) -> None:
    with pytest.raises(ValueError, match=says) as caught:
        write_material(tmp_path / "a.exr", spoil(fabric()))
    assert "a.exr" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def rewrite(path: Path, header: dict[str, object], drop: str = "") -> None:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        old = {k: v for k, v in file.header().items() if k.startswith("kinran:") and k != drop}
        planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    with OpenEXR.File({**old, **header, "type": OpenEXR.scanlineimage}, planes) as file:
        file.write(str(path))


@pytest.mark.parametrize(
    ("header", "drop", "says"),
    [
        ({"kinran:version": "2"}, "", "kinran:version is '2'"),
        ({"kinran:cosine": "excluded"}, "", "kinran:cosine is 'excluded'"),
        ({"kinran:regions": "{"}, "", "a kinran: attribute cannot be read"),
        ({"kinran:lobes": "many"}, "", "a kinran: attribute cannot be read"),
        ({}, "kinran:version", "has no attribute kinran:version"),
        ({}, "kinran:measured", "has no attribute kinran:measured"),
    ],
)
def test_bad_headers_are_refused(
    fabric: Callable[..., Material], tmp_path: Path, header: dict[str, object], drop: str, says: str
) -> None:
    write_material(tmp_path / "a.exr", fabric())
    rewrite(tmp_path / "a.exr", header, drop)
    with pytest.raises(ValueError, match=says) as caught:
        read_material(tmp_path / "a.exr")
    assert "a.exr" in str(caught.value)


def test_missing_foreign_and_truncated_files_are_refused(fabric: Callable[..., Material], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file"):
        read_material(tmp_path / "none.exr")
    (tmp_path / "text.exr").write_text("not a picture")
    with pytest.raises(ValueError, match=r"text\.exr: cannot be read as EXR"):
        read_material(tmp_path / "text.exr")
    write_material(tmp_path / "a.exr", fabric())
    whole = (tmp_path / "a.exr").read_bytes()
    for part in (0.2, 0.6, 0.99):
        (tmp_path / "part.exr").write_bytes(whole[: int(len(whole) * part)])
        with pytest.raises(ValueError, match=r"part\.exr: cannot be read as EXR"):
            read_material(tmp_path / "part.exr")


def test_a_file_that_claims_a_huge_size_is_refused_before_memory_is_taken(
    fabric: Callable[..., Material], tmp_path: Path
) -> None:
    write_material(tmp_path / "a.exr", fabric())
    data = bytearray((tmp_path / "a.exr").read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(name) + len(name) + 4
        data[at : at + 16] = np.array([0, 0, 199_999, 199_999], "<i4").tobytes()
    (tmp_path / "huge.exr").write_bytes(data)
    with pytest.raises(ValueError, match=r"huge\.exr"):
        read_material(tmp_path / "huge.exr")


def test_texel_without_a_lobe_takes_the_mean_shape_of_the_others(fabric: Callable[..., Material]) -> None:
    m = spoiled(spoiled(fabric(), "lobe1.amplitude", 0), "lobe1.xx", 0)
    shape = m.terms()[1][1]
    assert np.isfinite(shape).all()
    used = m.channels["lobe1.amplitude"] > 0
    expected = np.average(m.channels["lobe1.xx"][used], weights=m.channels["lobe1.amplitude"][used])
    assert shape[0, 0, 2] == pytest.approx(expected, rel=1e-5)


def test_a_flipped_bit_is_an_error_that_names_the_file(fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Or nothing: what no reader uses, such as the size of the display. 38 of 60 were other values once."""
    path = tmp_path / "a.exr"
    write_material(path, fabric())
    whole, sound = path.read_bytes(), read_material(path)
    named = 0
    for bit in np.random.default_rng(4).integers(0, 8 * len(whole), 120).tolist():
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            back = read_material(path)
        except ValueError as error:
            named += "a.exr" in str(error)
            continue
        assert (back.model, back.source, back.texel_mm) == (sound.model, sound.source, sound.texel_mm), bit
        for name, plane in sound.channels.items():
            np.testing.assert_array_equal(back.channels[name], plane)
    assert named > 100


def test_edited_maps_are_refused_with_their_old_checksum_and_read_without(
    fabric: Callable[..., Material], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As an artist's program writes them, which keeps the attributes or drops them; the second is said once."""
    path = tmp_path / "a.exr"
    write_material(path, fabric())
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header = {k: v for k, v in file.header().items() if k.startswith("kinran:")}
        planes = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    planes["diffuse.R"] = planes["diffuse.R"] * np.float32(0.5)
    for drop, says in (("", "channel 'diffuse.R' does not match the checksum"), ("kinran:crc32", "")):
        kept = {name: value for name, value in header.items() if name != drop}
        with OpenEXR.File({**kept, "type": OpenEXR.scanlineimage}, dict(planes)) as file:
            file.write(str(path))
        if says:
            with pytest.raises(ValueError, match=rf"a\.exr: {says}.*remove the attribute kinran:crc32"):
                read_material(path)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            np.testing.assert_array_equal(read_material(path).channels["diffuse.R"], planes["diffuse.R"])
    assert caplog.text.count("a.exr: has no checksum") == 1
