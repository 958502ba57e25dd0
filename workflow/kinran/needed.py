"""Which regions of a fabric a scene needs: what the fit takes from the file that `kinran need` writes."""

from pathlib import Path

import numpy as np

from kinran.files import InputError, read_json
from kinran.labels import LabelMap

SHOWN = 1e-3
"""Least share of the cloth's pixels from which a region counts as shown."""


def needed_labels(path: Path, labels: LabelMap) -> list[int]:
    """Labels of the regions that need a lobe.

    Parameters
    ----------
    path
        What the scene needs (.json).
    labels : (y, x) int
        Label map of the fabric.

    Raises
    ------
    InputError
        The file is missing, is something else, or was made for another label map.
    """
    try:
        rows = {int(row["label"]): bool(row["needed"]) for row in read_json(path)["regions"]}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: names no regions ({error!r}); make it with kinran need") from None
    if unknown := set(np.unique(labels).tolist()) - rows.keys():
        raise InputError(f"{path}: says nothing of the label {min(unknown)}; make it again with kinran need")
    return sorted(label for label, needed in rows.items() if needed)
