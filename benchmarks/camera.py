"""What a frame costs with libgphoto2: release, list, download, second reading, decoding, deletion.

The camera is an emulated EOS on PTP/IP that takes no time itself.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from kinran.base.files import write_json
from kinran.base.project import ROOT
from kinran.rig.gphoto_camera import CameraSettings, GphotoCamera

sys.path.insert(0, str(ROOT / "tests" / "helpers"))  # the emulator of the tests


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--frames", type=int, default=12, help="frames that are taken")
    parser.add_argument("--rows", type=int, default=2602, help="rows of a frame, of 1.5 times as many columns")
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Take frames, print the table of the medians in seconds, write the JSON."""
    from eos_emulator import emulator

    spent: dict[str, list[float]] = {}

    def timed(what: str, call: Callable[..., object], *given: object) -> None:
        began = time.perf_counter()
        call(*given)
        spent.setdefault(what, []).append(time.perf_counter() - began)

    with tempfile.TemporaryDirectory(prefix="kinran-camera-") as folder, emulator() as eos:
        path = Path(folder) / "frame.part"
        with closing(GphotoCamera(CameraSettings(eos.port), lands_s=60.0)) as camera:
            timed("open", camera.card)
            camera.expose(1 / 100)
            eos.tell(shape=[args.rows, args.rows * 3 // 2])
            for k in range(args.frames):
                timed("set and release", camera.expose, (1 / 25, 1 / 250)[k % 2])
                timed("list", camera.card)
                file = camera.card()[-1]
                timed("download", camera.download, file.name, path)
                timed("second reading", camera.digest, file.name)
                timed("decode", camera.facts, path)
                timed("delete", camera.delete, file.name)
    results = {"bytes": file.bytes} | {what: round(statistics.median(times), 4) for what, times in spent.items()}
    for name, value in results.items():
        print(f"{name:16} {value:>10}")
    if args.out:
        write_json(args.out, results)
