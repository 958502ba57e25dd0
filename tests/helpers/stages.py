"""The stages from a plan and its manifests to the radiance stack, called from Python."""

from pathlib import Path

from kinran.calibrate import calibrate
from kinran.data.radiance_stack import Stack
from kinran.radiance import merge_group, stack


def make_stack(work: Path, plan: Path, manifest: Path, holdout: int = 4) -> Stack:
    """Calibrate, merge and put together a set of one group; calibration, receipt and stack go to `work`."""
    calibration, out, receipt = work / "calibration.json", work / "radiance.zarr", work / "00.json"
    calibrate.main(calibrate.Inputs(plan, (manifest,)), calibration)
    merge_group.main(merge_group.Inputs(plan, calibration, manifest), merge_group.Outputs(out, receipt))
    inputs = stack.Inputs(plan, calibration, (manifest,), (receipt,))
    stack.main(inputs, out, stack.Options(holdout))
    return Stack.open(out)
