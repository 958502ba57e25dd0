"""Error of the levels of a pyramid: `python benchmarks/pyramid.py MATERIAL.exr …`, as JSON.

Each level is compared with the mean of the texels that it stands for, at V = N under 60 lights up to 70°. The figures
are the RMS of the difference over the RMS of the means, and the error of the mean. Residuals are left out.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

LEVELS = 5
"""Levels of the pyramid that are measured: from a texel to 16 × 16 of them."""
MOST = 192  # a side of the part in the middle that is measured, in texels


def directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) up to 70° from the normal, evenly."""
    z = np.linspace(1, np.cos(np.radians(70)), count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def errors(path: Path) -> dict[str, Any]:
    """RMS and mean of the error of each level, in percent, and the time that they take."""
    from kinran_bsdf import read_material
    from kinran_bsdf.maps import PackedMaps, pack
    from kinran_bsdf.mixture import mean

    whole = read_material(path)
    cut = [slice(max(0, n // 2 - MOST // 2), n // 2 + MOST // 2) for n in whole.size]
    material = replace(whole.part(*cut), residual=None)
    maps, packed, weights = PackedMaps(material, "nearest", "repeat", 0.01, False), pack(material, 3), None

    def seen(level: np.ndarray) -> np.ndarray:
        channels = list(np.moveaxis(level, -1, 0))
        return np.array([maps.radiance(channels, light) for light in directions(60)])

    truth, found, seconds = seen(packed), [], 0.0
    for _ in range(LEVELS):
        start = time.perf_counter()
        packed, weights = maps.next_level(packed, weights)
        seconds += time.perf_counter() - start
        truth = mean(truth)
        off = seen(packed) - truth
        rms, bias = np.sqrt((off**2).mean() / (truth**2).mean()), off.mean() / truth.mean()
        found.append([round(100 * float(rms), 1), round(100 * float(bias), 1)])
    return {
        "lobes": material.lobes,
        "tail": material.tail,
        "texels": material.size,
        "levels": found,
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("materials", nargs="+", type=Path)
    args = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    json.dump({str(path): errors(path) for path in args.materials}, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
