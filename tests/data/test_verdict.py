"""What an evaluation says in sentences: how good a material is, beside what, and what to look at."""

from typing import Any

import pytest

from kinran.data.verdict import told, verdict


def errors(material: tuple[float, float], baselines: dict[str, tuple[float, float]], **share: float) -> dict[str, Any]:
    """An evaluation of a material and baselines, each of (PSNR, relative error), with shares of texels."""

    def of(pair: tuple[float, float]) -> dict[str, float]:
        return {"psnr": pair[0], "relative_error": pair[1]}

    own = {**of(material), "texels_above_1": 0.0, "texels_above_white": 0.0, **share}
    beside = {
        "texels": 50,
        "whole": True,
        "material": of(material),
        "baselines": {n: of(p) for n, p in baselines.items()},
    }
    return {"default": "slope", "held_out": ["a", "b"], "methods": {"slope": own}, "beside": beside}


def test_a_material_beside_the_best_baseline() -> None:
    found = verdict(errors((30.0, 0.1), {"PTM": (20.0, 0.4), "HSH 9": (24.5, 0.3)}))
    assert found.says == (
        "30.00 dB, relative error 0.100 on 2 held-out lights; the best simple baseline, HSH 9, has 24.50 dB, "
        "relative error 0.300"
    )
    assert not found.warnings


@pytest.mark.parametrize(
    ("baseline", "share", "words"),
    [
        ((31.0, 0.2), {}, "PTM is better than the material: 31.00 against 30.00 dB"),
        ((20.0, 0.05), {}, "PTM is better than the material: relative error 0.050 against 0.100"),
        ((20.0, 0.2), {"texels_above_1": 0.02}, "2 % of the texels have a relative error above 1"),
        ((20.0, 0.2), {"texels_above_white": 0.004}, "0.4 % of the texels are relit above white"),
    ],
)
def test_warnings(baseline: tuple[float, float], share: dict[str, float], words: str) -> None:
    (warning,) = verdict(errors((30.0, 0.1), {"PTM": baseline}, **share)).warnings
    assert warning.startswith(words)
    assert f"silk: warning: {words}" in told("silk", errors((30.0, 0.1), {"PTM": baseline}, **share))


def test_some_texels_are_said_to_be_some() -> None:
    some = errors((30.0, 0.1), {"PTM": (20.0, 0.4)})
    some["beside"]["whole"] = False
    assert verdict(some).says.endswith("in 50 texels, where the material has 30.00 dB, relative error 0.100")


def test_without_held_out_lights_nothing_is_claimed() -> None:
    found = verdict({"default": "slope", "held_out": [], "methods": {"slope": {"fit": {}}}})
    assert "no light was held out" in found.says
    assert not found.warnings
