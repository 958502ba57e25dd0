import json
import sys
from functools import cache
from pathlib import Path

from kinran.base.digest import PACKAGES, digest
from kinran.run.config import (
    directions_options,
    lobes_of,
    motion_options,
    read_fabrics,
    read_revisions,
    sheet_of,
)
from kinran.run import resources, void
from kinran.base.files import InputError
from snakemake.exceptions import WorkflowError

# jobs use the interpreter that runs Snakemake, with or without an activated environment; in a container they use its
# own, with the code of this project (a prefix of one's own replaces Snakemake's, so the strict mode is part of it)
code = ":".join(str(path.parent) for path in PACKAGES.values())
shell.prefix(
    f'if [ -n "$APPTAINER_CONTAINER" ]; then export PYTHONPATH={code};'
    f" else export PATH={Path(sys.executable).parent}:$PATH; fi; set -euo pipefail; "
)

try:
    fabrics = read_fabrics(config)
    revisions_of = read_revisions(config, fabrics)
except InputError as error:
    raise WorkflowError(str(error))

rig_fabrics = [name for name, fabric in fabrics.items() if fabric.folder is None]
set_fabrics = [name for name, fabric in fabrics.items() if fabric.folder is not None]
models = list(dict.fromkeys([config["fit"]["model"], *config["fit"]["compare"]]))
jobs = range(config["fit"]["jobs"])
# the texels that are fitted and judged: as they were measured, or as coarse as the scene allows
fitted = (
    "results/{fabric}/needed"
    if config["fit"]["texels"] == "needed"
    else "results/{fabric}"
)
# a job of the chart for each kind of method: a new file is a new job, and no other runs again
kinds = sorted(p.stem for p in PACKAGES["kinran"].glob("compare/methods/[a-z]*.py"))
# shards of a group are no outputs that Snakemake knows. Where one is gone, what says that it is there goes, too
if workflow.is_main_process:
    for fabric in fabrics:
        void.remove_void(Path("results", fabric))


wildcard_constraints:
    fabric="[a-z0-9][a-z0-9_-]*",
    group="[0-9]+|calibration|views",
    model="|".join(models),
    job="[0-9]+",


def any_of(names):
    """Return a pattern of these names; one that matches nothing where there are none."""
    return "|".join(names) or "(?!)"


@cache
def size_of(fabric):
    """Return the size of a fabric, on which depends what its jobs ask for."""
    return resources.size_of(fabrics[fabric], config)


def threads_of(stage):
    """Return the threads of a stage's jobs, as a function of their wildcards."""
    return lambda wildcards: resources.threads(stage, size_of(wildcards.fabric))


def memory_of(stage):
    """Return the megabytes of a stage's jobs, as a function of their wildcards and the attempt."""
    return lambda wildcards, attempt: resources.memory_mb(
        stage, size_of(wildcards.fabric), attempt
    )


def runtime_of(stage, jobs=1):
    """Return the minutes of a stage's jobs, of which so many share its work, in the same way."""
    return lambda wildcards, attempt, threads: resources.minutes(
        stage, size_of(wildcards.fabric), attempt, threads * jobs
    )


def manifests(wildcards):
    """Return the manifests of all groups of a fabric."""
    groups = fabrics[wildcards.fabric].all_groups
    return [f"captures/{wildcards.fabric}/groups/{group}.json" for group in groups]


def calibration_manifest(wildcards):
    """Return the manifest for the calibration: dark, white and chart of the rig, the first photographs of a set."""
    group = "calibration" if wildcards.fabric in rig_fabrics else "00"
    return f"captures/{wildcards.fabric}/groups/{group}.json"


def receipts(wildcards):
    """Return the receipts of all merged groups of a fabric."""
    groups = fabrics[wildcards.fabric].light_groups
    return [f"results/{wildcards.fabric}/merged/{group}.json" for group in groups]


def revisions(wildcards):
    """Return the revisions of a group's shots that are to be taken again, as JSON."""
    return revisions_of(wildcards.fabric, wildcards.group)


def virtual_rig(wildcards):
    """Return the settings of the virtual fabric as JSON; the same settings give the same text."""
    lengths = {
        name: config["rig"][name]
        for name in ("field_mm", "lamp_mm", "camera_mm")
        if name in config["rig"]
    }
    settings = {**config["virtual"], **lengths}
    return json.dumps(settings, sort_keys=True)


def rig_devices():
    """Return the settings of rig and camera as JSON; the virtual ones take none."""
    known = "camera iso aperture usb serial speeds accelerations homing_s lux dose_limit_lux_h"
    given = {
        name: config["rig"][name] for name in known.split() if name in config["rig"]
    }
    return json.dumps(given if config["rig"]["device"] == "hid" else {}, sort_keys=True)


def promised(fabric):
    """Return the files of a fabric that users look for, and that stages read: one that is gone is made again."""
    fits = methods_of(fabric)
    sigma = ["fit/slope.sigma.exr"] if models[0] == "slope" else []
    names = [
        *(f"radiance.zarr/{part}zarr.json" for part in ("", "radiance/", "flags/")),
        *("labels.exr", "regions.json", "statistics.exr"),
        *(f"fit/{method}.{kind}" for method in fits for kind in ("exr", "json")),
        *sigma,
        *("material.exr", "evaluation.json", "evaluation.png", "need.json"),
        *("scene/mesh.ply", "scene/scene.xml", "render.exr", "render.png", "sweep.png"),
        "report.html",
    ]
    return [f"results/{fabric}/{name}" for name in names]


def methods(wildcards):
    """Return the methods that are judged on a fabric; the first one makes its material."""
    return methods_of(wildcards.fabric)


def methods_of(fabric):
    """Return the methods that are judged on the fabric of this name; the first one makes its material."""
    with_residual = config["fit"]["residual"] == "all" or (
        config["fit"]["residual"] == "photographs" and fabric in set_fabrics
    )
    return (
        ["slope-residual", *models]
        if with_residual and models[0] == "slope"
        else models
    )


def fitted_fabric(wildcards):
    """Return the folder of the fabric that is fitted; jobs read the shards of its stack, which no rule names."""
    return fitted.format(fabric=wildcards.fabric)


def need_of(wildcards):
    """Return the file of the scene's need where the fit uses it; else the fit does not depend on the scene."""
    asked = config["fit"]["regions"] == "needed"
    return f"results/{wildcards.fabric}/need.json" if asked else []


def lobes_option(wildcards):
    """Return the options for the lobes of the slope model; empty for the other models."""
    if getattr(wildcards, "model", "slope") != "slope":
        return ""
    if choice := choice_of(wildcards):
        return f"--choice {choice}"
    lobes, tail = lobes_of(config, fabrics[wildcards.fabric])
    return f"--lobes {lobes} --tail {tail}"


def choice_of(wildcards):
    """Return the file of the choice of lobes for the slope model, where the config leaves them open."""
    slope = getattr(wildcards, "model", "slope") == "slope"
    asked = slope and lobes_of(config, fabrics[wildcards.fabric]) is None
    return f"results/{wildcards.fabric}/fit/choice.json" if asked else []


def fitted_option(wildcards):
    """Return the option for the regions that get a lobe: all, the shiniest (label 0), or those the scene shows."""
    regions = config["fit"]["regions"]
    if regions == "needed":
        return f"--need {need_of(wildcards)}"
    return "--fitted 0" if regions == "shiniest" else ""


def chart_tables(wildcards):
    """Return the tables of all methods and, where the true regions are known, of the regions."""
    parts = ["default", *kinds]
    if wildcards.fabric in rig_fabrics and config["rig"]["device"] == "virtual":
        parts.append("regions")
    return [f"results/{wildcards.fabric}/chart/{part}.csv" for part in parts]
