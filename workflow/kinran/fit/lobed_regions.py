"""Which lobes the slope model has, and which regions get them: what was asked for, what a choice or a scene says."""

from collections.abc import Sequence
from pathlib import Path

from kinran.base.files import InputError, read_json
from kinran.data.labels import LabelMap
from kinran.data.needed_regions import needed_labels
from kinran.fit.slope_lobes import Lobes


def chosen_lobes(choice: Path | None, tail: str, count: int) -> Lobes:
    """Lobes that `kinran choice` chose, or those of this tail and number."""
    return _read(choice)[0] if choice else Lobes(tail, count)


def kind(model: str, lobes: Lobes) -> str:
    """What a run of tiles was fitted with, in words: its file holds them, so that no run of another kind is joined."""
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
        Labels that were asked for; None for all.
    need
        Instead of them: what a scene needs (.json).
    choice
        What `kinran choice` chose (.json): of the labels those whose region a lobe explains.
    """
    wanted = needed_labels(need, labels) if need else None if asked is None else list(asked)
    if choice is None:
        return wanted
    explained = _read(choice)[1]
    return explained if wanted is None else [label for label in wanted if label in explained]


def _read(choice: Path) -> tuple[Lobes, list[int]]:
    """Lobes and labels that were chosen."""
    value = read_json(choice)
    try:
        return Lobes(str(value["tail"]), int(value["lobes"])), [int(label) for label in value["fitted"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{choice}: holds no choice ({error!r}); make it with kinran choice") from None
