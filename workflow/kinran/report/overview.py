"""Write the overview: all fabrics of a run on one HTML page."""

import argparse
import os
from pathlib import Path
from typing import Any

from kinran.files import read_json
from kinran.report.page import embed_file, write_page


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--errors", type=Path, nargs="+", required=True, help="evaluation.json of each fabric")
    parser.add_argument("out", type=Path, help="page (.html)")


def main(args: argparse.Namespace) -> None:
    """Gather and write."""
    fabrics = [_fabric(path, args.out.parent) for path in args.errors]
    write_page(args.out, "overview.html", {"title": "Fabrics", "fabrics": fabrics})


def _fabric(path: Path, folder: Path) -> dict[str, Any]:
    errors = read_json(path)
    methods = [
        {
            "name": name,
            "relative": f"{m['relative_error']:.3f}" if "psnr" in m else "not judged",
            "psnr": f"{m['psnr']:.2f} dB" if "psnr" in m else "",
            "us": f"{m['fit']['microseconds_per_texel']:.0f}",
        }
        for name, m in errors["methods"].items()
    ]
    return {
        "name": errors["fabric"],
        "link": os.path.relpath(path.with_name("report.html"), folder),
        "lights": errors["training_lights"],
        "held": len(errors["held_out"]),
        "methods": methods,
        "render": embed_file(path.with_name("render.png")),
    }
