rule ingest:
    output:
        "captures/{fabric}/plan.json",
    log:
        "logs/{fabric}/ingest.log",
    wildcard_constraints:
        fabric=any_of(set_fabrics),
    resources:
        mem_mb=memory_of("ingest"),
        runtime=runtime_of("ingest"),
    params:
        folder=lambda wildcards: fabrics[wildcards.fabric].folder,
        encoding=lambda wildcards: fabrics[wildcards.fabric].encoding,
        crop=lambda wildcards: fabrics[wildcards.fabric].crop,
        holdout=lambda wildcards: settings(wildcards)["holdout"],
        lights=lambda wildcards: fabrics[wildcards.fabric].light_options,
        code=digest("kinran.capture.ingest"),
    shell:
        "python -m kinran ingest --folder {params.folder:q} --fabric {wildcards.fabric}"
        " --encoding {params.encoding:q} --crop={params.crop:q} --holdout {params.holdout}"
        " {params.lights} {output:q} 2>&1 | tee {log}"


rule ingest_group:
    input:
        "captures/{fabric}/plan.json",
    output:
        "captures/{fabric}/groups/{group}.json",
    log:
        "logs/{fabric}/ingest/{group}.log",
    wildcard_constraints:
        fabric=any_of(set_fabrics),
    resources:
        mem_mb=memory_of("ingest_group"),
        runtime=runtime_of("ingest_group"),
    params:
        folder=lambda wildcards: fabrics[wildcards.fabric].folder,
        lp=lambda wildcards: fabrics[wildcards.fabric].lp_option,
        code=digest("kinran.capture.ingest_group"),
    shell:
        "python -m kinran ingest-group --folder {params.folder:q} --plan {input:q} --group {wildcards.group}"
        " {params.lp} {output:q} 2>&1 | tee {log}"
