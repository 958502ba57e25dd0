"""Which regions get lobes: those that are asked for, that a scene needs, and that lobes explain."""

import argparse

from kinran.fit.chosen import take_choice
from kinran.labels import LabelMap
from kinran.needed import needed_labels


def fitted_labels(args: argparse.Namespace, labels: LabelMap) -> list[int] | None:
    """Labels that get a lobe, None for all, by ``--fitted``, ``--need`` and ``--choice``; sets the lobes, too."""
    asked = needed_labels(args.need, labels) if args.need else args.fitted
    explained = take_choice(args)
    if explained is None or asked is None:
        return asked if explained is None else explained
    return [label for label in asked if label in explained]
