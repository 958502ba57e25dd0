"""Messages are plain lines on stderr; progress is a line now and then, and always one after the last item."""

import logging
import os
import subprocess
import sys
import time

import pytest

from kinran.base.log import progress, to_stderr


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Time in seconds, which the test sets."""
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_a_line_a_second_and_one_at_the_end(clock: list[float], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "kinran")
    for item in progress(range(10), "merge", "shards"):
        assert len(caplog.messages) <= item / 2
        clock[0] += 0.4
    assert caplog.messages == [f"merge: {k} of 10 shards" for k in (3, 6, 9, 10)]


def test_short_loop_logs_its_end_alone(clock: list[float], caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "kinran")
    assert list(progress(iter("abc"), "read", "photographs", total=3)) == ["a", "b", "c"]
    assert caplog.messages == ["read: 3 of 3 photographs"]


def test_number_of_items_has_to_be_known() -> None:
    with pytest.raises(TypeError, match="photographs"):
        next(progress(iter("abc"), "read", "photographs"))


def test_messages_are_plain_lines_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    loggers = [logging.getLogger("kinran"), logging.getLogger("kinran_bsdf")]
    before = [(logger.level, list(logger.handlers)) for logger in loggers]
    try:
        to_stderr()
        to_stderr()
        logging.getLogger("kinran.merge").info("group %s", "00")
        logging.getLogger("kinran_bsdf.native").info("compiled")
        logging.getLogger("elsewhere").info("not ours")
        assert capsys.readouterr() == ("", "group 00\ncompiled\n")
    finally:
        for logger, (level, handlers) in zip(loggers, before, strict=True):
            logger.setLevel(level)
            logger.handlers[:] = handlers


def test_nobody_reads_any_more() -> None:
    code = "import logging; from kinran.base.log import to_stderr; to_stderr(); log = logging.getLogger('kinran')\n"
    code += "for k in range(3): log.info('line %d', k)\nprint('done')"
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=write, check=False)
    os.close(write)
    assert done.stdout == b"done\n"
