"""Compile the plugin with `python -m kinran_bsdf.native`, where nothing but this package is installed."""

import argparse

from kinran_bsdf import native

parser = argparse.ArgumentParser(prog="kinran_bsdf.native", description=native.__doc__)
native.add_arguments(parser)
native.main(parser.parse_args())
