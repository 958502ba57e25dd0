"""The lobes of the slope model and the regions that get them: by option, by `kinran choice`, or by need of a scene."""

from collections.abc import Sequence
from pathlib import Path

from kinran.base.files import InputError, read_json
from kinran.data.labels import LabelMap
from kinran.data.needed_regions import needed_labels
from kinran.fit.slope_lobes import Lobes


def chosen_lobes(choice: Path | None, tail: str, count: int) -> Lobes:
    """Lobes that `kinran choice` chose (.json); without a choice, lobes of this tail and number."""
    return _read(choice)[0] if choice else Lobes(tail, count)


def kind(model: str, lobes: Lobes) -> str:
    """Name of a model and its lobes; the file of a run of tiles holds it, so that no run of another kind is joined."""
    return f"slope: {lobes.count} {lobes.tail}" if model == "slope" else model


def lobed_labels(
    labels: LabelMap, asked: Sequence[int] | None, need: Path | None, choice: Path | None
) -> list[int] | None:
    """Labels of the regions that get a lobe; None for all.

    Parameters
    ----------
    labels : (y, x) int
        Label map of the fabric.
    asked
        Labels that an option names; None for all.
    need
        Needs of a scene (.json), which take the place of `asked`.
    choice
        Choice of `kinran choice` (.json), which leaves out regions that need no lobe.

    Raises
    ------
    InputError
        A file is missing or holds something else.
    """
    wanted = needed_labels(need, labels) if need else None if asked is None else list(asked)
    if choice is None:
        return wanted
    explained = _read(choice)[1]
    return explained if wanted is None else [label for label in wanted if label in explained]


def _read(choice: Path) -> tuple[Lobes, list[int]]:
    """Lobes and labels in a file of `kinran choice`."""
    value = read_json(choice)
    try:
        return Lobes(str(value["tail"]), int(value["lobes"])), [int(label) for label in value["fitted"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{choice}: holds no choice ({error!r}); make it with kinran choice") from None
