rule left_out:
    # of a fabric whose row is wrong: it fails, so that the run says so at its end, and the others finish
    output:
        "logs/{fabric}/never",
    log:
        "logs/{fabric}/left_out.log",
    wildcard_constraints:
        fabric=any_of(left_out),
    localrule: True
    params:
        says=lambda wildcards: left_out[wildcards.fabric],
    shell:
        "echo {params.says:q} 2>&1 | tee {log:q} >&2; exit 2"
