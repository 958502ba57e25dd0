"""Log messages: plain lines on stderr, and the progress of a long loop.

A module logs to ``logging.getLogger(__name__)``; a program that calls a stage decides where its messages go.
"""

import logging
import sys
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from typing import TypeVar

T = TypeVar("T")

EVERY_S = 1.0
"""Seconds between two lines of progress: often enough for a person who waits, seldom enough for a log file."""

log = logging.getLogger(__name__)


class _Stderr(logging.Handler):
    """Writes each message as a line to the ``sys.stderr`` of that moment, which a caller may have redirected.

    Nobody may read any more: Ctrl-C ends the `tee` of a log first. That must not stop a rig from being closed in order.
    """

    def emit(self, record: logging.LogRecord) -> None:
        with suppress(BrokenPipeError):
            print(self.format(record), file=sys.stderr, flush=True)


def to_stderr() -> None:
    """Show the messages of Kinran and its plugin, from INFO, on stderr; those of other libraries stay as they are."""
    for name in ("kinran", "kinran_bsdf"):
        logger = logging.getLogger(name)
        logger.setLevel(logging.INFO)
        if not any(isinstance(handler, _Stderr) for handler in logger.handlers):
            logger.addHandler(_Stderr())


def progress(items: Iterable[T], what: str, unit: str, total: int | None = None) -> Iterator[T]:
    """Yield the items, and log ``what: k of n unit`` at most once a second and after the last.

    Parameters
    ----------
    items
        Items of the loop.
    what, unit
        Name of the work, and of the items in the plural, for the message.
    total
        Number of items, where `items` has no length.

    Raises
    ------
    TypeError
        `items` has no length and `total` is missing.
    """
    if total is None:
        if not isinstance(items, Collection):
            raise TypeError(f"{what}: give the number of {unit}, which {type(items).__name__} does not know")
        total = len(items)
    last = time.monotonic()
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        if done == total or now - last >= EVERY_S:
            log.info("%s: %d of %d %s", what, done, total, unit)
            last = now
