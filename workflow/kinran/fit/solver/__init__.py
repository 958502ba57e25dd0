"""The compiled solver. Its code is cached under what all of its files say, and is always run from that cache."""

import fcntl
import functools
import hashlib
import logging
import subprocess
import sys
from pathlib import Path

from numba import config
from numba.core.registry import cpu_target

log = logging.getLogger(__name__)

_FOLDER = Path(__file__).parent
_CODE = b"".join(path.read_bytes() for path in sorted(_FOLDER.glob("*.py")))
# Numba looks at a function's own file alone: what it inlines from another would stay as it was
config.CACHE_DIR = str(Path(config.CACHE_DIR or _FOLDER / "__pycache__") / hashlib.sha256(_CODE).hexdigest()[:16])


@functools.cache
def prepare() -> None:
    """Compile the solver in a process of its own, once for all jobs, before it is called in this one.

    A process that compiles a function links it to what was compiled before it, one that loads it from the cache to what
    was cached with it; with reassociated sums the two differ from the fourth digit on. So that a result does not depend
    on who was first, no process runs what it compiled itself. Where the cache cannot be written, it does.
    """
    processor = repr(cpu_target.target_context.codegen().magic_tuple())  # whose code Numba keeps apart
    stamp = Path(config.CACHE_DIR) / f"compiled-{hashlib.sha256(processor.encode()).hexdigest()[:16]}"
    try:
        stamp.parent.mkdir(parents=True, exist_ok=True)
        lock = (stamp.parent / "lock").open("w")
        fcntl.flock(lock, fcntl.LOCK_EX)
    except OSError:
        return
    with lock:
        if stamp.exists():
            return
        log.info("compiling the solver, once for this version")
        done = subprocess.run([sys.executable, "-m", f"{__name__}.entries"], check=False)
        if done.returncode == 0:
            stamp.touch()
