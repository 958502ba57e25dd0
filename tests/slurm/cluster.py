"""A SLURM of one machine: munge, a controller and virtual nodes, on loopback ports, with all files in one folder."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

PROGRAMS = {"munged": "munge", "slurmctld": "slurmctld", "slurmd": "slurmd", "sbatch": "slurm-client"}
"""Programs that are needed, and the package of Debian that has each."""
LONGEST_START_S = 60
"""Longest wait for daemons to answer, in seconds; they take 3 on an idle machine."""

SLURM_CONF = """
ClusterName=kinran
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
# loopback alone: no daemon listens on other addresses
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.%n.log
# no cgroups and no systemd; a job that takes more memory than it asked for is killed
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=2
JobAcctGatherParams=OverMemoryKill
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0
ReturnToService=2
# squeue still knows a job that ended when Snakemake next asks
MinJobAge=300
# there is no database
AccountingStorageType=accounting_storage/none
JobCompType=jobcomp/filetxt
JobCompLoc={folder}/jobs.txt
# nodes claim more cores and memory than the machine has
SlurmdParameters=config_overrides
SlurmctldTimeout=30
# a node that does not answer for so many seconds is down, and its jobs have failed
SlurmdTimeout=15
KillWait=5
{nodes}
PartitionName=work Nodes=ALL Default=YES MaxTime=INFINITE State=UP DefMemPerCPU=500
"""


def missing() -> list[str]:
    """Packages of Debian that this machine lacks."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    return sorted({package for program, package in PROGRAMS.items() if shutil.which(program, path=path) is None})


def free_ports(count: int) -> list[int]:
    """Ports of the loopback interface that nothing listens on."""
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def pids_of(variables: dict[str, str]) -> list[int]:
    """Processes of this machine whose environment holds these variables, the newest first."""
    words = {f"{name}={value}".encode() for name, value in variables.items()}
    found = []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and words <= set((entry / "environ").read_bytes().split(b"\0")):
                found.append((int((entry / "stat").read_text().rpartition(")")[2].split()[19]), int(entry.name)))
        except OSError:
            continue  # it has ended, or belongs to somebody else
    return [pid for _, pid in sorted(found, reverse=True)]


class Cluster:
    """Daemons of one cluster; use it in a `with`, which ends them by their ids.

    Parameters
    ----------
    folder
        Empty folder for configuration, key, socket, state and logs.
    nodes, cores, memory_mb
        Number of virtual nodes, and what each claims to have.
    """

    def __init__(self, folder: Path, nodes: int = 3, cores: int = 4, memory_mb: int = 16000) -> None:
        self.folder = folder
        self.names = [f"kin{k}" for k in range(1, nodes + 1)]
        host = socket.gethostname().split(".")[0]
        controller, *ports = free_ports(1 + nodes)
        lines = [
            f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cores} CoresPerSocket={cores}"
            f" RealMemory={memory_mb} State=UNKNOWN"
            for name, port in zip(self.names, ports, strict=True)
        ]
        text = SLURM_CONF.format(
            host=host, controller_port=controller, user="root", folder=folder, nodes="\n".join(lines)
        )
        (folder / "slurm.conf").write_text(text)
        (folder / "cgroup.conf").write_text("CgroupPlugin=cgroup/v1\nConstrainRAMSpace=no\nConstrainCores=no\n")
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}
        self.environment["PATH"] += ":/usr/sbin:/sbin"
        # the executor drops SLURM_CONF before it calls srun, which would then look into /etc
        wrapper = folder / "bin" / "srun"
        wrapper.parent.mkdir()
        srun = shutil.which("srun", path=self.environment["PATH"])
        wrapper.write_text(f'#!/bin/sh\nSLURM_CONF={folder}/slurm.conf exec {srun} "$@"\n')
        wrapper.chmod(0o755)
        self.environment["PATH"] = f"{wrapper.parent}:{self.environment['PATH']}"
        self.daemons: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Cluster":
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Cancel what runs, end the daemons, and end what jobs have left."""
        self.command("scancel", "--user", "root", check=False)
        for daemon in reversed(self.daemons.values()):
            _end(daemon)
        for pid in pids_of({"SLURM_CONF": self.environment["SLURM_CONF"], "SLURM_CLUSTER_NAME": "kinran"}):
            _kill(pid)

    def _start(self) -> None:
        for name in ("state", "spool"):
            (self.folder / name).mkdir()
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(1024))
        key.chmod(0o400)
        self.folder.chmod(0o755)
        options = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
        files = [f"--{option}={self.folder}/munge.{ending}" for option, ending in options.items()]
        # (munged refuses folders that others may write to, such as /tmp, unless it is forced)
        self._daemon("munged", "munged", "--foreground", "--force", *files)
        self._until(lambda: (self.folder / "munge.socket").exists(), "munged")
        self._daemon("slurmctld", "slurmctld", "-D", "-i")
        for name in self.names:
            (self.folder / "spool" / name).mkdir()
            self.start_node(name)
        self._until(lambda: len(self.idle_nodes()) == len(self.names), "the nodes")

    def start_node(self, name: str) -> None:
        """Start the daemon of a node, at first or again."""
        self._daemon(name, "slurmd", "-D", "-N", name)

    def crash_node(self, name: str) -> int:
        """Kill a node as a power cut does: its daemon and all that its jobs run; return how many processes."""
        daemon = self.daemons[name]
        daemon.kill()
        daemon.wait()
        pids = pids_of({"SLURM_CONF": self.environment["SLURM_CONF"], "SLURMD_NODENAME": name})
        # the daemons of jobs do not have the job's environment: they are the parents of those that do
        for pid in {*pids, *(_parent(pid) for pid in pids)} - {0, 1, os.getpid()}:
            _kill(pid)
        return 1 + len(pids)

    def idle_nodes(self) -> list[str]:
        """Names of the nodes that wait for work."""
        return self.command("sinfo", "-h", "-N", "-t", "idle", "-o", "%N", check=False).split()

    def jobs(self, state: str = "RUNNING") -> dict[str, str]:
        """Node of each job in a state, by the job's number, the oldest first."""
        rows = self.command("squeue", "-h", "-S", "i", "-t", state, "-o", "%i %N", check=False).splitlines()
        return {row.split()[0]: row.split()[-1] for row in rows}

    def log(self) -> list[str]:
        """Lines that SLURM has written of jobs that ended."""
        path = self.folder / "jobs.txt"
        return path.read_text().splitlines() if path.exists() else []

    def kill_job(self, job: str) -> int:
        """Kill -9 the youngest process of a job, which is the stage that it runs; return its id, 0 if there is none."""
        pids = pids_of({"SLURM_CONF": self.environment["SLURM_CONF"], "SLURM_JOB_ID": job})
        for pid in pids:
            try:
                words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if words[1:3] == [b"-m", b"kinran"]:
                _kill(pid)
                return pid
        return 0

    def command(self, *words: str, check: bool = True) -> str:
        """Run a command of SLURM and return what it prints."""
        done = subprocess.run(words, env=self.environment, capture_output=True, text=True, check=False)
        if check and done.returncode:
            raise RuntimeError(f"{' '.join(words)}: {done.stderr.strip()}")
        return done.stdout

    def _daemon(self, name: str, *words: str) -> None:
        with (self.folder / f"{name}.out").open("ab") as out:
            self.daemons[name] = subprocess.Popen(
                words, env=self.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
            )

    def _until(self, ready: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + LONGEST_START_S
        while not ready():
            for name, daemon in self.daemons.items():
                if daemon.poll() is not None:
                    raise RuntimeError(f"{name} ended: {(self.folder / f'{name}.out').read_text()[-500:]}")
            if time.monotonic() > end:
                raise RuntimeError(f"{what} did not start within {LONGEST_START_S} s; logs: {self.folder}")
            time.sleep(0.2)


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def _end(daemon: "subprocess.Popen[bytes]") -> None:
    daemon.terminate()
    try:
        daemon.wait(10)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait()
