"""Errors of fits on held-out lights as each of several cases is made worse: which methods fail, and which hold."""

import argparse
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.texels import (
    Array,
    Method,
    Single,
    Split,
    facets,
    four_steps,
    joint,
    lobes,
    microfacets,
    noisy,
    ones,
    spread,
    texels,
)
from kinran.base import frames
from kinran.base.files import write_json
from kinran.fit import bounded, learned_priors, robust_weights, shrinkage, slope, takeda, trust
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.models import Takeda2008

log = logging.getLogger(__name__)

Row = dict[str, Any]

TEXELS = 60
"""Texels of a case, unless it says otherwise. A choice."""
FOUR, JOINT, PRINTED = "four steps", "Eq. 3, joint", "Eq. 3 as printed, joint"
GGX, PAIR, TRUSTED, HELD = "GGX lobe", "two Gaussian lobes", "GGX lobe, what fits in", "GGX lobe, prior of the region"
WEIGHED = "GGX lobe, as much of the prior as lights left out bear"
FACE, LEFT_OUT_HELD = "at face value", "left out, prior of the region"
BOUNDED = "bounds, prior of the region"
NEEDLES, RESOLVED = f"{PAIR}, widths from 0.02", f"{PAIR}, widths that the lights resolve"
DRIFT, MONITORS = "GGX lobe, drift left in", "GGX lobe, monitors"
SHOTS = (4000, 1000, 250, 100, 25)
"""Shutter speeds of the paper's bracket, the shortest exposure first."""


def pole(split: Split) -> Iterator[Row]:
    """Facets that face the camera leave φ_n without meaning."""
    for tilt in (0, 2, 5, 8, 12, 20, 30):
        clean = microfacets(*facets(tilt, TEXELS), split.lights)
        yield from _rows("pole", f"tilt {tilt}°", split, clean, {FOUR: four_steps, JOINT: joint(), GGX: lobes()})


def azimuth_wrap(split: Split) -> Iterator[Row]:
    """Eq. 3 as printed does not say that azimuths are of a circle."""
    theta, phi = frames.angles(frames.half_vector(split.lights))
    methods = {PRINTED: joint(False), JOINT: joint(), "Gaussian lobe": lobes("gaussian")}
    for degrees in (180, 30, 15, 5, 355):
        G = Takeda2008.of_angles(theta, phi, np.radians(20), np.radians(degrees), 0.15, 0.5)
        clean = np.repeat((2 * G + 0.1 * split.lights[:, 2])[None, None], 3, 1).repeat(4, 0).astype(np.float32)
        yield from _rows("azimuth wraps", f"φ_n {degrees}°", split, clean, methods)


def narrow(split: Split) -> Iterator[Row]:
    """Lobes are narrower than the grid, whose step is 0.044 in slope."""
    for width in (0.1, 0.06, 0.04, 0.02, 0.01):
        clean = microfacets(*facets(15, TEXELS, width), split.lights)
        methods = {FOUR: four_steps, JOINT: joint(), GGX: lobes()}
        yield from _rows("narrow lobe", f"width {width}", split, clean, methods)


def saturation(split: Split) -> Iterator[Row]:
    """The longest exposures are kept: a sample that saturates in all of them is a bound, not a value."""
    clean = microfacets(*_of_one_region(), split.lights)
    for kept in (5, 4, 3, 2):
        # the shortest of five exposures just reaches the brightest highlight
        level = clean.max() * SHOTS[5 - kept] / SHOTS[0]
        seen = noisy(clean)
        clipped = (seen >= level).any(1)
        W = np.where(clipped, 0, 1).astype(np.float32)
        seen = np.minimum(seen, np.float32(level))
        full = clipped[:, ~split.held]
        rows = [(FACE, lobes(), None), ("left out", lobes(), W), (LEFT_OUT_HELD, _held_by_region(Lobes()), W)]
        rows += [
            (f"{BOUNDED}, {PAIR}", _held_by_region(Lobes("gaussian", 2), full), W),
            (BOUNDED, _held_by_region(Lobes(), full), W),
        ]
        for name, method, weights in rows:
            yield _row("saturation", f"{kept} exposures", name, split.error(method, clean, seen, weights))


def noise(split: Split) -> Iterator[Row]:
    """Noise is a share of diffuse white."""
    clean = microfacets(*texels(TEXELS), split.lights)
    for sd in (0.001, 0.01, 0.03, 0.1, 0.3):
        seen = noisy(clean, share=0, floor=sd)
        yield from _rows("noise", f"sd {sd}", split, clean, {FOUR: four_steps, JOINT: joint(), GGX: lobes()}, seen)


def outliers(split: Split) -> Iterator[Row]:
    """Outliers are anywhere up to 1.5 times the peak."""
    clean = microfacets(*texels(TEXELS), split.lights)
    rng = np.random.default_rng(3)
    for percent in (0, 0.5, 2, 5, 10):
        hit = rng.random((TEXELS, 1, len(split.lights))) < percent / 100
        level = rng.uniform(0, 1.5, hit.shape) * clean.max((1, 2), keepdims=True)
        seen = np.where(hit, level, noisy(clean)).astype(np.float32)
        methods = {FOUR: four_steps, GGX: lobes(), TRUSTED: _trusted}
        yield from _rows("outliers", f"{percent} %", split, clean, methods, seen)


def needles(split: Split) -> Iterator[Row]:
    """Two lobes may put a needle between two lights; the 95th percentile counts, since a few texels do."""
    clean = microfacets(*texels(200), split.lights)
    for count in (100, 50, 30):
        few, order = _thinned(split, count)
        for name, least in ((NEEDLES, 0.02), (RESOLVED, None)):
            method = lobes("gaussian", 2, narrow=least)
            error = few.error(method, clean[..., order], noisy(clean)[..., order])
            yield _row("needles between lights, 95th percentile", f"{count} lights", name, error, 95)


def few_directions(split: Split) -> Iterator[Row]:
    """Lights are few, and shapes differ by 10 % in the region; the 95th percentile counts, as a few explode."""
    clean = microfacets(*_of_one_region(200), split.lights)
    alone = {JOINT: joint(), PAIR: lobes("gaussian", 2), GGX: lobes()}
    for count in (int((~split.held).sum()), 100, 50, 30, 16):
        few, order = _thinned(split, count)
        for name, method in {**alone, HELD: _held_by_region(Lobes())}.items():
            error = few.error(method, clean[..., order], noisy(clean)[..., order])
            yield _row("few directions, 95th percentile", f"{count} lights", name, error, 95)


def two_fabrics(split: Split) -> Iterator[Row]:
    """A region holds a second, sharp fabric, under 100 lights: one shape for all is wrong for some."""
    few, order = _thinned(split, 100)
    for share in (0, 0.1, 0.3, 0.5):
        shapes, colours = texels(200)
        sharp = np.random.default_rng(1).random(len(shapes)) < share
        shapes[:, 2] = shapes[:, 4] = -np.log(np.where(sharp, 0.09, 0.4))
        shapes[:, 3] = 0
        clean = microfacets(shapes, colours, split.lights)
        for name, method in {GGX: lobes(), HELD: _held_by_region(Lobes()), WEIGHED: _held_as_far}.items():
            error = few.error(method, clean[..., order], noisy(clean)[..., order])
            yield _row("two fabrics in a region, 95th percentile", f"{share} of it sharp", name, error, 95)


def diffuse_colour(split: Split) -> Iterator[Row]:
    """Step 2 takes C_d opposite to the lobe, where the lobe's own tail or a shadow is; the error is that of C_d."""
    theta, phi = frames.angles(split.lights)
    shadow = np.where((np.cos(phi) < -0.5) & (theta > np.radians(40)), 0.1, 1.0)
    for level, shade in ((0.3, None), (0.1, None), (0.01, None), (0.3, shadow)):
        shapes, colours = facets(3.0, TEXELS)
        shapes[:, :2] = np.tan(np.radians(3)), 0
        colours[:, 1] = level
        clean = microfacets(shapes, colours, split.lights)
        T = noisy(clean if shade is None else clean * shade, floor=0.0003)
        samples = Samples.far(T, ones(T), split.lights)
        steps = takeda.four_steps(samples, np.radians(2.5), np.radians(7.6)).colours[:, 1]
        found = {FOUR: steps, GGX: slope.fit(samples, Lobes()).colours[:, 1]}
        for name, C_d in found.items():
            setting = f"C_d {level}" + (", that side in shadow" if shade is not None else "")
            yield _row("diffuse colour C_d", setting, name, np.abs(C_d / level - 1).mean(1))


def second_lobe(split: Split) -> Iterator[Row]:
    """A wide lobe of the yarns lies under a sharp one."""
    sharp, wide = facets(8.0, TEXELS, 0.1), facets(20.0, TEXELS, 0.35)
    for share in (0, 0.1, 0.3, 1):
        clean = microfacets(*sharp, split.lights) + microfacets(wide[0], share * wide[1], split.lights)
        methods = {FOUR: four_steps, JOINT: joint(), GGX: lobes(), PAIR: lobes("gaussian", 2)}
        yield from _rows("second lobe", f"{share} of the first", split, clean, methods)


def grazing(split: Split) -> Iterator[Row]:
    """A lobe brightens at grazing light as Fresnel's reflectance does; the error is that at θ_i of 65° and more."""
    clean = microfacets(*texels(TEXELS), split.lights)
    rise = 1 + 2 * (1 - split.lights[:, 2]) ** 5
    clean = (clean * rise).astype(np.float32)
    steep = split.lights[:, 2] < np.cos(np.radians(64))
    for last in (80, 60, 50, 40):
        use = (~split.held | steep) & ((split.lights[:, 2] > np.cos(np.radians(last + 1))) | steep)
        held = steep & split.held if last == 80 else steep
        part = Split(split.lights[use], held[use])
        methods = {FOUR: four_steps, JOINT: joint(), PAIR: lobes("gaussian", 2), GGX: lobes()}
        yield from _rows("grazing light", f"lights up to {last}°", part, clean[..., use], methods)


def degenerate(split: Split) -> Iterator[Row]:
    """Texels have no lobe, or samples that are not finite."""
    clean = microfacets(*texels(TEXELS), split.lights)
    methods = {FOUR: four_steps, GGX: lobes()}
    flat = np.ones_like(clean) * split.lights[:, 2].astype(np.float32)
    for name, truth in (
        ("constant", np.full_like(clean, 0.3)),
        ("1e-6 of it", 1e-6 * clean),
        ("1e6 of it", 1e6 * clean),
    ):
        yield from _rows("degenerate texels", name, split, truth, methods, truth)
    for name, truth in (("zero", 0 * clean), ("negative", 0 * clean - np.float32(0.1))):
        # what such texels should be is black: the error is what they show instead
        for method, call in methods.items():
            error = split.error(call, np.ones_like(clean), truth)
            yield _row("degenerate texels", name, method, np.abs(error - 1))
    for name, bad in (("one NaN", np.nan), ("one infinity", np.inf)):
        seen = clean.copy()
        seen[:, 1, 101] = bad
        yield from _rows("degenerate texels", name, split, clean, methods, seen)
    yield from _rows("degenerate texels", "diffuse alone", split, flat, methods)


def mixed_texels(split: Split) -> Iterator[Row]:
    """Texels on an edge see two regions."""
    gold, silk = texels(TEXELS), texels(TEXELS, 5)
    silk[0][:, 2:5] = -np.log(0.5), 0, -np.log(0.5)
    silk[1][:] *= np.array([[0.1], [3]])
    for share in (0, 0.25, 0.5, 0.75):
        clean = (1 - share) * microfacets(*gold, split.lights) + share * microfacets(*silk, split.lights)
        yield from _rows(
            "mixed texels", f"{share} silk", split, clean, {FOUR: four_steps, GGX: lobes(), PAIR: lobes("gaussian", 2)}
        )


def wrong_directions(split: Split) -> Iterator[Row]:
    """One light of twenty stands elsewhere than the list says."""
    clean = microfacets(*texels(TEXELS), split.lights)
    rng = np.random.default_rng(7)
    theta, phi = frames.angles(split.lights)
    off = (rng.random(len(theta)) < 0.05) & ~split.held
    for degrees in (0, 2, 5, 10, 20):
        turned = frames.direction(theta + np.radians(degrees) * off, phi)
        seen = microfacets(*texels(TEXELS), np.where(turned[:, 2:] > 0.02, turned, split.lights))
        methods = {FOUR: four_steps, GGX: lobes(), TRUSTED: _trusted}
        yield from _rows("wrong light directions", f"1 of 20 by {degrees}°", split, clean, methods, noisy(seen))


def lamp_drift(split: Split) -> Iterator[Row]:
    """The lamp fades over the capture; monitors are the repeats of θ = 0 in between."""
    clean = microfacets(*texels(TEXELS), split.lights)
    shot = np.linspace(0, 1, len(split.lights))
    rng = np.random.default_rng(8)
    for percent in (0, 5, 10, 20):
        gain = 1 - percent / 100 * np.sqrt(shot)
        monitors = np.linspace(0, 1, 18)
        seen_gain = np.interp(monitors, shot, gain) * (1 + 0.002 * rng.normal(size=monitors.size))
        seen = noisy(clean * gain)
        corrected = (seen / np.interp(shot, monitors, seen_gain)).astype(np.float32)
        for name, T in ((DRIFT, seen), (MONITORS, corrected)):
            yield _row("lamp drift", f"{percent} %", name, split.error(lobes(), clean, T))
        yield _row("lamp drift", f"{percent} %", FOUR, split.error(four_steps, clean, seen))


CASES = (
    (pole, JOINT, GGX),
    (azimuth_wrap, PRINTED, JOINT),
    (narrow, FOUR, GGX),
    (saturation, FACE, BOUNDED),
    (noise, FOUR, GGX),
    (outliers, GGX, TRUSTED),
    (needles, NEEDLES, RESOLVED),
    (few_directions, JOINT, HELD),
    (two_fabrics, HELD, WEIGHED),
    (diffuse_colour, FOUR, GGX),
    (second_lobe, GGX, PAIR),
    (grazing, JOINT, PAIR),
    (degenerate, FOUR, GGX),
    (mixed_texels, GGX, PAIR),
    (wrong_directions, GGX, TRUSTED),
    (lamp_drift, DRIFT, MONITORS),
)
"""Each case, the method that fails in it, and the remedy that holds."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--out", type=Path, required=True, help="rows of case, parameter, method and error (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure all cases, print them, write JSON."""
    split = Split.of_grid()
    rows, summary = [], []
    for k, (case, fails, holds) in enumerate(CASES):
        log.info("stability: case %d of %d, %s", k + 1, len(CASES), case.__name__)
        found = list(case(split))
        rows += found
        summary.append(worst(found, fails, holds))
    lights = {"fitted": int((~split.held).sum()), "held_out": int(split.held.sum())}
    write_json(args.out, {"lights": lights, "rows": rows, "summary": summary})
    for row in rows:
        error = "not finite" if row["error"] is None else f"{row['error']:.3f}"
        print(f"{row['case']:40s} {row['parameter']:28s} {row['method']:52s} {error}")


def worst(rows: list[Row], fails: str, holds: str) -> Row:
    """Parameter of a case at which one method's error is most above the other's, with both errors."""
    errors = {(row["parameter"], row["method"]): row["error"] for row in rows}
    ratio = {
        parameter: np.inf if error is None else error / max(errors[parameter, holds], 1e-3)
        for (parameter, method), error in errors.items()
        if method == fails
    }
    at = max(ratio, key=lambda parameter: ratio[parameter])
    given = {"case": rows[0]["case"], "parameter": at, "fails": fails, "error_failing": errors[at, fails]}
    return given | {"holds": holds, "error_holding": errors[at, holds]}


def _rows(
    case: str, parameter: str, split: Split, clean: Single, methods: dict[str, Method], seen: Single | None = None
) -> Iterator[Row]:
    """Rows of all methods; samples have noise of 1 % and 0.003 where none are given."""
    given = noisy(clean) if seen is None else seen
    for name, method in methods.items():
        yield _row(case, parameter, name, split.error(method, clean, given))


def _row(case: str, parameter: str, method: str, error: Array, percentile: float = 50) -> Row:
    """A row with a percentile over texels; None where it is no number."""
    value = float(np.percentile(error, percentile, method="lower"))
    return {
        "case": case,
        "parameter": parameter,
        "method": method,
        "error": round(value, 5) if np.isfinite(value) else None,
    }


def _of_one_region(count: int = TEXELS) -> tuple[Array, Array]:
    """Texels whose shapes differ by 10 % but for their normals."""
    shapes, colours = texels(count)
    spread_ = np.random.default_rng(4).normal(0, 0.1, (count, 3))
    shapes[:, 2:5] = np.array([-np.log(0.1), 0.5, -np.log(0.15)]) + spread_
    return shapes, colours


def _thinned(split: Split, count: int) -> tuple[Split, NDArray[np.intp]]:
    """A few of the lights for the fit, spread over slopes, with those held out; and their indices."""
    train, held = np.flatnonzero(~split.held), np.flatnonzero(split.held)
    order = np.r_[train[spread(split.lights[train], count)], held]
    return Split(split.lights[order], np.arange(len(order)) >= count), order


def _held_by_region(lobes: Lobes, full: NDArray[np.bool_] | None = None) -> Method:
    """The fit of the pipeline: under priors learned from half of the texels, and with saturated samples as bounds."""

    def method(samples: Samples) -> Fitted:
        priors = learned_priors.learn_priors(samples.of(slice(None, None, 2)), 1, lobes)
        fitted = slope.fit(samples, lobes, priors)
        if full is None:
            return fitted
        return bounded.refit(fitted, replace(samples, bounds=full.astype(np.float32)), priors)

    return method


def _held_as_far(samples: Samples) -> Fitted:
    """The fit under the share of the region's prior that cross-validation leaves, as in the stage `prior`."""
    half = samples.of(slice(None, None, 2))
    priors = shrinkage.weigh(learned_priors.learn_priors(half, 1, Lobes()), half, Lobes())
    return slope.fit(samples, Lobes(), priors)


def _trusted(samples: Samples) -> Fitted:
    """The fit to the samples that the stages `prior` and `fit` trust, with the loss that they take."""
    factors, outliers = trust.learn(samples, Lobes(), 1)
    samples = samples.weighed(factors)
    return robust_weights.robust(samples, Lobes())[0] if outliers else slope.fit(samples, Lobes())
