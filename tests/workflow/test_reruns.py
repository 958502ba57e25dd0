"""What reruns when: a change, and the jobs that a run would do then, all of them and no other."""

import os
import re
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Project
from dry_runs import DryRuns

from kinran.data.labels import read_labels
from kinran.data.needed_regions import read_need
from kinran_bsdf import read_material

Change = Callable[["Ground"], object]

SHOWN = "overview all"
FROM_MATERIAL = f"scene render report {SHOWN}"
FITS = f"fit*2 material*2 sigma choose evaluate {FROM_MATERIAL}"
FROM_STACK = f"segment need prior {FITS}"
FROM_MERGE = f"stack {FROM_STACK}"
FROM_CAPTURE = f"calibrate merge*2 {FROM_MERGE}"
ALL = f"plan capture*3 {FROM_CAPTURE}"
SLOPE = f"fit material sigma choose evaluate {FROM_MATERIAL}"
OTHER = " ".join(f"other:{job}" for job in ALL.removesuffix(f" {SHOWN}").split())


class Ground:
    """A finished run and a copy of the code: a row of the table changes either, and then all is put back."""

    def __init__(self, folder: Path, finished: Path, code: Path, runs: DryRuns) -> None:
        self.project = Project.of(folder / "project")
        self.code, self.runs = code, runs
        self.kept = {self.project.folder: folder / "kept", code: code.with_name("kept code")}
        shutil.copytree(finished, self.project.folder, symlinks=True)
        for at, kept in self.kept.items():
            if not kept.exists():
                shutil.copytree(at, kept, symlinks=True)

    def path(self, name: str) -> Path:
        """File of the run."""
        return self.project.folder / name

    def planned(self) -> Counter[str]:
        """Jobs of a run by their rule, with the name of the fabric before it where it is not `tiny`."""
        status, text = self.runs.run(self.project.folder)
        assert status == 0, text[-3000:]
        jobs: Counter[str] = Counter()
        for part in re.split(r"^(?:local)?rule ", text, flags=re.MULTILINE)[1:]:
            fabric = re.search(r"^ +wildcards: .*\bfabric=(\w+)", part, re.MULTILINE)
            jobs[("" if not fabric or fabric[1] == "tiny" else f"{fabric[1]}:") + part.split(":")[0]] += 1
        assert jobs or "Nothing to be done" in text
        return jobs

    def put_back(self) -> None:
        """Put back all that was changed, removed or added, with its time."""
        for at, kept in self.kept.items():
            now, then = (stats(folder) for folder in (at, kept))
            for name in now.keys() - then.keys():
                (at / name).unlink()
            for name in (name for name in then if now.get(name) != then[name]):
                (at / name).parent.mkdir(exist_ok=True)
                shutil.copy2(kept / name, at / name)


def stats(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of each file in a folder but logs, bytecode and what dry runs note."""
    of = {str(path.relative_to(folder)): path.stat() for path in folder.rglob("*") if path.is_file()}
    left = re.compile(r"\.snakemake/(log|kinran|iocache)/|__pycache__|output\.txt")
    return {name: (status.st_size, status.st_mtime_ns) for name, status in of.items() if not left.search(name)}


@pytest.fixture(scope="module")
def code(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("checkout") / "code"
    folder.mkdir()
    for name in ("workflow", "plugins", "benchmarks", "profiles"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy2(ROOT / "Snakefile", folder)
    return folder


@pytest.fixture(scope="module")
def runs(code: Path) -> Iterator[DryRuns]:
    runs = DryRuns(code)
    yield runs
    runs.close()


@pytest.fixture(scope="module")
def finished_ground(finished: Project, tmp_path_factory: pytest.TempPathFactory, code: Path, runs: DryRuns) -> Ground:
    return Ground(tmp_path_factory.mktemp("ground"), finished.folder, code, runs)


@pytest.fixture(scope="module")
def needed_ground(finished: Project, tmp_path_factory: pytest.TempPathFactory, code: Path, runs: DryRuns) -> Ground:
    """A run whose fit depends on what its scene needs: coarse texels, and lobes where they are shown."""
    project = Project.of(tmp_path_factory.mktemp("needed") / "project")
    shutil.copytree(finished.folder, project.folder, symlinks=True)
    fit = {"texels": "needed", "regions": "needed", "compare": ["lambert"], "jobs": 2}
    project.configure(lambda config: config["fit"].update(fit))
    replace(project.folder / "small.xml", 'name="fov" value="12"', 'name="fov" value="20"')
    project.run()
    return Ground(tmp_path_factory.mktemp("ground"), project.folder, code, runs)


@pytest.fixture
def ground(finished_ground: Ground) -> Iterator[Ground]:
    yield finished_ground
    finished_ground.put_back()


@pytest.fixture
def needed(needed_ground: Ground) -> Iterator[Ground]:
    yield needed_ground
    needed_ground.put_back()


def config(**sections: object) -> Change:
    """Change the config: values of a section, or a value that is none."""

    def change(content: dict) -> None:
        for name, value in sections.items():
            if isinstance(value, dict):
                content[name].update(value)
            else:
                content[name] = value

    def write(ground: Ground) -> None:
        path = ground.path("config.yaml")
        content = yaml.safe_load(path.read_text())
        change(content)
        path.write_text(yaml.safe_dump(content))

    return write


def text(name: str, old: str, new: str) -> Change:
    """Replace text in a file of the run."""
    return lambda ground: replace(ground.path(name), old, new)


def module(name: str, old: str = "", new: str = "\nANOTHER = 1\n") -> Change:
    """Replace text in a module, or add a constant at its end."""
    return lambda ground: replace(ground.code / "workflow" / "kinran" / name, old, new)


def replace(path: Path, old: str, new: str) -> None:
    before = path.read_text()
    assert old in before
    path.write_text(before.replace(old, new, 1) if old else before + new)


def gone(name: str) -> Change:
    """Remove a result."""
    return lambda ground: ground.path(f"results/tiny/{name}").unlink()


def touched(*names: str) -> Change:
    """Touch files of the run, or all in its folders, those last that were made first: all inputs are newer then."""

    def change(ground: Ground) -> None:
        found = [file for path in map(ground.path, names) for file in (path, *path.rglob("*")) if file.is_file()]
        for second, file in enumerate(sorted(found, key=lambda file: -file.stat().st_mtime_ns)):
            os.utime(file, (time.time() + second, time.time() + second))

    return change


def code_touched(ground: Ground) -> None:
    """As by a fresh checkout."""
    for file in ground.code.rglob("*"):
        os.utime(file)


def keys_reordered(ground: Ground) -> None:
    path = ground.path("config.yaml")
    content = yaml.safe_load(path.read_text())
    turned = {
        name: dict(reversed(list(value.items()))) if isinstance(value, dict) else value
        for name, value in reversed(list(content.items()))
    }
    path.write_text("# a note\n" + yaml.safe_dump(turned, sort_keys=False))


def both(*changes: Change) -> Change:
    return lambda ground: [change(ground) for change in changes]


def sheet(name: str, row: str) -> Change:
    """Add a row to a sheet."""

    def change(ground: Ground) -> None:
        path = ground.path(f"config/{name}.tsv")
        path.write_text(path.read_text() + row + "\n")

    return change


def own(fabric: str, **settings: object) -> Change:
    """Give a fabric settings of its own."""

    def change(ground: Ground) -> None:
        path = ground.path(f"config/fabrics/{fabric}.yaml")
        path.parent.mkdir(exist_ok=True)
        path.write_text(yaml.safe_dump(settings))

    return change


def jobs(said: str) -> Counter[str]:
    """Jobs from words such as ``merge*2``."""
    found: Counter[str] = Counter()
    for word in said.split():
        name, _, count = word.partition("*")
        found[name] += int(count or 1)
    return found


TABLE: dict[str, tuple[Change, str]] = {
    "nothing": (lambda ground: None, ""),
    # time stamps, layout and comments
    "everything touched": (touched("results", "captures", "config", "config.yaml", "small.xml"), ""),
    "code touched": (code_touched, ""),
    "keys of the config in another order, and a comment": (keys_reordered, ""),
    "a comment in a module": (module("fit/fit.py", new="\n# a comment\n"), ""),
    "a docstring": (module("fit/fit.py", '"""Fit a model', '"""Fit one model'), ""),
    "help of an option": (module("fit/fit.py", "model of the material", "the model"), ""),
    "a comment in the scene": (text("small.xml", "</scene>", "<!-- a comment -->\n\n</scene>"), ""),
    # settings
    "holdout": (config(holdout=4), FROM_MERGE),
    "rig.lamp": (config(rig={"lamp": "xenon"}), FROM_CAPTURE),
    "rig.exposures": (config(rig={"exposures": [25, 100, 250, 1000, 4000, 8000]}), ALL),
    "rig.exposures without a rig": (config(rig={"device": "none", "exposures": [25]}), ""),
    "virtual.seed": (config(virtual={"seed": 8}), f"capture*3 {FROM_CAPTURE}"),
    "fit.lobes": (config(fit={"lobes": "choose"}), f"choice prior {SLOPE}"),
    "fit.jobs": (config(fit={"jobs": 3}), ""),
    "fit.jobs of a fit that is gone": (
        both(config(fit={"jobs": 3}), gone("fit/slope.exr")),
        f"fit*3 material sigma choose evaluate {FROM_MATERIAL}",
    ),
    "fit.jobs of a fit with other lobes": (
        config(fit={"jobs": 3, "lobes": "choose"}),
        f"choice prior fit*3 material sigma choose evaluate {FROM_MATERIAL}",
    ),
    "fit.compare has one less": (config(fit={"compare": []}), f"evaluate report {SHOWN}"),
    "fit.compare has one more": (
        config(fit={"compare": ["takeda2008", "lambert"]}),
        f"fit material evaluate report {SHOWN}",
    ),
    "fit.model is one of those compared": (
        config(fit={"model": "takeda2008", "compare": ["slope"]}),
        f"choose evaluate {FROM_MATERIAL}",
    ),
    "fit.residual: all": (config(fit={"residual": "all"}), f"residual choose evaluate {FROM_MATERIAL}"),
    "fit.residual: none": (config(fit={"residual": "none"}), ""),
    "fit.regions: shiniest": (config(fit={"regions": "shiniest"}), FITS),
    "fit.regions: needed": (config(fit={"regions": "needed"}), f"need_to_fit {FITS}"),
    "fit.texels: needed": (config(fit={"texels": "needed"}), f"need_to_fit coarsen prior {FITS}"),
    # the scene
    "samples a pixel": (text("small.xml", 'name="spp" value="2"', 'name="spp" value="3"'), f"render report {SHOWN}"),
    "a camera farther off": (text("small.xml", "290", "291.5"), f"need {FROM_MATERIAL}"),
    "another light": (text("small.xml", 'name="key" value="23"', 'name="key" value="20"'), f"need {FROM_MATERIAL}"),
    # code
    "code of the fit": (module("fit/fit.py"), FITS),
    "code of the merge": (module("radiance/merge_group.py"), f"merge*2 {FROM_MERGE}"),
    "code of the capture": (both(*(module(f"capture/{name}.py") for name in ("capture", "session", "journal"))), ""),
    "code of the virtual camera": (module("virtual/weave.py"), f"capture*3 {FROM_CAPTURE}"),
    "code that moves files or talks": (
        both(*(module(f"base/{name}.py") for name in ("checksums", "command_line", "digest", "files", "log"))),
        "",
    ),
    "code of the plan": (module("capture/order.py"), ALL),
    "what draws and prints a plan": (
        both(*(module(f"{name}.py") for name in ("capture/plan_drawing", "capture/plan_table", "base/drawing/canvas"))),
        f"report {SHOWN}",  # which is drawn, too
    ),
    "code of the plugin's BSDF": (
        lambda ground: replace(ground.code / "plugins" / "kinran_bsdf" / "bsdf.py", "", "\nANOTHER = 1\n"),
        f"render report {SHOWN}",
    ),
    "code of the report": (module("report/contents.py"), f"report {SHOWN}"),
    # fabrics
    "a direction that is shot again": (
        sheet("recapture", "tiny\t40\t45\t1\tthe thread had moved"),
        f"capture merge {FROM_MERGE}",
    ),
    "one more fabric": (sheet("fabrics", "other\trig\t\t\t2\t"), f"{OTHER} other:own_mesh {SHOWN}"),
    "settings of one fabric": (
        both(
            sheet("fabrics", "other\trig\t\t\t2\t"),
            own("tiny", rig={"exposures": [25, 100, 250, 1000, 4000]}),
            config(rig={"exposures": [25]}),
        ),
        f"{OTHER} other:own_mesh {SHOWN}",
    ),
    "a scan": (
        both(
            lambda ground: shutil.copy(ground.path("results/tiny/scan.ply"), ground.path("cloth.ply")),
            config(scene={"scan": "cloth.ply"}),
        ),
        f"scan mesh own_mesh need {FROM_MATERIAL}",
    ),
    # what is gone
    "render.png is gone": (gone("render.png"), f"render report {SHOWN}"),
    "material.exr is gone": (gone("material.exr"), f"choose {FROM_MATERIAL}"),
    "slope.exr is gone": (gone("fit/slope.exr"), SLOPE),
    "labels.exr is gone": (gone("labels.exr"), FROM_STACK),
    "need.json is gone": (gone("need.json"), f"need report {SHOWN}"),
    "mesh.ply is gone": (gone("scene/mesh.ply"), f"own_mesh need {FROM_MATERIAL}"),
    "a shard is gone": (gone("radiance.zarr/radiance/c/0/0/0/0"), f"merge {FROM_MERGE}"),
    "flags of the monitor's shard are gone": (gone("radiance.zarr/flags/c/4/0/0/0"), FROM_MERGE),
    "metadata of the stack are gone": (gone("radiance.zarr/flags/zarr.json"), FROM_MERGE),
}
"""Each change of a finished run, and the jobs that follow, by their rule."""


FROM_NEED = f"need_to_fit coarsen prior fit*4 material*2 sigma choose evaluate {FROM_MATERIAL}"
NEEDED: dict[str, tuple[Change, str]] = {
    "nothing": (lambda ground: None, ""),
    "everything touched": (touched("results", "captures", "config", "config.yaml", "small.xml"), ""),
    "a camera 0.5 % farther off": (text("small.xml", "290", "291.5"), f"need {FROM_MATERIAL}"),
    "a camera that sees finer texels": (
        text("small.xml", 'name="fov" value="20"', 'name="fov" value="12"'),
        f"need {FROM_NEED}",
    ),
    "a camera 0.5 % farther off, and another compared": (
        both(text("small.xml", "290", "291.5"), config(fit={"compare": []})),
        f"need evaluate {FROM_MATERIAL}",
    ),
    "samples a pixel": (text("small.xml", 'name="spp" value="2"', 'name="spp" value="3"'), f"render report {SHOWN}"),
    "code of the need, which finds the same": (module("scene/need.py"), f"need report {SHOWN}"),
    "code of the mesh": (
        module("scene/mesh.py"),
        f"mesh own_mesh need {FROM_NEED}",
    ),
    "fit.jobs": (config(fit={"jobs": 3}), ""),
    "fit.regions: all, which is nothing to a model without lobes": (
        config(fit={"regions": "all"}),
        f"fit*2 material sigma choose evaluate {FROM_MATERIAL}",
    ),
    "fit.texels: all": (
        config(fit={"texels": "all"}),
        f"prior fit*4 material*2 sigma choose evaluate {FROM_MATERIAL}",
    ),
}
"""The same where the fit depends on the scene."""


@pytest.mark.parametrize("name", TABLE)
def test_what_reruns(ground: Ground, name: str) -> None:
    change, said = TABLE[name]
    change(ground)
    assert ground.planned() == jobs(said)


def test_a_far_camera_gets_coarse_maps(needed_ground: Ground) -> None:
    """Model no more than a scene needs: texels that its camera cannot tell apart are fitted as one."""
    results = needed_ground.path("results/tiny")
    factor = read_need(results / "fit" / "need.json").footprint.coarsest_factor
    assert factor > 1
    fine = read_labels(results / "labels.exr")
    assert read_material(results / "material.exr").size == tuple(side // factor for side in fine.shape)


@pytest.mark.parametrize("name", NEEDED)
def test_what_reruns_where_the_fit_depends_on_the_scene(needed: Ground, name: str) -> None:
    change, said = NEEDED[name]
    change(needed)
    assert needed.planned() == jobs(said)
