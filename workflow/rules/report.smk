rule report:
    input:
        plan="captures/{fabric}/plan.json",
        manifests=manifests,
        calibration="results/{fabric}/calibration.json",
        stack="results/{fabric}/radiance.zarr/zarr.json",
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        need="results/{fabric}/need.json",
        statistics="results/{fabric}/statistics.exr",
        material="results/{fabric}/material.exr",
        errors="results/{fabric}/evaluation.json",
        picture="results/{fabric}/evaluation.png",
        sigma=sigma_of,
        choice=choice_of,
        mesh="results/{fabric}/mesh.json",
        render="results/{fabric}/render.png",
        sweep="results/{fabric}/sweep.png",
    output:
        shown("results/{fabric}/report.html", "report"),
    log:
        "logs/{fabric}/report.log",
    resources:
        mem_mb=memory_of("report"),
        runtime=runtime_of("report"),
    params:
        results=subpath(output[0], parent=True),
        captures=subpath(input.plan, parent=True),
        choice=lambda wildcards, input: (
            f"--choice {input.choice}" if input.choice else ""
        ),
        code=digest("kinran.report.report"),
    shell:
        "python -m kinran report --fabric {params.results:q}"
        " --captures {params.captures:q} {params.choice} {output:q} 2>&1 | tee {log}"


rule overview:
    input:
        errors=expand("results/{fabric}/evaluation.json", fabric=fabrics),
        reports=expand("results/{fabric}/report.html", fabric=fabrics),
        failures="results/failures.json",
    output:
        report(
            "results/report.html",
            caption="../report/overview.rst",
            category="All fabrics",
            labels={"shows": "overview"},
        ),
    log:
        "logs/overview.log",
    localrule: True
    params:
        code=digest("kinran.report.overview"),
    shell:
        "python -m kinran overview {output:q} --errors {input.errors:q} --failures {input.failures:q}"
        " 2>&1 | tee {log}"
