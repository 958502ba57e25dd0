"""A fabric's folder: the measured data that the stages after the merge read."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from kinran.base.files import InputError
from kinran.data.labels import LabelMap, Region, read_labels, read_regions, read_second
from kinran.data.radiance_stack import Stack


@dataclass(frozen=True)
class Fabric:
    """Measured fabric in a folder: ``radiance.zarr``, ``labels.exr``, ``regions.json``.

    Each file is read on first use.

    Raises
    ------
    InputError
        A file is missing or damaged, or the label map is not of the stack's size.
    """

    folder: Path

    @property
    def stack_path(self) -> Path:
        """Folder of the radiance stack."""
        return self.folder / "radiance.zarr"

    @property
    def labels_path(self) -> Path:
        """File of the label map."""
        return self.folder / "labels.exr"

    @property
    def regions_path(self) -> Path:
        """File of the regions."""
        return self.folder / "regions.json"

    @cached_property
    def stack(self) -> Stack:
        """Radiance stack."""
        return Stack.open(self.stack_path)

    @cached_property
    def labels(self) -> LabelMap:
        """Region (y, x) of each texel."""
        labels = read_labels(self.labels_path)
        height, width = self.stack.height, self.stack.width
        if labels.shape != (height, width):
            raise InputError(
                f"{self.labels_path}: its {labels.shape[0]} × {labels.shape[1]} texels are not the {height} × {width}"
                " of the stack; make it again with kinran segment"
            )
        return labels

    @cached_property
    def second(self) -> LabelMap:
        """Region (y, x) that shares each texel; the texel's own label where none does."""
        return read_second(self.labels_path, self.labels)

    @cached_property
    def regions(self) -> list[Region]:
        """Regions of the label map."""
        return read_regions(self.regions_path)
