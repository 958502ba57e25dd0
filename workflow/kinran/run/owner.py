"""A run owns its working folder: one run at a time, and what a dead run left is cleared away by the next one.

Snakemake's own lock is a list of files. It outlives a run that was killed, and a run that ends removes the lists of all
others. So the process that runs jobs locks a file of its own, which the kernel unlocks when the process ends, however
that comes about. The file also says who the owner is, and what it read: jobs on other machines read config and sheets
again, and refuse to run on others than those with which the run began.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import logging
import os
import re
import shlex
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import wraps
from pathlib import Path
from typing import Any

import msgspec

from kinran.base.end_with_run import JOBS
from kinran.base.files import InputError
from kinran.run.fabrics import Fabrics
from kinran.run.scheduling import without_rate_limit

FILE = JOBS.with_name("kinran.run")
"""File that the owner locks, and in which it is described."""
LOCKS = JOBS.with_name("locks")
"""Folder of Snakemake's own lock."""
WAIT_S = 90.0
"""Longest wait in seconds for the jobs of a dead run, which end by themselves: more than
`kinran.base.end_with_run.GRACE_S`."""
LOOK_S = 0.2
"""Seconds between two looks at them."""
NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)
"""Errors of file systems without locks."""
PART = re.compile(r"\.part-\w+|\..+\.\d+\.part(\.\w+)?")
"""Names of temporary files and folders of stages (`kinran.base.files.atomic`, `kinran.data.radiance_stack`)."""

log = logging.getLogger("kinran")


@dataclass(frozen=True)
class Owner:
    """The run that owns a folder.

    Attributes
    ----------
    process, began, host, boot
        Its process, the clock tick at which that began, its machine, and the id of the machine's start.
    since
        When the run began.
    command
        Its command line.
    settings
        Digest of what it read of each fabric (`digests`).
    ended
        Whether it came to its end, with all jobs done.
    """

    process: int
    began: str
    host: str
    boot: str
    since: str
    command: str
    settings: dict[str, str] = field(default_factory=dict)
    ended: bool = False

    @property
    def words(self) -> str:
        """The owner in words."""
        return f"process {self.process} on {self.host}, since {self.since}"

    @property
    def here(self) -> bool:
        """Whether it runs, or ran, on this machine since its last start."""
        return (self.host, self.boot) == (socket.gethostname(), _boot())


def guard(workflow: Any, listed: Fabrics, place: Path, error: type[Exception]) -> None:
    """Let a workflow that runs jobs own its folder, and let its jobs elsewhere refuse settings that have changed since.

    Dry runs, and what runs no jobs, own nothing and are not refused.

    Parameters
    ----------
    workflow
        Snakemake's workflow, before it is executed.
    listed
        The fabrics that were read.
    place
        Folder of their results.
    error
        What to raise where it is refused, with the sentence that says why.
    """
    logging.raiseExceptions = False  # a log file on a full disk: the sentence is enough, without a traceback
    execute = workflow.execute
    if hasattr(execute, "__wrapped__"):  # the rules were included twice, as modules
        return

    @wraps(execute)
    def owning(*args: Any, **options: Any) -> Any:
        without_rate_limit(workflow)
        try:
            if not workflow.is_main_process:
                jobs = workflow.dag_settings.target_jobs
                check_settings(listed, {job.wildcards_dict.get("fabric", "") for job in jobs})
            elif not options["executor_plugin"].common_settings.dryrun_exec and workflow.execution_settings.lock:
                with owned(digests(listed), place):
                    return execute(*args, **options)
        except InputError as refusal:
            raise error(str(refusal)) from None
        return execute(*args, **options)

    workflow.execute = owning


@contextmanager
def owned(settings: dict[str, str], place: Path = Path()) -> Iterator[None]:
    """Own the working folder in the block, after clearing away what a dead run left.

    Parameters
    ----------
    settings
        Digest of what was read of each fabric.
    place
        Folder of the results.

    Raises
    ------
    InputError
        Another run owns it, jobs of a dead one are still at work, or the folder cannot be written to.
    """
    try:
        FILE.parent.mkdir(exist_ok=True)
        JOBS.touch()
        file = os.open(FILE, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(
            f"{FILE.parent.resolve()}: cannot be written to ({error.strerror}), and a run keeps its books there;"
            " make it writable, or free some space, and run again"
        ) from None
    try:
        before = read(FILE)
        _lock(file, before)
        if before and not before.ended:
            _await_jobs(before)
            _clear_away(before, place)
        me = Owner(
            os.getpid(), _began(os.getpid()), socket.gethostname(), _boot(),
            f"{datetime.now(UTC).astimezone():%Y-%m-%d %H:%M}", shlex.join(sys.argv), settings,
        )  # fmt: skip
        _write(file, me)
        yield
        _write(file, replace(me, ended=True))
    finally:
        os.close(file)


def read(path: Path) -> Owner | None:
    """Return the owner that a file describes; None where it is missing, or says nothing."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=Owner)
    except (OSError, msgspec.DecodeError):
        return None


def digests(listed: Fabrics) -> dict[str, str]:
    """Return a digest of what was read of each fabric: its row, its settings, and the shots to be taken again."""
    found = {}
    for name, fabric in listed.sound.items():
        again = {group: shots for (of, group), shots in listed.again.items() if of == name}
        text = json.dumps([asdict(fabric), again], sort_keys=True, default=str)
        found[name] = hashlib.sha256(text.encode()).hexdigest()[:16]
    return found


def check_settings(listed: Fabrics, fabrics: set[str]) -> None:
    """Refuse a job, outside the process that owns the folder, for whose fabrics other settings are read now.

    Raises
    ------
    InputError
        Config, sheets or settings of a fabric have changed since the run began, or its row is wrong here.
    """
    owner, now = read(FILE), digests(listed)
    began = owner.settings if owner and not owner.ended else {}
    for name in sorted(fabrics & began.keys()):
        if name in listed.broken:
            raise InputError(listed.broken[name])
        if now.get(name) != began[name]:
            raise InputError(
                f"fabric '{name}': its settings have changed since the run began, so this job is not run;"
                " start the run again when it has ended"
            )


def _lock(file: int, before: Owner | None) -> None:
    """Lock the file of the owner, who is `before` if it is taken; without locks, ask whether that one still lives."""
    taken = False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        taken = True
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise InputError(f"{FILE.resolve()}: cannot be locked ({error.strerror}); check the file system") from None
        if before and not before.ended and before.host != socket.gethostname():
            raise InputError(
                f"{Path.cwd()}: another run may work in this folder ({before.words}), whose file system has no locks;"
                f" if it does not, delete {FILE} and run again"
            ) from None
        taken = bool(before and not before.ended and before.here and before.began == _began(before.process))
    if taken:
        who = f" ({before.words})" if before else ""
        raise InputError(f"{Path.cwd()}: another run works in this folder{who}; wait for its end, or stop it")


def _await_jobs(before: Owner) -> None:
    """Wait for jobs that a dead run left behind: they end by themselves, on its machine."""
    with JOBS.open() as jobs:
        for look in range(round(WAIT_S / LOOK_S)):
            try:
                fcntl.flock(jobs, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if look == 0:
                    log.warning("jobs of a run that was killed (%s) are still ending; waiting for them", before.words)
                time.sleep(LOOK_S)
            except OSError:
                return
            else:
                return
    raise InputError(
        f"{Path.cwd()}: jobs of a run that was killed ({before.words}) still work in this folder;"
        " cancel them on the cluster, or end them, and run again"
    )


def _clear_away(before: Owner, place: Path) -> None:
    """Remove the lock and the temporary files of a run that was killed, or failed."""
    if LOCKS.is_dir():
        log.warning("the run before this one was killed (%s); its lock is removed", before.words)
        shutil.rmtree(LOCKS, ignore_errors=True)
    results = place / "results"
    for fabric in sorted(results.iterdir()) if results.is_dir() else []:
        for folder, folders, files in os.walk(fabric):  # the fabric itself may be a link to elsewhere
            for name in [name for name in folders if PART.fullmatch(name)]:
                shutil.rmtree(Path(folder, name), ignore_errors=True)
                folders.remove(name)
            for name in files:
                if PART.fullmatch(name):
                    with contextlib.suppress(OSError):
                        Path(folder, name).unlink()


def _write(file: int, owner: Owner) -> None:
    try:
        os.ftruncate(file, 0)
        os.pwrite(file, json.dumps(asdict(owner), indent=1).encode() + b"\n", 0)
        os.fsync(file)
    except OSError as error:
        raise InputError(
            f"{FILE.resolve()}: cannot be written ({error.strerror}); free some space, and run again"
        ) from None


def _boot() -> str:
    """Return the id of the machine's start; nothing where the system has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _began(process: int) -> str:
    """Return the clock tick at which a process of this machine began; nothing where there is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
