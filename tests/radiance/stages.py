"""The stages from a plan and its manifests to the radiance stack, called from Python."""

from pathlib import Path

from kinran.radiance import assemble, calibrate, merge_group
from kinran.stack import Stack


def make_stack(work: Path, plan: Path, manifest: Path, holdout: int = 4) -> Stack:
    """Calibrate, merge and put together a set of one group; calibration, receipt and stack go to `work`."""
    calibration, out, receipt = work / "calibration.json", work / "radiance.zarr", work / "00.json"
    calibrate.main(calibrate.Inputs(plan, (manifest,)), calibration)
    merge_group.main(merge_group.Inputs(plan, calibration, manifest), merge_group.Outputs(out, receipt))
    inputs = assemble.Inputs(plan, calibration, (manifest,), (receipt,))
    assemble.main(inputs, out, assemble.Options(holdout))
    return Stack.open(out)
