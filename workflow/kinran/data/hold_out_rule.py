"""The rule that holds lights out: they are kept from every fit, so that a material can be judged under them."""

from collections.abc import Sequence

from kinran.base.files import InputError

LEAST = 4
"""Fewest lights to fit: normal and albedo of a matt surface are three unknowns already."""


def held_out(grid: Sequence[tuple[int, int] | None], every: int, where: object) -> set[int]:
    """Return the indices of the lights to hold out.

    In a grid these are the lights with (iθ + iφ) mod `every` = `every` // 2, but never θ = 0; in a list, every
    `every`-th light.

    Parameters
    ----------
    grid
        (iθ, iφ) of each light in the plan's grid; None in a list.
    every
        One light of so many is held out; 0 for none.
    where
        Folder or file of the lights, to name in an error.

    Raises
    ------
    InputError
        `every` is negative or 1, or leaves no light to hold out or fewer than 4 to fit.
    """
    if every < 0 or every == 1:
        raise InputError(f"{where}: --holdout {every}: give 0 for none, or 2 and more")
    held = {index for index, cell in enumerate(grid) if every and _is_held(index, cell, every)}
    if (left := len(grid) - len(held)) < LEAST:
        raise InputError(
            f"{where}: {len(grid)} lights with {len(held)} held out leave {left} to fit; {LEAST} are needed"
        )
    if every and not held:
        raise InputError(
            f"{where}: no light of {len(grid)} is left to hold out when every {every}th is; give --holdout 0"
        )
    return held


def _is_held(index: int, cell: tuple[int, int] | None, every: int) -> bool:
    if cell is None:
        return index % every == every // 2
    return cell[0] > 0 and sum(cell) % every == every // 2
