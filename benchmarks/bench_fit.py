"""Error and speed of the fit: `python benchmarks/bench_fit.py --out FILE.json`."""

import argparse

from kinran.bench import fit

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    fit.add_arguments(parser)
    fit.main(parser.parse_args())
