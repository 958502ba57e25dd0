from kinran.base.project import ROOT
from snakemake.utils import min_version

min_version("9.14")


configfile: "config.yaml"


report: "workflow/report/workflow.rst"


# used with `--sdm apptainer` alone, after container/kinran.def was built (docs/cluster.md)
container: f"{ROOT}/container/kinran.sif"


include: "workflow/rules/common.smk"
include: "workflow/rules/ingest.smk"
include: "workflow/rules/radiance.smk"
include: "workflow/rules/need.smk"
include: "workflow/rules/fit.smk"
include: "workflow/rules/scene.smk"
include: "workflow/rules/report.smk"
include: "workflow/rules/chart.smk"
include: "workflow/rules/left_out.smk"


# without a rig, what was captured is plain input: nothing can overwrite it
if config["rig"]["device"] != "none":

    include: "workflow/rules/capture.smk"


# side views are registered only where there are some: `snakemake register`
if "register" in config:

    include: "workflow/rules/register.smk"


rule all:
    input:
        "results/report.html",
        [promised(fabric) for fabric in fabrics],
        [f"logs/{fabric}/never" for fabric in left_out],


# the overview has all fabrics, also after a run in which some failed and whose job for it had to wait for them
onerror:
    failures.write_overview(
        Path(*log[:1]).name, watch.failures(mesh_names), fabrics, left_out, place
    )
