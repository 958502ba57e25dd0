# what fabrics with one scan share: it is cleaned once, also where one of them is added later
rule scan:
    input:
        scan_of,
    output:
        "results/_meshes/{mesh}/scan.ply",
    log:
        "logs/_meshes/{mesh}/scan.log",
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
        "results/_meshes/{mesh}/scan.ply",
    output:
        mesh="results/_meshes/{mesh}/mesh.ply",
        report="results/_meshes/{mesh}/mesh.json",
    log:
        "logs/_meshes/{mesh}/mesh.log",
    benchmark:
        "results/_meshes/{mesh}/benchmarks/mesh.tsv"
    resources:
        mem_mb=memory_of("mesh"),
        runtime=runtime_of("mesh"),
    params:
        code=digest("kinran.scene.mesh"),
    shell:
        "python -m kinran mesh {input:q} {output.mesh:q} --report {output.report:q} 2>&1 | tee {log}"


rule own_mesh:
    # copies, so that the folder of a fabric has all that its scene shows; links would have one time stamp for all
    input:
        scan=shared_mesh("scan.ply"),
        mesh=shared_mesh("mesh.ply"),
        report=shared_mesh("mesh.json"),
    output:
        scan="results/{fabric}/scan.ply",
        mesh="results/{fabric}/scene/mesh.ply",
        report="results/{fabric}/mesh.json",
    log:
        "logs/{fabric}/own_mesh.log",
    localrule: True
    shell:
        "(cp {input.scan:q} {output.scan:q} && cp {input.mesh:q} {output.mesh:q}"
        " && cp {input.report:q} {output.report:q}) 2>{log:q}"


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
        says=template_digest,
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
        samples=samples_option,
        code=digest("kinran.scene.render"),
        plugin=digest("kinran_bsdf"),
    shell:
        "(python -m kinran render {input:q} --out {output.exr:q} {params.samples}"
        " && python -m kinran render {input:q} --out {output.sweep:q} --sweep 5) 2>&1 | tee {log}"
