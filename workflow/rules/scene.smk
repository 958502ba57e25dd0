rule scan:
    input:
        scan_of,
    output:
        "results/{fabric}/scan.ply",
    log:
        "logs/{fabric}/scan.log",
    resources:
        mem_mb=memory_of("scan"),
        runtime=runtime_of("scan"),
    params:
        code=digest("kinran.virtual.scan"),
    shell:
        "if [ -z {input:q} ]; then python -m kinran scan {output:q};"
        " else cp {input:q} {output:q}; fi 2>&1 | tee {log}"


rule mesh:
    input:
        "results/{fabric}/scan.ply",
    output:
        mesh="results/{fabric}/scene/mesh.ply",
        report="results/{fabric}/mesh.json",
    log:
        "logs/{fabric}/mesh.log",
    benchmark:
        "results/{fabric}/benchmarks/mesh.tsv"
    resources:
        mem_mb=memory_of("mesh"),
        runtime=runtime_of("mesh"),
    params:
        code=digest("kinran.scene.mesh"),
    shell:
        "python -m kinran mesh {input:q} {output.mesh:q} --report {output.report:q} 2>&1 | tee {log}"


rule scene:
    input:
        mesh="results/{fabric}/scene/mesh.ply",
        material="results/{fabric}/material.exr",
        template=template_of,
    output:
        "results/{fabric}/scene/scene.xml",
    log:
        "logs/{fabric}/scene.log",
    resources:
        mem_mb=memory_of("scene"),
        runtime=runtime_of("scene"),
    params:
        folder=subpath(output[0], parent=True),
        code=digest("kinran.scene.scene"),
    shell:
        "python -m kinran scene --template {input.template:q} --mesh {input.mesh:q}"
        " --material {input.material:q} --out {params.folder:q} 2>&1 | tee {log}"


rule render:
    input:
        "results/{fabric}/scene/scene.xml",
    output:
        exr="results/{fabric}/render.exr",
        png=shown("results/{fabric}/render.png", "picture"),
        json="results/{fabric}/render.json",
        sweep=shown("results/{fabric}/sweep.png", "the light moved"),
    log:
        "logs/{fabric}/render.log",
    benchmark:
        "results/{fabric}/benchmarks/render.tsv"
    threads: threads_of("render")
    resources:
        mem_mb=memory_of("render"),
        runtime=runtime_of("render"),
    params:
        code=digest("kinran.scene.render"),
        plugin=digest("kinran_bsdf"),
    shell:
        "(python -m kinran render {input:q} --out {output.exr:q}"
        " && python -m kinran render {input:q} --out {output.sweep:q} --sweep 5) 2>&1 | tee {log}"
