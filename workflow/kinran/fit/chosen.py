"""Which lobes the slope model has: those that are asked for, or those that were chosen."""

import argparse
from pathlib import Path

from kinran.files import InputError, read_json
from kinran.fit.lobes import TAILS


def add_lobes(parser: argparse.ArgumentParser) -> None:
    """Arguments that say what lobes the slope model has."""
    parser.add_argument("--lobes", type=int, choices=(1, 2), default=1, help="lobes of the slope model")
    parser.add_argument("--tail", choices=tuple(TAILS), default="ggx", help="tail of the slope model's lobes")
    parser.add_argument("--choice", type=Path, help="instead of both: what `kinran choice` chose (.json)")


def take_choice(args: argparse.Namespace) -> list[int] | None:
    """Set the arguments of `add_lobes` to what was chosen; labels that get a lobe by it, None for all.

    Raises
    ------
    InputError
        The file is missing or is something else.
    """
    if not args.choice:
        return None
    value = read_json(args.choice)
    try:
        args.lobes, args.tail = int(value["lobes"]), str(value["tail"])
        return [int(label) for label in value["fitted"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{args.choice}: holds no choice ({error!r}); make it with kinran choice") from None
