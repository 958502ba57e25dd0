from kinran.register.register import find_views

session = config["register"]

try:
    session_views = [given(path) for path in find_views(Path(session["views"]))]
except InputError as error:
    raise WorkflowError(str(error))


rule register:
    input:
        views=session_views,
        board=given(session["board"]),
    output:
        cameras="results/register/cameras.json",
        height="results/register/height.exr",
        report="results/register/register.json",
        rectified=[
            f"results/register/rectified/{Path(view).stem}.exr"
            for view in session_views
        ],
    log:
        "logs/register.log",
    benchmark:
        "results/register/benchmark.tsv"
    resources:
        mem_mb=4000,
    params:
        folder=subpath(output.report, parent=True),
        encoding=session["encoding"],
        code=digest("kinran.register.register"),
    shell:
        "python -m kinran register {params.folder:q} --views {input.views:q} --board {input.board:q}"
        " --encoding {params.encoding:q} 2>&1 | tee {log}"
