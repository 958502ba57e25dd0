"""Kinran on the command line: `python -m kinran STAGE …`; every stage can be run by hand."""

import argparse
import gc
import importlib
import logging
import sys
from types import ModuleType

from kinran.base import command_line as words
from kinran.base.end_with_run import end_with_run
from kinran.base.files import InputError, disk_fault
from kinran.base.log import to_stderr
from kinran.base.stand_ins import StandIns

log = logging.getLogger("kinran")

COMMANDS = {
    "demo": ("kinran.run.demo", "run the whole pipeline on the virtual rig"),
    "adaptive": ("kinran.run.adaptive", "shoot and fit fabrics group by group, each where the fit is least sure"),
    "rti": ("kinran.run.rti", "run the pipeline on photographs with a .lp file"),
    "highlights": (
        "kinran.capture.highlights",
        "find the lamps from mirror spheres in photographs, and write their .lp",
    ),
    "lights": ("kinran.capture.lights", "show the lights of photographs; drop or turn some, and write their .lp"),
    "merge": ("kinran.bracket.merge", "merge one bracket of frames to linear radiance with its noise"),
    "export": ("kinran.radiance.export", "write an EXR for each light of a stack"),
    "relight": ("kinran.judge.relight", "relight a material, and compare with photographs"),
    "render": ("kinran.scene.render", "render a Mitsuba scene with Kinran materials"),
    "native": ("kinran_bsdf.native", "compile the plugin for Mitsuba's own command"),
    "rig": ("kinran.capture.rig", "talk to the goniometer"),
    "verify": ("kinran.run.verify", "check captures and results for damage, and say what to run"),
    "bench": ("kinran.run.bench", "measure speed and accuracy"),
    "test": ("kinran.run.test", "run the tests"),
    "compile": ("kinran.run.compile", "compile what stages run, once for an installation"),
    "doctor": ("kinran.run.doctor", "check this machine and say what to do"),
}
"""Commands of users: the module of each, and what it does."""

STAGES = {
    "plan": ("kinran.capture.plan", "plan the shots of a capture"),
    "capture": ("kinran.capture.capture", "shoot a group of the plan"),
    "ingest": ("kinran.capture.ingest", "take photographs as a capture: write its plan"),
    "ingest-group": ("kinran.capture.ingest_group", "take a group of photographs as a capture: write its manifest"),
    "calibrate": ("kinran.calibrate.calibrate", "calibrate camera, lamp and colour"),
    "merge-group": ("kinran.radiance.merge_group", "merge the brackets of a group to radiance"),
    "stack": ("kinran.radiance.stack", "complete the radiance stack"),
    "register": ("kinran.register.register", "register side views to the front view"),
    "segment": ("kinran.segment.segment", "segment a fabric into regions"),
    "scan": ("kinran.virtual.scan", "generate the scan of a draped cloth"),
    "mesh": ("kinran.scene.mesh", "clean and unwrap a scan"),
    "need": ("kinran.scene.need", "say what a scene needs of a fabric"),
    "coarsen": ("kinran.radiance.coarsen", "average the texels that a scene cannot tell apart"),
    "choice": ("kinran.fit.choice", "choose the simplest lobes that explain a fabric"),
    "prior": ("kinran.fit.prior", "find the regions' priors for the fit"),
    "fit": ("kinran.fit.fit", "fit a model to a run of tiles"),
    "material": ("kinran.fit.material", "join fitted runs to a material"),
    "residual": ("kinran.fit.residual", "add a residual where it pays"),
    "sigma": ("kinran.fit.sigma", "map how well the lights fix a material"),
    "normals": ("kinran.fit.normals", "find surface normals from a stack"),
    "evaluate": ("kinran.judge.evaluate", "judge materials on held-out lights"),
    "propose": ("kinran.run.propose", "propose the directions of a fabric's next group"),
    "scene": ("kinran.scene.scene", "assemble a Mitsuba scene"),
    "chart": ("kinran.compare.chart", "chart accuracy against speed"),
    "chart-table": ("kinran.compare.chart_table", "join the tables of a fabric's methods, and draw them"),
    "chart-regions": ("kinran.compare.chart_regions", "count right labels where the truth is known"),
    "chart-page": ("kinran.compare.chart_page", "write the page of all charts"),
    "report": ("kinran.report.report", "write the report of a fabric"),
    "overview": ("kinran.report.overview", "write the overview of all fabrics"),
}
"""Stages of the pipeline, in the order of the data."""

ALL = COMMANDS | STAGES


def main(argv: list[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    whole, argv = argv is None, sys.argv[1:] if argv is None else argv
    name = argv[0] if argv else ""
    if name not in ALL:
        top().parse_args(argv)
    to_stderr()
    if whole and {"-h", "--help"} & set(argv):  # the process ends with the help
        sys.meta_path.insert(0, StandIns())
    stage = (imported if whole else importlib.import_module)(ALL[name][0])  # only the stage that runs is imported
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
    except MemoryError:
        log.error("kinran %s: memory has run out; run fewer jobs at once (--cores), or ask for more of it", name)
        return 2
    except OSError as error:
        if not (fault := disk_fault(error)):
            raise
        log.error("kinran %s: %s: %s and run it again", name, error.filename or "a file", fault)
        return 2
    return 0


def imported(name: str) -> ModuleType:
    """Import a module for as long as the process lives: none of what it makes is ever looked at as garbage.

    That takes a fifth of the time of most imports, and most of the time in which a process ends.
    """
    gc.disable()
    module = importlib.import_module(name)
    gc.freeze()
    gc.enable()
    return module


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
    end_with_run()
    sys.exit(main())
