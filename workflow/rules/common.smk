import hashlib
import json
import os
import sys
from functools import cache
from pathlib import Path

from kinran.base.digest import PACKAGES, digest
from kinran.data.fit_runs import read_runs
from kinran.run.config import (
    directions_options,
    lobes_of,
    motion_options,
    sheet_of,
)
from kinran.run.fabrics import read_fabrics
from kinran.run import failures, needs, owner, progress, resources, void
from kinran.base.end_with_run import RUN
from kinran.base.files import InputError
from kinran.scene.template import read_template
from snakemake.exceptions import WorkflowError
from snakemake.logging import logger

# jobs use the interpreter that runs Snakemake, with or without an activated environment; in a container they use its
# own, with the code of this project (a prefix of one's own replaces Snakemake's, so the strict mode is part of it).
# They end when this process does; of one that is killed otherwise its log tells, as it cannot do so itself
code = ":".join(str(path.parent) for path in PACKAGES.values())
shell.prefix(
    f'if [ -n "$APPTAINER_CONTAINER" ]; then export PYTHONPATH={code};'
    f" else export PATH={Path(sys.executable).parent}:$PATH; fi; export {RUN}={os.getpid()}; set -euo pipefail; "
    'python() {{ command python "$@" || {{ s=$?; [ $s != 137 ] || echo "kinran $3: was killed, most likely as memory'
    ' ran out; run fewer jobs at once (--cores), or ask for more memory (--set-resources)" >&2; return $s; }}; }}; '
)

# where a module with `prefix:` has its captures, results and logs
place = Path(workflow.modifier.path_modifier.replace_prefix("results", None)).parent

try:
    listed = read_fabrics(config, place)
except InputError as error:
    raise WorkflowError(str(error))

# a fabric with a wrong row gets one job alone, which fails with what is wrong (left_out.smk)
fabrics, left_out = listed.sound, listed.broken
owner.guard(workflow, listed, place, WorkflowError)

rig_fabrics = [name for name, fabric in fabrics.items() if fabric.folder is None]
set_fabrics = [name for name, fabric in fabrics.items() if fabric.folder is not None]
# by its name, the scan of each mesh; fabrics of one scan share it
meshes = {fabric.mesh: fabric.scan for fabric in fabrics.values()}
mesh_names = {name: fabric.mesh for name, fabric in fabrics.items()}
models = sorted({model for fabric in fabrics.values() for model in fabric.models})
# a job of the chart for each kind of method: a new file is a new job, and no other runs again
kinds = sorted(p.stem for p in PACKAGES["kinran"].glob("compare/methods/[a-z]*.py"))
# models without a lobe fit all regions alike
LOBELESS = {"lambert"}
watch = failures.Watch(place)
# (rules of a module may have other names)
stages = {
    workflow.modifier.modify_rulename(s): s for s in [*resources.COSTS, "capture"]
}
# shards of a group are no outputs that Snakemake knows. Where one is gone, what says that it is there goes, too
if workflow.is_main_process:
    logger.addHandler(watch)
    logger.addHandler(progress.Progress(lambda: progress.jobs_of(workflow, predicted)))
    for fabric in fabrics:
        void.remove_void(place / "results" / fabric)
    for says in left_out.values():
        print(f"left out: {says}", file=sys.stderr)
    failures.forget(place, left_out)


def any_of(names):
    """Return a pattern of these names; one that matches nothing where there are none."""
    return "|".join(names) or "(?!)"


wildcard_constraints:
    fabric=any_of(fabrics),
    group="[0-9]+|calibration|views",
    model=any_of(models),
    job="[0-9]+",
    mesh=any_of(meshes),


def given(path):
    """Return an input that the user names, which lies where it says, also for a module with a prefix."""
    return local(str(path)) if path else []


def shown(path, what):
    """Return an output of a fabric that `snakemake --report` shows under its name, with the caption of that name."""
    caption = f"../report/{Path(path).stem.split('.')[-1]}.rst"
    return report(
        path, caption=caption, category="Fabric {fabric}", labels={"shows": what}
    )


def settings(wildcards):
    """Return the settings of a fabric: those of the config, with what it has of its own."""
    return fabrics[wildcards.fabric].settings


@cache
def size_of(fabric):
    """Return the size of a fabric, on which depends what its jobs ask for; none of what fabrics share."""
    if not fabric:
        return resources.Size(0, 0)
    return resources.size_of(fabrics[fabric], place / "captures")


def threads_of(stage):
    """Return the threads of a stage's jobs, as a function of their wildcards."""
    return lambda wildcards: resources.threads(stage, size_of(wildcards.fabric))


def memory_of(stage):
    """Return the megabytes of a stage's jobs, as a function of their wildcards and the attempt."""
    return lambda wildcards, attempt: resources.memory_mb(
        stage, size_of(wildcards.get("fabric")), attempt
    )


def runtime_of(stage, jobs=lambda wildcards: 1):
    """Return the minutes of a stage's jobs, of which so many (by wildcards) share its work, in the same way."""
    return lambda wildcards, attempt, threads: resources.minutes(
        stage, size_of(wildcards.get("fabric")), attempt, threads * jobs(wildcards)
    )


def predicted(job):
    """Return the seconds of a job; 0 where it only gathers files, None where it is of another workflow."""
    if job.is_norun:
        return 0
    stage = stages.get(job.rule.name)
    if stage is None:
        return None
    if stage == "overview":
        return resources.seconds(stage, resources.Size(0, 0), 1)
    fabric = job.wildcards.get("fabric")
    if stage == "capture":
        return resources.capture_seconds(
            fabrics[fabric], job.wildcards.group, job.threads, place / "captures"
        )
    jobs = jobs_of(job.wildcards) if stage == "fit" else 1
    return resources.seconds(stage, size_of(fabric), job.threads, jobs)


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
    return listed.revisions(wildcards.fabric, wildcards.group)


def virtual_rig(wildcards):
    """Return the settings of the virtual fabric as JSON; the same settings give the same text."""
    rig = settings(wildcards)["rig"]
    lengths = {
        name: rig[name] for name in ("field_mm", "lamp_mm", "camera_mm") if name in rig
    }
    return json.dumps({**settings(wildcards)["virtual"], **lengths}, sort_keys=True)


def camera_option(wildcards):
    """Return the option of `kinran plan` for the distance of the lens, where the settings have one."""
    rig = settings(wildcards)["rig"]
    return f"--camera-mm {rig['camera_mm']}" if "camera_mm" in rig else ""


def rig_devices(wildcards):
    """Return the settings of rig and camera as JSON; the virtual ones take none."""
    known = "camera iso aperture usb serial speeds accelerations homing_s lux dose_limit_lux_h"
    rig = settings(wildcards)["rig"]
    given = {name: rig[name] for name in known.split() if name in rig}
    return json.dumps(given if rig["device"] == "hid" else {}, sort_keys=True)


def promised(fabric):
    """Return the files of a fabric that users look for, and that stages read: one that is gone is made again."""
    fits = methods_of(fabric)
    sigma = ["fit/slope.sigma.exr"] if fabrics[fabric].models[0] == "slope" else []
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
    own, asked = fabrics[fabric].models, fabrics[fabric].settings["fit"]["residual"]
    with_residual = asked == "all" or (asked == "photographs" and fabric in set_fabrics)
    return ["slope-residual", *own] if with_residual and own[0] == "slope" else own


def fitted(name):
    """Return a file of the texels that are fitted and judged, as a function of a rule's wildcards.

    They are as measured, or as coarse as the scene allows.
    """
    return lambda wildcards: "/".join(
        [
            f"results/{wildcards.fabric}",
            *(["needed"] if settings(wildcards)["fit"]["texels"] == "needed" else []),
            name,
        ]
    )


def fit_settings(wildcards):
    """Return what decides a fit, other than its inputs, in a word."""
    lobes = slope_lobes(wildcards) if wildcards.model == "slope" else ""
    texels = settings(wildcards)["fit"]["texels"]
    said = texels, regions_of(wildcards), lobes, digest("kinran.fit.fit")
    return hashlib.sha256(repr(said).encode()).hexdigest()[:12]


def jobs_of(wildcards):
    """Return the number of jobs among which a fabric's texels are divided: for a fit that is there, as it was."""
    fits = place / "results" / wildcards.fabric / "fit"
    material = fits / f"{wildcards.model}.exr"
    asked = settings(wildcards)["fit"]["jobs"]
    return read_runs(material, fit_settings(wildcards), asked)


def runs_of(wildcards):
    """Return the files of all fit jobs of a model."""
    return [
        f"results/{wildcards.fabric}/fit/{wildcards.model}.{job}.npz"
        for job in range(jobs_of(wildcards))
    ]


def sigma_of(wildcards):
    """Return the summary of how well the lights fix the material, which the slope model has."""
    slope = fabrics[wildcards.fabric].models[0] == "slope"
    return f"results/{wildcards.fabric}/fit/slope.sigma.json" if slope else []


def template_of(wildcards):
    """Return the scene that shows a fabric: what it says is in parameters, so that no comment runs a job again."""
    return ancient(given(settings(wildcards)["scene"]["template"]))


def template_digest(wildcards):
    """Return a digest of what the scene says of all but the samples a pixel."""
    return read_template(Path(settings(wildcards)["scene"]["template"])).digest


def samples_option(wildcards):
    """Return the option for the samples a pixel, where they stand apart in the scene; else the scene itself has them."""
    samples = read_template(Path(settings(wildcards)["scene"]["template"])).samples
    return f"--spp {samples}" if samples else ""


def scan_of(wildcards):
    """Return the scan of a mesh; none for a generated one."""
    return given(meshes[wildcards.mesh])


def shared_mesh(name):
    """Return a file of the mesh that a fabric shares, as a function of a rule's wildcards."""
    return lambda wildcards: f"results/_meshes/{mesh_names[wildcards.fabric]}/{name}"


def fit_question(wildcards):
    """Return what the scene is asked for the fit: the same as before while the answer is the same."""
    fit = settings(wildcards)["fit"]
    uses = needs.Uses(fit["texels"] == "needed", fit["regions"] == "needed")
    template = Path(settings(wildcards)["scene"]["template"])
    return needs.question(place / "results" / wildcards.fabric, template, uses)


def regions_of(wildcards):
    """Return which regions get a lobe; all of a model that has none, as it fits them alike."""
    regions = settings(wildcards)["fit"]["regions"]
    return regions if wildcards.model not in LOBELESS else "all"


def need_of(wildcards):
    """Return the file of what the scene needs where the fit uses it; else the fit does not depend on the scene."""
    asked = regions_of(wildcards) == "needed"
    return f"results/{wildcards.fabric}/fit/need.json" if asked else []


def slope_lobes(wildcards):
    """Return number and tail of a fabric's slope lobes, or none where they are chosen by its data."""
    return lobes_of(settings(wildcards)["fit"], fabrics[wildcards.fabric].lights)


def lobes_option(wildcards, input):
    """Return the options for the lobes of the slope model; empty for the other models."""
    if getattr(wildcards, "model", "slope") != "slope":
        return ""
    if input.choice:
        return f"--choice {input.choice}"
    lobes, tail = slope_lobes(wildcards)
    return f"--lobes {lobes} --tail {tail}"


def choice_of(wildcards):
    """Return the file of the choice of lobes for the slope model, where the config leaves them open."""
    slope = getattr(wildcards, "model", "slope") == "slope"
    asked = slope and slope_lobes(wildcards) is None
    return f"results/{wildcards.fabric}/fit/choice.json" if asked else []


def fitted_option(wildcards, input):
    """Return the option for the regions that get a lobe: all, the shiniest (label 0), or those the scene shows."""
    regions = regions_of(wildcards)
    if regions == "needed":
        return f"--need {input.need}"
    return "--fitted 0" if regions == "shiniest" else ""


def chart_tables(wildcards):
    """Return the tables of all methods and, where the true regions are known, of the regions."""
    parts = ["default", *kinds]
    if wildcards.fabric in rig_fabrics and config["rig"]["device"] == "virtual":
        parts.append("regions")
    return [f"results/{wildcards.fabric}/chart/{part}.csv" for part in parts]
