rule chart:
    input:
        "results/chart.html",
        expand(
            "results/{fabric}/chart.{kind}", fabric=fabrics, kind=["csv", "svg", "png"]
        ),


rule chart_fabric:
    input:
        stack="results/{fabric}/radiance.zarr/zarr.json",
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        material="results/{fabric}/material.exr",
        summary=lambda wildcards: f"results/{wildcards.fabric}/fit/{methods(wildcards)[0]}.json",
    output:
        table="results/{fabric}/chart.csv",
        svg="results/{fabric}/chart.svg",
        png="results/{fabric}/chart.png",
    log:
        "logs/{fabric}/chart.log",
    benchmark:
        "results/{fabric}/benchmarks/chart.tsv"
    # one at a time, so that no other job spoils the times
    threads: workflow.cores
    resources:
        mem_mb=3000,
    params:
        stack=lambda wildcards: f"results/{wildcards.fabric}/radiance.zarr",
        code=digest("kinran.chart"),
    shell:
        "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1;"
        " python -m kinran chart {output.table:q} --fabric {wildcards.fabric} --stack {params.stack:q}"
        " --labels {input.labels:q} --regions {input.regions:q} --material {input.material:q}"
        " --summary {input.summary:q} --pictures {output.svg:q} {output.png:q} 2>&1 | tee {log}"


rule charts:
    input:
        expand("results/{fabric}/chart.csv", fabric=fabrics),
    output:
        "results/chart.html",
    log:
        "logs/charts.log",
    params:
        code=digest("kinran.chart.page"),
    shell:
        "python -m kinran charts {output:q} --charts {input:q} 2>&1 | tee {log}"
