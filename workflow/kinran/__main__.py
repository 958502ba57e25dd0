"""Kinran on the command line: `python -m kinran STAGE …`; every stage can be run by hand."""

import argparse
import importlib
import logging
import sys

from kinran import command as words
from kinran.files import InputError
from kinran.log import to_stderr

log = logging.getLogger("kinran")

COMMANDS = {
    "demo": ("kinran.demo", "run the whole pipeline on the virtual rig"),
    "test": ("kinran.selftest", "run the tests"),
    "bench": ("kinran.bench", "measure speed and accuracy"),
    "doctor": ("kinran.doctor", "check this machine and say what to do"),
    "rti": ("kinran.rti", "run the pipeline on photographs with a .lp file"),
    "highlights": ("kinran.highlights", "find the lamps from mirror spheres in photographs, and write their .lp"),
    "merge": ("kinran.radiance.merge", "merge one bracket of frames to linear radiance with its noise"),
    "relight": ("kinran.relight", "relight a material, and compare with photographs"),
    "render": ("kinran.render", "render a Mitsuba scene with Kinran materials"),
    "native": ("kinran_bsdf.native", "compile the plugin for Mitsuba's own command"),
    "rig": ("kinran.rig.cli", "talk to the goniometer"),
    "plan": ("kinran.plan", "plan the shots of a capture"),
    "capture": ("kinran.capture", "shoot a group of the plan"),
    "ingest": ("kinran.ingest", "take photographs as a capture"),
    "calibrate": ("kinran.radiance.calibrate", "calibrate camera, lamp and colour"),
    "merge-group": ("kinran.radiance.merge_group", "merge the brackets of a group to radiance"),
    "stack": ("kinran.radiance.assemble", "complete the radiance stack"),
    "export": ("kinran.radiance.export", "write an EXR for each light of a stack"),
    "segment": ("kinran.segment", "segment a fabric into regions"),
    "need": ("kinran.need", "say what a scene needs of a fabric"),
    "coarsen": ("kinran.coarsen", "average the texels that a scene cannot tell apart"),
    "choice": ("kinran.fit.choice", "choose the simplest lobes that explain a fabric"),
    "prior": ("kinran.fit.prior", "find the regions' priors for the fit"),
    "fit": ("kinran.fit.tile", "fit a model to a run of tiles"),
    "material": ("kinran.fit.join", "join fitted runs to a material"),
    "residual": ("kinran.fit.residual", "add a residual where it pays"),
    "sigma": ("kinran.fit.sigma", "map how well the lights fix a material"),
    "normals": ("kinran.fit.normals", "find surface normals from a stack"),
    "evaluate": ("kinran.evaluate", "judge materials on held-out lights"),
    "scan": ("kinran.scan", "generate the scan of a draped cloth"),
    "register": ("kinran.register", "register side views to the front view"),
    "mesh": ("kinran.mesh", "clean and unwrap a scan"),
    "scene": ("kinran.scene", "assemble a Mitsuba scene"),
    "chart": ("kinran.chart.stage", "chart accuracy against speed"),
    "chart-table": ("kinran.chart.table", "join the tables of a fabric's methods, and draw them"),
    "chart-regions": ("kinran.chart.regions", "count right labels where the truth is known"),
    "charts": ("kinran.chart.page", "write the page of all charts"),
    "report": ("kinran.report", "write the report of a fabric"),
    "overview": ("kinran.report.overview", "write the overview of all fabrics"),
}


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    argv = sys.argv[1:] if argv is None else argv
    parser = argparse.ArgumentParser(
        prog="kinran",
        description="From a fabric under known lights to a material that a path tracer renders.",
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary)
        if argv[:1] == [name]:  # only the stage that runs is imported
            stage = importlib.import_module(module)
            command.description = (stage.__doc__ or summary).strip()
            command.formatter_class = argparse.RawDescriptionHelpFormatter
            if hasattr(stage, "add_arguments"):  # commands of several words declare their own
                stage.add_arguments(command)
            else:
                words.add_arguments(command, stage.main)
    args, rest = parser.parse_known_args(argv)
    if args.command == "test":
        args.rest = rest
    elif rest:
        parser.error(f"unknown arguments: {' '.join(rest)}")
    to_stderr()
    try:
        stage = importlib.import_module(COMMANDS[args.command][0])
        if hasattr(stage, "add_arguments"):
            stage.main(args)
        else:
            words.call(stage.main, args)
    except InputError as error:
        log.error("kinran %s: %s", args.command, error)
        return 2
    except KeyboardInterrupt:
        log.error("kinran %s: stopped", args.command)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
