wildcard_constraints:
    kind="|".join(kinds),


rule chart:
    input:
        "results/chart.html",
        expand(
            "results/{fabric}/chart.{kind}", fabric=fabrics, kind=["csv", "svg", "png"]
        ),


rule chart_kind:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
    output:
        "results/{fabric}/chart/{kind}.csv",
    log:
        "logs/{fabric}/chart/{kind}.log",
    benchmark:
        "results/{fabric}/benchmarks/chart.{kind}.tsv"
    # one at a time, so that no other job disturbs the timings
    threads: resources.WHOLE_MACHINE
    resources:
        mem_mb=memory_of("chart_kind"),
        runtime=runtime_of("chart_kind"),
    params:
        fabric=subpath(input.labels, parent=True),
        code=lambda wildcards: [
            digest(f"kinran.compare.methods.{wildcards.kind}"),
            digest("kinran.compare.experiments"),
        ],
    shell:
        "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1;"
        " python -m kinran chart {output:q} --fabric {params.fabric:q} --name {wildcards.fabric}"
        " --kind {wildcards.kind} 2>&1 | tee {log}"


rule chart_default:
    input:
        stack=fitted("radiance.zarr/zarr.json"),
        labels=fitted("labels.exr"),
        regions=fitted("regions.json"),
        material="results/{fabric}/material.exr",
        summary=lambda wildcards: f"results/{wildcards.fabric}/fit/{methods(wildcards)[0]}.json",
    output:
        "results/{fabric}/chart/default.csv",
    log:
        "logs/{fabric}/chart/default.log",
    benchmark:
        "results/{fabric}/benchmarks/chart.default.tsv"
    threads: resources.WHOLE_MACHINE
    resources:
        mem_mb=memory_of("chart_default"),
        runtime=runtime_of("chart_default"),
    params:
        fabric=subpath(input.labels, parent=True),
        code=digest("kinran.compare.default"),
    shell:
        "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1;"
        " python -m kinran chart {output:q} --fabric {params.fabric:q} --name {wildcards.fabric}"
        " --kind default --material {input.material:q} --summary {input.summary:q} 2>&1 | tee {log}"


rule chart_regions:
    input:
        stack="results/{fabric}/radiance.zarr/zarr.json",
        labels="results/{fabric}/labels.exr",
    output:
        "results/{fabric}/chart/regions.csv",
    log:
        "logs/{fabric}/chart/regions.log",
    resources:
        mem_mb=memory_of("chart_regions"),
        runtime=runtime_of("chart_regions"),
    params:
        fabric=subpath(input.labels, parent=True),
        scene=virtual_rig,
        code=digest("kinran.compare.chart_regions"),
    shell:
        "python -m kinran chart-regions {output:q} --fabric {params.fabric:q} --name {wildcards.fabric}"
        " --scene {params.scene:q} 2>&1 | tee {log}"


rule chart_fabric:
    input:
        chart_tables,
    output:
        table="results/{fabric}/chart.csv",
        svg="results/{fabric}/chart.svg",
        png="results/{fabric}/chart.png",
    log:
        "logs/{fabric}/chart.log",
    params:
        code=digest("kinran.compare.chart_table"),
    shell:
        "python -m kinran chart-table {output.table:q} --tables {input:q}"
        " --pictures {output.svg:q} {output.png:q} 2>&1 | tee {log}"


rule stability:
    output:
        "results/stability.json",
    log:
        "logs/stability.log",
    params:
        code=digest("benchmarks.stability"),
    shell:
        "python -m kinran bench stability --out {output:q} 2>&1 | tee {log}"


rule charts:
    input:
        charts=expand("results/{fabric}/chart.csv", fabric=fabrics),
        stability="results/stability.json",
    output:
        "results/chart.html",
    log:
        "logs/charts.log",
    params:
        code=digest("kinran.compare.chart_page"),
    shell:
        "python -m kinran chart-page {output:q} --charts {input.charts:q} --stability {input.stability:q} 2>&1 | tee {log}"
