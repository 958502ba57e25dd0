rule need:
    input:
        template=template_of,
        mesh="results/{fabric}/scene/mesh.ply",
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        stack="results/{fabric}/radiance.zarr/zarr.json",
    output:
        "results/{fabric}/need.json",
    log:
        "logs/{fabric}/need.log",
    benchmark:
        "results/{fabric}/benchmarks/need.tsv"
    resources:
        mem_mb=memory_of("need"),
        runtime=runtime_of("need"),
    params:
        folder=subpath(input.labels, parent=True),
        code=digest("kinran.scene.need"),
    shell:
        "python -m kinran need {output:q} --template {input.template:q} --mesh {input.mesh:q}"
        " --fabric {params.folder:q} 2>&1 | tee {log}"
