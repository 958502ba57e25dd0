"""What an evaluation says of a material, in sentences: at the end of a run, in the report and in the overview."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

WORTH_A_WARNING = 0.001
"""Share of texels that are wrong in a kind, from which on a warning says so. A choice: single texels are noise."""
NONE_HELD_OUT = "no light was held out, so nothing says how good the material is; hold some out with `holdout`"


@dataclass(frozen=True)
class Verdict:
    """Sentences on the default material of a fabric: how good it is, and what to look at."""

    says: str
    warnings: tuple[str, ...] = ()


def verdict(errors: dict[str, Any]) -> Verdict:
    """Return the verdict of what `evaluation.json` holds."""
    own = errors["methods"][errors["default"]]
    if "psnr" not in own:
        return Verdict(NONE_HELD_OUT)
    lights = len(errors["held_out"])
    says = f"{_both(own)} on {lights} held-out light{'s' * (lights > 1)}"
    beside = errors.get("beside", {})
    if not beside.get("baselines"):
        return Verdict(f"{says}; too few lights for a baseline", tuple(_exploded(own)))
    best = max(beside["baselines"].items(), key=lambda item: item[1]["psnr"])
    where = (
        "" if beside["whole"] else f" in {beside['texels']} texels, where the material has {_both(beside['material'])}"
    )
    says += f"; the best simple baseline, {best[0]}, has {_both(best[1])}{where}"
    return Verdict(says, (*_beaten(beside), *_exploded(own)))


def _beaten(beside: dict[str, Any]) -> Iterator[str]:
    """Warnings where a baseline is better, by either measure."""
    material, baselines = beside["material"], beside["baselines"]
    name, best = max(baselines.items(), key=lambda item: item[1]["psnr"])
    if best["psnr"] > material["psnr"]:
        yield f"{name} is better than the material: {best['psnr']:.2f} against {material['psnr']:.2f} dB"
    name, best = min(baselines.items(), key=lambda item: item[1]["relative_error"])
    if best["relative_error"] < material["relative_error"]:
        found = f"{best['relative_error']:.3f} against {material['relative_error']:.3f}"
        yield f"{name} is better than the material: relative error {found}"


def _exploded(own: dict[str, Any]) -> Iterator[str]:
    """Warnings of texels that the material gets wholly wrong."""
    if own["texels_above_1"] >= WORTH_A_WARNING:
        yield f"{100 * own['texels_above_1']:.2g} % of the texels have a relative error above 1: worse than black"
    if own["texels_above_white"] >= WORTH_A_WARNING:
        share = f"{100 * own['texels_above_white']:.2g} %"
        yield f"{share} of the texels are relit above white, at twice their photograph or more"


def _both(errors: dict[str, float]) -> str:
    return f"{errors['psnr']:.2f} dB, relative error {errors['relative_error']:.3f}"


def told(name: str, errors: dict[str, Any]) -> str:
    """Return the lines that end a run: the verdict on a fabric, and its warnings."""
    found = verdict(errors)
    return "\n".join([f"{name}: {found.says}", *(f"{name}: warning: {warning}" for warning in found.warnings)])
