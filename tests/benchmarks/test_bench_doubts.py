"""Real sets raise no doubt as they are; most do with another encoding, or with y of the lights turned."""

from pathlib import Path

import pytest

from benchmarks.doubts import of_sets


@pytest.mark.real
@pytest.mark.slow
def test_no_real_set_is_doubted_without_reason(real_data: Path) -> None:
    rows = of_sets(real_data, [])
    assert len(rows) == 24
    assert not [row["set"] for row in rows if row["doubted"] or row["mirrored"]]
    assert sum(row["turned"] for row in rows) >= 22
    assert sum(row["found"] for row in rows if row["encoding"] == "srgb") >= 11
    assert [row["set"] for row in rows if row["found"] and row["encoding"] == "linear"] == ["data/diligent_ball"]
