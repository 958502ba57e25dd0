"""Real sets raise no doubt as they are, and do with another encoding, or with y of the lights turned."""

from pathlib import Path

import pytest

from benchmarks.doubts import judge, read


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "encoding", "found"),
    [("realrti/item5", "srgb", False), ("realrti/item11", "srgb", True), ("diligent_ball", "linear", True)],
)
def test_no_real_set_is_doubted_without_reason(real_data: Path, name: str, encoding: str, found: bool) -> None:
    """Item 5 is varnished, and looks linear by the ratio alone."""
    said = judge(read(real_data / name, encoding), encoding)
    assert not said["doubted"]
    assert not said["mirrored"]
    assert said["found"] == found
    assert said["turned"]
