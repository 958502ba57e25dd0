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
        says=template_digest,
        folder=subpath(input.labels, parent=True),
        code=digest("kinran.scene.need"),
    shell:
        "python -m kinran need {output:q} --template {input.template:q} --mesh {input.mesh:q}"
        " --fabric {params.folder:q} 2>&1 | tee {log}"


rule need_to_fit:
    # the same for the fit, where it uses it: not made again for a scene that needs the same of it
    input:
        template=template_of,
        mesh="results/{fabric}/scene/mesh.ply",
        labels="results/{fabric}/labels.exr",
        regions="results/{fabric}/regions.json",
        stack="results/{fabric}/radiance.zarr/zarr.json",
    output:
        "results/{fabric}/fit/need.json",
    log:
        "logs/{fabric}/need_to_fit.log",
    resources:
        mem_mb=memory_of("need_to_fit"),
        runtime=runtime_of("need_to_fit"),
    params:
        folder=subpath(input.labels, parent=True),
        asked=fit_question,
    shell:
        "python -m kinran need {output:q} --template {input.template:q} --mesh {input.mesh:q}"
        " --fabric {params.folder:q} --asked {params.asked:q} 2>&1 | tee {log}"
