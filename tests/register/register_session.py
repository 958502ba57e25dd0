"""A simulated session."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plate
from numpy.typing import NDArray

from kinran.register import target
from kinran.register.register import Inputs


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
    def files(self) -> list[Path]:
        return [self.folder / f"{view.name}.png" for view in self.views]

    def inputs(self, files: list[Path]) -> Inputs:
        return Inputs(tuple(files), self.folder / "board.yaml")
