rule calibrate:
    input:
        plan="captures/{fabric}/plan.json",
        # one group alone, so that a direction shot again does not merge all groups again
        manifest=calibration_manifest,
        chart=lambda wildcards: given(fabrics[wildcards.fabric].chart.file),
        flat=lambda wildcards: [
            local(path) for path in fabrics[wildcards.fabric].card.files
        ],
    output:
        "results/{fabric}/calibration.json",
    log:
        "logs/{fabric}/calibrate.log",
    benchmark:
        "results/{fabric}/benchmarks/calibrate.tsv"
    resources:
        mem_mb=memory_of("calibrate"),
        runtime=runtime_of("calibrate"),
    params:
        chart=lambda wildcards: fabrics[wildcards.fabric].chart.options,
        flat=lambda wildcards: fabrics[wildcards.fabric].card.options,
        code=digest("kinran.calibrate.calibrate"),
    shell:
        "python -m kinran calibrate {output:q} --plan {input.plan:q} --manifests {input.manifest:q}"
        " {params.chart} {params.flat} 2>&1 | tee {log}"


rule merge:
    input:
        plan="captures/{fabric}/plan.json",
        calibration="results/{fabric}/calibration.json",
        manifest="captures/{fabric}/groups/{group}.json",
    output:
        "results/{fabric}/merged/{group}.json",
    log:
        "logs/{fabric}/merge/{group}.log",
    benchmark:
        "results/{fabric}/benchmarks/merge.{group}.tsv"
    resources:
        mem_mb=memory_of("merge"),
        runtime=runtime_of("merge"),
    params:
        stack=lambda wildcards, output: f"{Path(output[0]).parents[1]}/radiance.zarr",
        code=digest("kinran.radiance.merge_group"),
    shell:
        "python -m kinran merge-group --plan {input.plan:q} --calibration {input.calibration:q}"
        " --manifest {input.manifest:q} --receipt {output:q} {params.stack:q} 2>&1 | tee {log}"


rule stack:
    input:
        plan="captures/{fabric}/plan.json",
        calibration="results/{fabric}/calibration.json",
        manifests=manifests,
        receipts=receipts,
    output:
        "results/{fabric}/radiance.zarr/zarr.json",
        "results/{fabric}/radiance.zarr/radiance/zarr.json",
        "results/{fabric}/radiance.zarr/flags/zarr.json",
    log:
        "logs/{fabric}/stack.log",
    benchmark:
        "results/{fabric}/benchmarks/stack.tsv"
    resources:
        mem_mb=memory_of("stack"),
        runtime=runtime_of("stack"),
    params:
        holdout=lambda wildcards: settings(wildcards)["holdout"],
        stack=subpath(output[0], parent=True),
        code=digest("kinran.radiance.stack"),
    shell:
        "python -m kinran stack {params.stack:q} --plan {input.plan:q} --calibration {input.calibration:q}"
        " --manifests {input.manifests:q} --receipts {input.receipts:q} --holdout {params.holdout}"
        " 2>&1 | tee {log}"
