"""Kinran on the command line: `python -m kinran STAGE …`; every stage can be run by hand."""

import argparse
import importlib
import logging
import sys
from types import ModuleType

from kinran import command as words
from kinran.files import InputError
from kinran.log import to_stderr

log = logging.getLogger("kinran")

COMMANDS = {
    "demo": ("kinran.demo", "run the whole pipeline on the virtual rig"),
    "rti": ("kinran.rti", "run the pipeline on photographs with a .lp file"),
    "highlights": ("kinran.highlights", "find the lamps from mirror spheres in photographs, and write their .lp"),
    "merge": ("kinran.radiance.merge", "merge one bracket of frames to linear radiance with its noise"),
    "export": ("kinran.radiance.export", "write an EXR for each light of a stack"),
    "relight": ("kinran.relight", "relight a material, and compare with photographs"),
    "render": ("kinran.render", "render a Mitsuba scene with Kinran materials"),
    "native": ("kinran_bsdf.native", "compile the plugin for Mitsuba's own command"),
    "rig": ("kinran.rig.cli", "talk to the goniometer"),
    "bench": ("kinran.bench", "measure speed and accuracy"),
    "test": ("kinran.selftest", "run the tests"),
    "doctor": ("kinran.doctor", "check this machine and say what to do"),
}
"""Commands of users: the module of each, and what it does."""

STAGES = {
    "plan": ("kinran.plan", "plan the shots of a capture"),
    "capture": ("kinran.capture", "shoot a group of the plan"),
    "ingest": ("kinran.ingest", "take photographs as a capture: write its plan"),
    "ingest-group": ("kinran.ingest_group", "take a group of photographs as a capture: write its manifest"),
    "calibrate": ("kinran.radiance.calibrate", "calibrate camera, lamp and colour"),
    "merge-group": ("kinran.radiance.merge_group", "merge the brackets of a group to radiance"),
    "stack": ("kinran.radiance.assemble", "complete the radiance stack"),
    "register": ("kinran.register", "register side views to the front view"),
    "segment": ("kinran.segment", "segment a fabric into regions"),
    "scan": ("kinran.scan", "generate the scan of a draped cloth"),
    "mesh": ("kinran.mesh", "clean and unwrap a scan"),
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
    "scene": ("kinran.scene", "assemble a Mitsuba scene"),
    "chart": ("kinran.chart.stage", "chart accuracy against speed"),
    "chart-table": ("kinran.chart.table", "join the tables of a fabric's methods, and draw them"),
    "chart-regions": ("kinran.chart.regions", "count right labels where the truth is known"),
    "charts": ("kinran.chart.page", "write the page of all charts"),
    "report": ("kinran.report", "write the report of a fabric"),
    "overview": ("kinran.report.overview", "write the overview of all fabrics"),
}
"""Stages of the pipeline, in the order of the data."""

ALL = COMMANDS | STAGES


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    argv = sys.argv[1:] if argv is None else argv
    name = argv[0] if argv else ""
    if name not in ALL:
        top().parse_args(argv)
    to_stderr()
    stage = importlib.import_module(ALL[name][0])  # only the stage that runs is imported
    parser = parser_of(name, stage)
    try:
        args, rest = parser.parse_known_args(argv[1:])
        if name == "test":  # what it does not know is for pytest
            stage.main(rest)
        elif rest:
            parser.error(f"unknown arguments: {' '.join(rest)}")
        elif hasattr(stage, "add_arguments"):
            stage.main(args)
        else:
            words.call(stage.main, args)
    except InputError as error:
        log.error("kinran %s: %s", name, error)
        return 2
    except KeyboardInterrupt:
        log.error("kinran %s: stopped", name)
        return 130
    return 0


def top() -> argparse.ArgumentParser:
    """Parser of `kinran` alone, which shows all commands."""
    description = "From a fabric under known lights to a material that a path tracer renders."
    rows = [f"  {name:15}{summary}" for name, (_, summary) in ALL.items()]
    rows.insert(len(COMMANDS), "\nstages that the workflow runs, in the order of the data:")
    parser = argparse.ArgumentParser(
        prog="kinran",
        usage="kinran [-h] COMMAND …",
        description=description,
        epilog="\n".join(["commands:", *rows, "\nkinran COMMAND --help says what a command takes."]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", metavar="COMMAND", choices=ALL, help=argparse.SUPPRESS)
    return parser


def parser_of(name: str, stage: ModuleType) -> argparse.ArgumentParser:
    """Parser of one command: of several words, its own; else made from the types of its `main`."""
    parser = argparse.ArgumentParser(
        prog=f"kinran {name}",
        description=(stage.__doc__ or ALL[name][1]).strip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if hasattr(stage, "add_arguments"):
        stage.add_arguments(parser)
    else:
        words.add_arguments(parser, stage.main)
    return parser


if __name__ == "__main__":
    sys.exit(main())
