"""Dry runs of Snakemake: a process imports it once, and forks for each run, so that one costs a second and not three.

`DryRuns` starts this file as a program of its own: it reads a working folder and a file for the output from a line, and
answers with the exit status.
"""

import importlib
import json
import os
import subprocess
import sys
import traceback
from pathlib import Path

WAIT_S = 60
"""Seconds in which the process ends when it is no longer asked: far more than it takes."""


class DryRuns:
    """A process that makes dry runs, with the code of a folder.

    Parameters
    ----------
    code
        Copy of the project: Snakefile, profiles, workflow, plugins and benchmarks.
    """

    def __init__(self, code: Path) -> None:
        self.code = code
        path = os.pathsep.join(str(code / part) for part in ("workflow", "plugins", "."))
        self.process = subprocess.Popen(
            [sys.executable, __file__, str(code / "Snakefile")],
            env={**os.environ, "PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, folder: Path, *options: str) -> tuple[int, str]:
        """Return exit status and output of a dry run in a working folder."""
        assert self.process.stdin
        assert self.process.stdout
        output = self.code / "output.txt"
        self.process.stdin.write(json.dumps([str(folder), str(output), *options]) + "\n")
        self.process.stdin.flush()
        status = int(self.process.stdout.readline())
        return status, output.read_text()

    def close(self) -> None:
        """End the process."""
        self.process.communicate(timeout=WAIT_S)


IMPORTS = ("numpy", "PIL.Image", "jsonschema", "msgspec", "smart_open", "snakemake.report.html_reporter")
"""What a run imports besides, and what no test edits."""


def serve(snakefile: str) -> None:
    """Make the runs that are asked for on stdin."""
    from snakemake import cli

    from kinran.base import digest

    for name in IMPORTS:
        importlib.import_module(name)
    code = [path for folder in digest.PACKAGES.values() for path in folder.rglob("*.py")]
    before = times(code)
    for path in code:  # to parse it takes as long as all else
        package, folder = next((name, of) for name, of in digest.PACKAGES.items() if of in path.parents)
        digest._read(".".join((package, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__"))
    for line in sys.stdin:
        folder, output, *options = json.loads(line)
        child = os.fork()
        if not child:
            file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(file, 1)
            os.dup2(file, 2)
            os.chdir(folder)
            if times(code) != before:
                digest._read.cache_clear()
            status = 99
            try:
                cli.main(["-s", snakefile, "-c2", "--dry-run", *options])
            except SystemExit as end:
                status = int(end.code or 0)
            except BaseException:
                traceback.print_exc()
            finally:  # the parent's loop must not go on in the child
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(status)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def times(paths: list[Path]) -> list[int]:
    """Return when files were changed."""
    return [path.stat().st_mtime_ns for path in paths]


if __name__ == "__main__":
    serve(sys.argv[1])
