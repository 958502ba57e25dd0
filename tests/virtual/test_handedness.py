"""From threads to the stack: nothing is mirrored or turned on the way."""

from pathlib import Path

import numpy as np
import pytest

from kinran.base.distances import Distances
from kinran.calibrate import calibrate
from kinran.capture import capture
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import write_plan
from kinran.data.radiance_stack import Stack
from kinran.radiance import merge_group
from kinran.radiance import stack as stack_stage
from kinran.virtual import simulated_camera
from kinran.virtual.weave import VirtualFabric

SCENE = {"texels": 24, "samples": 16, "field_mm": 4.8, "lamp_mm": 600.0, "seed": 7}


def test_the_figure_lands_in_its_corner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plan, capture, calibrate, merge, stack: each light is what was traced, and no mirror image of it."""
    monkeypatch.chdir(tmp_path)
    plan_path = tmp_path / "captures/weave/plan.json"
    plan = plan_grid("weave", (0, 30, 60), 4, (1 / 25, 1 / 100, 1 / 250, 1 / 1000, 1 / 4000), 4, Distances(600.0, 4.8))
    write_plan(plan_path, plan)
    manifests = [plan_path.parent / "groups" / f"{group.name}.json" for group in plan.groups]
    for group, manifest in zip(plan.groups, manifests, strict=True):
        capture.main(capture.Inputs(plan_path), manifest, capture.Options(group.name, "virtual", SCENE))
    calibration, out = tmp_path / "calibration.json", tmp_path / "radiance.zarr"
    calibrate.main(calibrate.Inputs(plan_path, tuple(manifests)), calibration)
    merge_group.main(merge_group.Inputs(plan_path, calibration, manifests[0]), merge_group.Outputs(out))
    stack_stage.main(stack_stage.Inputs(plan_path, calibration, tuple(manifests)), out, stack_stage.Options(4))

    stack = Stack.open(out)
    values = stack.read_tile(0, 24, 0, 24).value
    fabric = VirtualFabric(**SCENE)
    for index, light in enumerate(plan.lights):  # every light is what was traced for it
        theta, phi = round(1000 * light.theta), round(1000 * light.phi)
        traced = fabric.frame(theta, phi, simulated_camera.CACHE)
        colours = np.einsum("ij,yxj->yxi", stack.to_acescg, values[index])
        for turned in (traced[::-1], traced[:, ::-1], traced.transpose(1, 0, 2), traced[::-1, ::-1]):
            assert np.abs(colours - traced).mean() < 0.6 * np.abs(colours - turned).mean()
    middle = values[-1]
    blueness = middle[..., 2] / middle.sum(-1)
    row, column = np.unravel_index(np.argmax(blueness), blueness.shape)
    assert row < 12
    assert column < 12
