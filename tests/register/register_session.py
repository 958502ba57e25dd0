"""A simulated session, and the stage's command line."""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plate
from numpy.typing import NDArray

from kinran.register import add_arguments, main, target


@dataclass(frozen=True)
class Session:
    """Views, what they show, and what the plate and the fabric are made of."""

    views: list[plate.View]
    pictures: list[NDArray[np.uint8]]
    ground: NDArray[np.float32]
    board: target.Board
    corners: list[target.Corners]
    folder: Path

    @property
    def files(self) -> list[str]:
        return [str(self.folder / f"{view.name}.png") for view in self.views]


def run(*words: str) -> None:
    """The stage, as the command line calls it."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    main(parser.parse_args(words))
