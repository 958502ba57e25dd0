"""A virtual machine with Debian's kernel, in which a program of this machine runs as root.

QEMU computes the guest's instructions itself (TCG): that is slow, and works without KVM. The guest's clock follows the
number of its instructions, and jumps ahead where it has nothing to do. So a loaded machine makes it slow and does not
make time-outs come early; and the guest has a copy of all files that it needs, since it would not notice the time that
it waits for a file of this machine. The kernel is downloaded, never installed.
"""

import lzma
import os
import platform
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kinran.base.project import ROOT

CACHE = ROOT / ".cache" / "kinran" / "vm"
"""Kernels that were downloaded and unpacked, 75 MB each; to take a newer one, delete it."""
TOOLS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "depmod": "kmod",
    "modprobe": "kmod",
    "udevadm": "udev",
}
"""Programs that the virtual machine is made with, and Debian's packages of them."""
MODULES = ("uhid", "hid-generic", "usbhid", "vhci-hcd")
"""Kernel modules that the guest loads, with those that they depend on."""
MEMORY_MB = 768
"""Memory of the guest: four times what it was seen to use; a copied root takes 60 MB of it."""
INIT_S = 120
"""Seconds in which the kernel must reach init; 13 were measured on two cores under a load of 10."""
LIMIT_S = 1200
"""Seconds in which the guest must finish: a choice."""
SEARCH = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
"""Where tools are: not every user has the administrator's folders on the path."""

INIT = """#!/bin/busybox sh
B=/bin/busybox
$B mount -t proc p /proc; $B mount -t sysfs s /sys; $B mount -t devtmpfs d /dev
exec >/dev/ttyS1 2>&1
for m in /modules/*.ko; do $B insmod $m || echo "@needs the kernel to load $m; delete {cache}"; done
echo "@init"
$B mount --bind /dev /root/dev; $B mount -t proc p /root/proc; $B mount -t sysfs s /root/sys
$B mount -t tmpfs r /root/run; $B mkdir -p /root/run/udev/rules.d
export SYSTEMD_IGNORE_CHROOT=1 PATH=/usr/sbin:/usr/bin:/sbin:/bin
$B chroot /root /lib/systemd/systemd-udevd --daemon || echo "@needs udevd, which does not start"
{programs}
$B sync; $B poweroff -f
"""
"""First program of the guest: it loads the modules, starts udevd in the copied root, and runs the programs there."""


class SetupError(Exception):
    """The virtual machine cannot be set up; the message is a sentence with the remedy."""


@dataclass(frozen=True)
class Kernel:
    """A kernel that was unpacked: its name, its image, and its modules in the order of loading."""

    name: str
    image: Path
    modules: list[Path]


def install_tools() -> None:
    """Install what is missing of `TOOLS`, as root.

    Raises
    ------
    SetupError
        Something is missing and cannot be installed.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        raise SetupError("the virtual machine runs copies of the programs of an x86-64 Linux; run it on one")
    missing = sorted({package for tool, package in TOOLS.items() if not _has(tool)})
    if not missing:
        return
    install = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *missing]
    if os.geteuid() or not shutil.which("apt-get"):
        raise SetupError(f"{' and '.join(missing)} are needed: sudo apt-get install {' '.join(missing)}")
    print(f"note installing {' '.join(missing)}", flush=True)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    for command in (install, ["apt-get", "update", "-qq"], install):
        environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
        done = subprocess.run(command, env=environment, check=False, **quiet)  # type: ignore[call-overload]
        if command is install and done.returncode == 0:
            return
    raise SetupError(f"apt-get could not install {' '.join(missing)}; run it by hand and read what it says")


def _has(tool: str) -> bool:
    """Return whether a tool is installed; busybox must be static, because the guest has no libraries yet."""
    path = shutil.which(tool, path=SEARCH)
    return path is not None and (tool != "busybox" or b"/ld-linux" not in Path(path).read_bytes())


def _call(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a tool and return what it printed."""
    environment = os.environ | {"PATH": SEARCH}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SetupError(f"{command[0]} failed: {(done.stderr.strip() or 'without a word').splitlines()[-1]}")
    return done.stdout


def kernel() -> Kernel:
    """Return the kernel in the cache, or else Debian's current one, which is downloaded.

    Raises
    ------
    SetupError
        There is none, and apt cannot download one.
    """
    CACHE.mkdir(parents=True, exist_ok=True)
    cached = sorted(CACHE.glob("linux-image-*"))
    if not cached:
        with tempfile.TemporaryDirectory(dir=CACHE) as work:
            cached = [_fetch(Path(work))]
    image = cached[-1] / "vmlinux"
    return Kernel(cached[-1].name, image, sorted((cached[-1] / "modules").iterdir()))


def _fetch(work: Path) -> Path:
    """Download Debian's current kernel and keep its image and modules in the cache."""
    depends = _call("apt-cache", "depends", "linux-image-amd64")
    names = [line.split()[-1] for line in depends.splitlines() if "Depends: linux-image" in line]
    if not names:
        raise SetupError("apt knows no linux-image-amd64; run `apt-get update` on a Debian with a network")
    name, release = names[0], names[0].removeprefix("linux-image-")
    print(f"note downloading {name}", flush=True)
    _call("apt-get", "download", "-q", name, cwd=work)
    root = work / "root"
    _call("dpkg-deb", "-x", next(work.glob("*.deb")), root)
    _call("depmod", "-b", root, release)
    kept = work / "kept"
    (kept / "modules").mkdir(parents=True)
    files: dict[str, None] = {}
    for module in MODULES:
        wanted = _call("modprobe", "-d", root, "-S", release, "--show-depends", module)
        files |= {line.split()[1]: None for line in wanted.splitlines() if line.startswith("insmod")}
    for number, file in enumerate(files):
        content = Path(file).read_bytes()
        target = kept / "modules" / f"{number:02d}-{Path(file).name.removesuffix('.xz')}"
        target.write_bytes(lzma.decompress(content) if file.endswith(".xz") else content)
    (kept / "vmlinux").write_bytes(_uncompressed((root / "boot" / f"vmlinuz-{release}").read_bytes()))
    return kept.rename(CACHE / name)


def _uncompressed(image: bytes) -> bytes:
    """Return the kernel inside a bzImage, which spares the guest minutes of unpacking, or the bzImage itself."""
    start = image.find(b"\xfd7zXZ\0")
    content = lzma.LZMADecompressor().decompress(image[start:]) if start > 0 else b""
    return content if content.startswith(b"\x7fELF") else image


@contextmanager
def initramfs(kernel: Kernel, programs: Sequence[str], copied: Sequence[Path]) -> Iterator[Path]:
    """Make the file system in memory that the guest boots from, for as long as the block lasts.

    Parameters
    ----------
    kernel
        Kernel whose modules go in.
    programs
        Lines of shell that run in turn, in the guest's root.
    copied
        Files and folders to copy into the guest's root, with the libraries that they are linked with.
    """
    with tempfile.TemporaryDirectory(prefix="kinran-vm-") as work:
        folder = Path(work) / "root"
        for name in ("bin", "modules", "proc", "sys", "dev", "root"):
            (folder / name).mkdir(parents=True)
        shutil.copy(shutil.which("busybox", path=SEARCH) or "", folder / "bin" / "busybox")
        for module in kernel.modules:
            shutil.copy(module, folder / "modules")
        for path in copied:
            _copy(path, folder / "root")
        _furnish(folder / "root")
        runs = "\n".join(f"$B chroot /root /bin/sh -c '{line}'" for line in programs)
        text = INIT.format(programs=runs, cache=CACHE)
        (folder / "init").write_text(text)
        (folder / "init").chmod(0o755)
        packed = Path(work) / "initramfs"
        _call("sh", "-c", f"find . | cpio -o -H newc --quiet >{packed}", cwd=folder)
        yield packed


def _copy(path: Path, root: Path) -> None:
    """Copy a file or folder to the same place under another root, and what the libraries of its programs are."""
    target = root / path.relative_to("/")
    target.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        ignored = shutil.ignore_patterns("test", "tests", "site-packages", "dist-packages", "config-*")
        shutil.copytree(path, target, ignore=ignored, dirs_exist_ok=True)
    elif not target.exists():
        shutil.copy(path.resolve(), target)
    for file in [target] if target.is_file() else target.rglob("*.so*"):
        if file.read_bytes()[:4] != b"\x7fELF":
            continue
        linked = subprocess.run(["ldd", file], capture_output=True, text=True, check=False).stdout.split()
        for word in linked:
            if word.startswith("/") and not Path(word).is_relative_to(root) and not (root / word[1:]).exists():
                _copy(Path(word), root)


def _furnish(root: Path) -> None:
    """Make what a root has beside its programs: mount points, users, and a shell."""
    for name in ("proc", "sys", "dev", "run", "tmp", "etc", "bin"):
        (root / name).mkdir(exist_ok=True)
    for name in ("passwd", "group"):
        shutil.copy(f"/etc/{name}", root / "etc" / name)
    shutil.copy(shutil.which("busybox", path=SEARCH) or "", root / "bin" / "sh")


def boot(kernel: Kernel, packed: Path) -> Iterator[str]:
    """Boot the guest and yield the lines that its programs print.

    Raises
    ------
    SetupError
        The kernel did not reach init.
    """
    with tempfile.TemporaryDirectory(prefix="kinran-vm-") as work:
        console = Path(work) / "console"
        command = [
            "qemu-system-x86_64", "-M", "pc", "-accel", "tcg", "-icount", "shift=1,sleep=off", "-rtc", "clock=vm",
            "-cpu", "max", "-smp", "1", "-m", str(MEMORY_MB),
            "-nodefaults", "-no-user-config", "-no-reboot", "-display", "none",
            "-kernel", str(kernel.image), "-initrd", str(packed),
            "-append", "console=ttyS0 quiet panic=-1 reboot=t mitigations=off random.trust_cpu=on nokaslr",
            "-serial", f"file:{console}", "-serial", "file:/dev/stdout",
        ]  # fmt: skip
        began = time.monotonic()
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe) as qemu:
            timer = threading.Timer(INIT_S, qemu.kill)
            timer.start()
            reached = False
            try:
                assert qemu.stdout is not None
                assert qemu.stderr is not None
                for raw in qemu.stdout:
                    line = raw.decode(errors="replace").rstrip("\r\n")
                    if line == "@init":
                        reached = True
                        timer.cancel()
                        timer = threading.Timer(LIMIT_S, qemu.kill)
                        timer.start()
                        yield f"note the kernel reached init after {time.monotonic() - began:.0f} s"
                    else:
                        yield line
                said = qemu.stderr.read().decode()
            finally:
                timer.cancel()
                qemu.kill()
        if not reached:
            said += console.read_text(errors="replace") if console.exists() else ""
            last = (said.strip() or "it said nothing").splitlines()[-1]
            raise SetupError(f"{kernel.name} does not reach init within {INIT_S} s in QEMU: {last}")
