"""How often photographs are doubted with reason, and without: their encoding, and the axes of their lights.

Each real set is judged as it is, with its values brought to the other encoding, and with y of its lights turned.
Measured BRDFs [Sztrajman2021] are photographed as facets under domes, in sRGB of 8 bits and linear of 16.
"""

import argparse
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import real_nbrdf
from kinran.base import frames
from kinran.base.encoding import from_srgb, parse, to_srgb
from kinran.base.files import InputError, write_json
from kinran.capture import axes_evidence, encoding_evidence, ingest
from kinran.capture.photograph_set import Known, inspect
from kinran.capture.sampled_set import SampledSet, sample
from kinran.data.photographs import CLIPPED

Array = NDArray[np.float64]

DOMES = {
    "wide": ((10, 6), (25, 10), (40, 12), (55, 14), (70, 14)),
    "narrow": ((5, 4), (15, 8), (25, 12), (38, 16)),
    "few": ((30, 6), (55, 10)),
}
"""θ in degrees and number of lights of each ring."""
CASES = (
    *(("wide", slope, 0.05, 0.98) for slope in (0.02, 0.15, 0.5)),
    ("wide", 0.15, 0.15, 0.98),
    ("wide", 0.15, 0.05, 0.7),
    *(("narrow", slope, 0.05, 0.98) for slope in (0.15, 0.5)),
    ("few", 0.15, 0.05, 0.98),
)
"""Dome, standard deviations of slopes and of the lamps' light, and the quantile of the light at 0.9 of white."""
FACETS = 200
"""Facets of a material."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, required=True, help="folder of the real sets")
    parser.add_argument("--more", nargs="*", default=[], help="FOLDER:ENCODING of other sets")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure both, and print tables."""
    write_json(args.out, {"sets": of_sets(args.data, args.more), "materials": of_materials(args.data / "nbrdf")})


def folders(data: Path, more: list[str]) -> dict[Path, str]:
    """Return the folders of real sets, with their encoding."""
    objects = data / "synthrti" / "Single" / "Object1"
    return {
        **{data / "realrti" / name: "srgb" for name in ("item3", "item5", "item11")},
        **{objects / f"material{k}" / "Dome": "srgb" for k in range(1, 9)},
        data / "diligent_ball": "linear",
        **{Path(folder): name for folder, _, name in (text.rpartition(":") for text in more)},
    }


def read(folder: Path, encoding: str) -> SampledSet:
    """Sample a set."""
    known = Known(encoding)
    found = inspect(folder, known, 0)
    return sample(ingest.plan("set", found, known), [found.frames[light.name][0] for light in found.lights])


def of_sets(data: Path, more: list[str]) -> list[dict[str, Any]]:
    """Return what is said of each set and each of its versions; printed as a table."""
    rows = []
    print(f"{'set':28s} {'encoding':9s} ratio  linear  curved  right  wrong | axes   right  turned")
    for folder, own in folders(data, more).items():
        found = read(folder, own)
        for name in ("srgb", "linear"):
            codes = found.codes if name == own else (to_srgb if name == "srgb" else from_srgb)(found.codes)
            row = judge(replace(found, codes=codes), name)
            rows.append({"set": "/".join(folder.parts[-2:]), "encoding": name, "own": name == own, **row})
            said = f"{row['doubted']!s:5s}  {row['found']!s:5s}"
            axes = f"{row['correlation']:+.2f} ± {row['error']:.2f} {row['mirrored']!s:5s} {row['turned']!s}"
            print(
                f"{rows[-1]['set'][:28]:28s} {name + '*' * (name == own):9s} {row['ratio']:+.2f}"
                f" {row['linear']:7.1%} {row['curved']:7.1%}  {said} | {axes}",
                flush=True,
            )
    return rows


def judge(found: SampledSet, encoding: str) -> dict[str, Any]:
    """Return what is said of a set under its own encoding and axes, and under others."""
    evidence = encoding_evidence.weigh(found)
    right, wrong = parse(encoding), parse("linear" if encoding == "srgb" else "srgb")
    correlation, error = axes_evidence.correlate(found, right)
    turned = axes_evidence.correlate(replace(found, directions=found.directions * [1, -1, 1]), right)
    return {
        "ratio": evidence.ratio if evidence else 0.0,
        "linear": evidence.linear if evidence else 0.0,
        "curved": evidence.curved if evidence else 0.0,
        "doubted": bool(encoding_evidence.doubt(evidence, right)),
        "found": bool(encoding_evidence.doubt(evidence, wrong)),
        "correlation": correlation,
        "error": min(error, 9.99),
        "mirrored": bool(axes_evidence.doubt(correlation, error)),
        "turned": bool(axes_evidence.doubt(*turned)),
    }


def of_materials(folder: Path) -> list[dict[str, Any]]:
    """Return how many materials are doubted, by case; printed as a table."""
    nets = []
    for archive in ("merl_nbrdf.zip", "rgl-isotropic_nbrdf.zip"):
        names = [Path(name).stem for name in zipfile.ZipFile(folder / archive).namelist() if name.endswith(".h5")]
        nets += [real_nbrdf.load(folder / archive, name) for name in sorted(names)]
    if not nets:
        raise InputError(f"{folder}: has no networks; get them again")
    print(f"\n{len(nets)} materials              linear: without reason  with | encoded: without reason  with")
    rows = []
    for dome, slope, lamps, exposed in CASES:
        seen = [photographs(net, DOMES[dome], slope, lamps, exposed) for net in nets]
        row = {"dome": dome, "slope": slope, "lamps": lamps, "exposed": exposed, **count(seen)}
        rows.append(row)
        print(
            f"{dome:7s} slope {slope:4.2f} lamps {lamps:.0%} at {exposed:4.2f} {row['linear_without']:14d}"
            f" {row['linear_with']:5d} | {row['encoded_without']:23d} {row['encoded_with']:5d}",
            flush=True,
        )
    return rows


def count(seen: list[dict[str, SampledSet]]) -> dict[str, int]:
    """Return how many sets look linear and encoded, with reason and without."""
    evidence = {name: [encoding_evidence.weigh(each[name]) for each in seen] for name in ("srgb", "linear")}
    said = {
        (name, taken): sum(bool(encoding_evidence.doubt(each, parse(taken))) for each in evidence[name])
        for name in evidence
        for taken in evidence
    }
    return {
        "linear_without": said["srgb", "srgb"],
        "linear_with": said["linear", "srgb"],
        "encoded_without": said["linear", "linear"],
        "encoded_with": said["srgb", "linear"],
    }


def photographs(
    net: real_nbrdf.Net, rings: tuple[tuple[int, int], ...], slope: float, lamps: float, exposed: float
) -> dict[str, SampledSet]:
    """Return photographs of tilted facets of a material, as sRGB of 8 bits and linear of 16."""
    rng = np.random.default_rng(3)
    lights = np.concatenate(
        [frames.direction(np.full(n, np.radians(theta)), np.arange(n) * 2 * np.pi / n + theta) for theta, n in rings]
    )
    normals = np.concatenate([rng.normal(0, slope, (FACETS, 2)), np.ones((FACETS, 1))], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.cross([0.0, 1.0, 0.0], normals)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    axes = np.stack([across, np.cross(normals, across), normals], 1)
    local = np.einsum("fij,lj->lfi", axes, lights)
    view = np.broadcast_to(axes[..., 2], local.shape)
    seen = real_nbrdf.brdf(net, local.reshape(-1, 3).copy(), view.reshape(-1, 3)).reshape(local.shape)
    seen *= np.maximum(local[..., 2:], 0) * np.exp(rng.normal(0, 0.2, (FACETS, 1)))
    seen *= np.exp(rng.normal(0, lamps, (len(lights), 1, 1))) * np.exp(rng.normal(0, 0.01, seen.shape))
    light = np.clip(seen * 0.9 / np.quantile(seen, exposed), 0, 1)
    codes = {"srgb": np.round(to_srgb(light) * 255) / 255, "linear": np.round(light * 65535) / 65535}
    return {
        name: SampledSet(values.mean(-1)[:, None], (values >= CLIPPED).any(-1)[:, None], lights, np.ones(len(lights)))
        for name, values in codes.items()
    }
