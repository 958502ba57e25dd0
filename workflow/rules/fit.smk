rule segment:
    input:
        "results/{fabric}/radiance.zarr/zarr.json",
    output:
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        statistics="results/{fabric}/statistics.exr",
    log:
        "logs/{fabric}/segment.log",
    benchmark:
        "results/{fabric}/benchmarks/segment.tsv"
    resources:
        mem_mb=memory_of("segment"),
        runtime=runtime_of("segment"),
    params:
        folder=subpath(output.labels, parent=True),
        regions=lambda wildcards: fabrics[wildcards.fabric].region_option,
        code=digest("kinran.segment.segment"),
    shell:
        "python -m kinran segment --fabric {params.folder:q} {params.regions} 2>&1 | tee {log}"


rule coarsen:
    input:
        stack="results/{fabric}/radiance.zarr/zarr.json",
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        need="results/{fabric}/fit/need.json",
    output:
        stack="results/{fabric}/needed/radiance.zarr/zarr.json",
        radiance="results/{fabric}/needed/radiance.zarr/radiance/zarr.json",
        flags="results/{fabric}/needed/radiance.zarr/flags/zarr.json",
        labels="results/{fabric}/needed/labels.exr",
        regions="results/{fabric}/needed/regions.json",
    log:
        "logs/{fabric}/coarsen.log",
    benchmark:
        "results/{fabric}/benchmarks/coarsen.tsv"
    resources:
        mem_mb=memory_of("coarsen"),
        runtime=runtime_of("coarsen"),
    params:
        folder=subpath(input.labels, parent=True),
        coarse=subpath(output.labels, parent=True),
        code=digest("kinran.radiance.coarsen"),
    shell:
        "python -m kinran coarsen {params.coarse:q} --fabric {params.folder:q} --need {input.need:q} 2>&1 | tee {log}"


rule choice:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
    output:
        choice="results/{fabric}/fit/choice.json",
        picture=shown("results/{fabric}/fit/choice.png", "choice of lobes"),
    log:
        "logs/{fabric}/choice.log",
    benchmark:
        "results/{fabric}/benchmarks/choice.tsv"
    threads: threads_of("choice")
    resources:
        mem_mb=memory_of("choice"),
        runtime=runtime_of("choice"),
    params:
        fabric=subpath(input.labels, parent=True),
        code=digest("kinran.fit.choice"),
    shell:
        "python -m kinran choice {output.choice:q} --fabric {params.fabric:q}"
        " --picture {output.picture:q} --threads {threads} 2>&1 | tee {log}"


rule prior:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
        choice=choice_of,
    output:
        "results/{fabric}/fit/prior.json",
    log:
        "logs/{fabric}/prior.log",
    benchmark:
        "results/{fabric}/benchmarks/prior.tsv"
    threads: threads_of("prior")
    resources:
        mem_mb=memory_of("prior"),
        runtime=runtime_of("prior"),
    params:
        fabric=subpath(input.labels, parent=True),
        lobes=lobes_option,
        code=digest("kinran.fit.prior"),
    shell:
        "python -m kinran prior {output:q} --fabric {params.fabric:q}"
        " {params.lobes} --threads {threads} 2>&1 | tee {log}"


rule fit:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        prior=branch(
            lambda wildcards: wildcards.model == "slope",
            then="results/{fabric}/fit/prior.json",
            otherwise=[],
        ),
        need=need_of,
        choice=choice_of,
    output:
        temp("results/{fabric}/fit/{model}.{job}.npz"),
    log:
        "logs/{fabric}/fit/{model}.{job}.log",
    benchmark:
        "results/{fabric}/benchmarks/fit.{model}.{job}.tsv"
    resources:
        mem_mb=memory_of("fit"),
        runtime=runtime_of("fit", jobs=jobs_of),
    params:
        fabric=subpath(input.labels, parent=True),
        prior=lambda wildcards, input: (
            f"--prior {input.prior}" if input.get("prior") else ""
        ),
        fitted=fitted_option,
        lobes=lobes_option,
        jobs=jobs_of,
        code=digest("kinran.fit.fit"),
    shell:
        "python -m kinran fit {output:q} --fabric {params.fabric:q} --model {wildcards.model}"
        " {params.prior} {params.fitted} {params.lobes} --tile {wildcards.job}/{params.jobs} --threads {threads}"
        " 2>&1 | tee {log}"


rule material:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
        runs=runs_of,
        need=need_of,
        choice=choice_of,
    output:
        material="results/{fabric}/fit/{model}.exr",
        summary="results/{fabric}/fit/{model}.json",
    log:
        "logs/{fabric}/material/{model}.log",
    resources:
        mem_mb=memory_of("material"),
        runtime=runtime_of("material"),
    params:
        fabric=subpath(input.labels, parent=True),
        fitted=fitted_option,
        lobes=lobes_option,
        settings=fit_settings,
        code=digest("kinran.fit.material"),
    shell:
        "python -m kinran material {output.material:q} --fabric {params.fabric:q}"
        " --model {wildcards.model} {params.lobes} {params.fitted} --settings {params.settings} --runs {input.runs:q}"
        " --summary {output.summary:q} 2>&1 | tee {log}"


rule residual:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        prior="results/{fabric}/fit/prior.json",
        material="results/{fabric}/fit/slope.exr",
        summary="results/{fabric}/fit/slope.json",
    output:
        material="results/{fabric}/fit/slope-residual.exr",
        summary="results/{fabric}/fit/slope-residual.json",
    log:
        "logs/{fabric}/residual.log",
    benchmark:
        "results/{fabric}/benchmarks/residual.tsv"
    threads: threads_of("residual")
    resources:
        mem_mb=memory_of("residual"),
        runtime=runtime_of("residual"),
    params:
        fabric=subpath(input.labels, parent=True),
        code=digest("kinran.fit.residual"),
    shell:
        "python -m kinran residual {output.material:q} --fabric {params.fabric:q}"
        " --prior {input.prior:q} --material {input.material:q} --fitted {input.summary:q}"
        " --summary {output.summary:q} --threads {threads} 2>&1 | tee {log}"


rule sigma:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
        prior="results/{fabric}/fit/prior.json",
        material="results/{fabric}/fit/slope.exr",
    output:
        maps="results/{fabric}/fit/slope.sigma.exr",
        summary="results/{fabric}/fit/slope.sigma.json",
        picture=shown("results/{fabric}/fit/slope.sigma.png", "uncertainty"),
    log:
        "logs/{fabric}/sigma.log",
    benchmark:
        "results/{fabric}/benchmarks/sigma.tsv"
    threads: threads_of("sigma")
    resources:
        mem_mb=memory_of("sigma"),
        runtime=runtime_of("sigma"),
    params:
        fabric=subpath(input.labels, parent=True),
        code=digest("kinran.fit.sigma"),
    shell:
        "python -m kinran sigma {output.maps:q} --fabric {params.fabric:q}"
        " --prior {input.prior:q} --material {input.material:q}"
        " --summary {output.summary:q} --picture {output.picture:q} --threads {threads} 2>&1 | tee {log}"


rule choose:
    input:
        lambda wildcards: f"results/{wildcards.fabric}/fit/{methods(wildcards)[0]}.exr",
    output:
        "results/{fabric}/material.exr",
    log:
        "logs/{fabric}/choose.log",
    resources:
        mem_mb=memory_of("choose"),
        runtime=runtime_of("choose"),
    shell:
        "cp {input:q} {output:q} 2>{log}"


rule evaluate:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
        materials=lambda wildcards: expand(
            "results/{fabric}/fit/{model}.exr",
            fabric=wildcards.fabric,
            model=methods(wildcards),
        ),
        summaries=lambda wildcards: expand(
            "results/{fabric}/fit/{model}.json",
            fabric=wildcards.fabric,
            model=methods(wildcards),
        ),
    output:
        errors="results/{fabric}/evaluation.json",
        picture=shown("results/{fabric}/evaluation.png", "held-out lights"),
    log:
        "logs/{fabric}/evaluate.log",
    benchmark:
        "results/{fabric}/benchmarks/evaluate.tsv"
    resources:
        mem_mb=memory_of("evaluate"),
        runtime=runtime_of("evaluate"),
    params:
        fabric=subpath(input.labels, parent=True),
        # their order counts: the first makes the material
        methods=methods,
        code=digest("kinran.judge.evaluate"),
    shell:
        "python -m kinran evaluate {output.errors:q} --name {wildcards.fabric} --fabric {params.fabric:q}"
        " --materials {input.materials:q}"
        " --picture {output.picture:q} 2>&1 | tee {log}"
