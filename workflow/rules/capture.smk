rule plan:
    input:
        directions=lambda wildcards: given(
            sheet_of(settings(wildcards)["rig"], wildcards.fabric)
        ),
    output:
        "captures/{fabric}/plan.json",
    log:
        "logs/{fabric}/plan.log",
    wildcard_constraints:
        fabric=any_of(rig_fabrics),
    localrule: True
    params:
        directions=lambda wildcards: directions_options(
            settings(wildcards)["rig"], wildcards.fabric
        ),
        exposures=lambda wildcards: ",".join(
            f"{1 / rate:.9g}" for rate in settings(wildcards)["rig"]["exposures"]
        ),
        lamp=lambda wildcards: settings(wildcards)["rig"]["lamp_mm"],
        field=lambda wildcards: settings(wildcards)["rig"]["field_mm"],
        camera=camera_option,
        motion=lambda wildcards: motion_options(settings(wildcards)["rig"]),
        # what draws a plan, and what prints it, changes none
        code=digest(
            "kinran.capture.plan",
            "kinran.base.drawing.canvas",
            "kinran.capture.plan_drawing",
            "kinran.capture.plan_table",
            "kinran.rig.errors",
        ),
    shell:
        "python -m kinran plan --fabric {wildcards.fabric} {params.directions} {params.motion}"
        " --exposures {params.exposures} --lamp-mm {params.lamp} --field-mm {params.field} {params.camera} {output}"
        " 2>&1 | tee {log}"


rule capture:
    input:
        "captures/{fabric}/plan.json",
    output:
        update("captures/{fabric}/groups/{group}.json"),
    log:
        "logs/{fabric}/capture/{group}.log",
    benchmark:
        "results/{fabric}/benchmarks/capture.{group}.tsv"
    wildcard_constraints:
        fabric=any_of(rig_fabrics),
    localrule: True
    # frames are taken one after the other, with all cores where they are simulated
    threads: resources.WHOLE_MACHINE
    resources:
        rig=1,
    params:
        device=config["rig"]["device"],
        virtual=virtual_rig,
        rig=rig_devices,
        revisions=revisions,
        # code that decides the virtual rig's frames; a camera's do not depend on code
        code=(
            digest(
                "kinran.virtual.devices", "kinran.rig.errors", "kinran.rig.stopping"
            )
            if config["rig"]["device"] == "virtual"
            else ""
        ),
    shell:
        "python -m kinran capture --plan {input:q} --group {wildcards.group} --device {params.device}"
        " --virtual {params.virtual:q} --rig {params.rig:q} --revisions {params.revisions:q} {output:q} 2>&1 | tee {log}"
