"""A list of directions goes the whole way, from the sheet to the report, stage by stage."""

from pathlib import Path

import numpy as np
import pytest
from known_scene import EXPOSURES, radiance, shoot

from kinran.base.files import read_json
from kinran.calibrate import calibrate
from kinran.capture import plan as plan_stage
from kinran.data.capture_plan import read_plan
from kinran.data.hold_out_rule import held_out
from kinran.data.radiance_stack import Stack
from kinran.fit import fit, material, prior
from kinran.judge import evaluate
from kinran.radiance import merge_group
from kinran.radiance import stack as stack_stage
from kinran.report import drawings
from kinran.segment import segment
from kinran.virtual.sensor import CROSSTALK

CAMERA = CROSSTALK / CROSSTALK.sum(1, keepdims=True)
"""Scene RGB to white-balanced camera RGB."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Folders of the capture and of the results of 20 directions in two groups, of which the first is a batch of 8."""
    base = tmp_path_factory.mktemp("listed")
    captures, out = base / "captures" / "silk", base / "results" / "silk"
    captures.mkdir(parents=True)
    out.mkdir(parents=True)
    rows = [f"{15 + 13 * k % 60},{47 * k % 360}.5,{k // 8 if k < 16 else 1}" for k in range(20)]
    sheet = base / "directions.csv"
    sheet.write_text("\n".join(["theta,phi,group", *rows]) + "\n")
    options = plan_stage.Options("silk", EXPOSURES, directions=sheet, lamp_mm=600.0, field_mm=4.8)
    plan_stage.main(plan_stage.Outputs(captures / "plan.json"), options)
    plan = read_plan(captures / "plan.json")
    manifests = shoot(captures, plan)
    plan_path, calibration, stack = captures / "plan.json", out / "calibration.json", out / "radiance.zarr"
    calibrate.main(calibrate.Inputs(plan_path, tuple(manifests)), calibration)
    for group, manifest in zip(plan.groups, manifests, strict=True):
        if group.lights:
            outputs = merge_group.Outputs(stack, out / "merged" / f"{group.name}.json")
            outputs.receipt.parent.mkdir(exist_ok=True)  # type: ignore[union-attr]
            merge_group.main(merge_group.Inputs(plan_path, calibration, manifest), outputs)
    stack_stage.main(stack_stage.Inputs(plan_path, calibration, tuple(manifests)), stack, stack_stage.Options(4))
    return captures, out


def test_each_light_is_its_own(folders: tuple[Path, Path]) -> None:
    """Shards of the groups, and the mean of all monitors for θ = 0, hold what the scene shows from there."""
    stack = Stack.open(folders[1] / "radiance.zarr")
    plan = read_plan(folders[0] / "plan.json")
    assert [group.lights for group in plan.groups] == [tuple(range(8)), tuple(range(8, 21)), ()]
    values = stack.read_tile(0, 32, 0, 32).value
    assert len(values) == 21
    for i, light in enumerate(plan.lights):
        truth = radiance(np.radians(light.theta), np.radians(light.phi), 32) @ CAMERA.T
        assert np.argmin([np.abs(value - truth).mean() for value in values]) == i


def test_theta_0_is_never_held_out(folders: tuple[Path, Path]) -> None:
    """In a list, too, where every light has its turn by its number: of 29 lights number 28 would be held out by 8."""
    plan = read_plan(folders[0] / "plan.json")
    stack = Stack.open(folders[1] / "radiance.zarr")
    assert set(np.flatnonzero(stack.held_out)) == {2, 6, 10, 14, 18}
    assert plan.lights[-1].grid == (0, 0)
    cells = [None] * 28 + [plan.lights[-1].grid]
    assert 28 not in held_out(cells, 8, "plan.json")
    assert 28 in held_out([None] * 29, 8, "plan.json")


def test_a_material_is_fitted_judged_and_drawn(folders: tuple[Path, Path]) -> None:
    """To the drawing of the lights that stands in the report; the scene and its pictures do not depend on the plan."""
    captures, out = folders
    segment.main(out)
    priors, fitted, slope = out / "prior.json", out / "fit.npz", out / "slope.exr"
    prior.main(prior.Inputs(out), priors, prior.Options(1, "ggx"))
    fit.main(fit.Inputs(out, priors), fitted, fit.Options("slope", 1, "ggx"))
    outputs = material.Outputs(slope, out / "slope.json")
    material.main(material.Inputs(out, (fitted,)), outputs, material.Options("slope", 1, "ggx"))
    judged = evaluate.Outputs(out / "evaluation.json", out / "evaluation.png")
    evaluate.main(evaluate.Inputs(out, (slope,)), judged, evaluate.Options("slope"))
    errors, plan = read_json(judged.errors), read_plan(captures / "plan.json")
    assert len(errors["held_out"]) == 5
    assert drawings.lights(plan, errors["held_out"]).svg("lights").count("<circle") >= len(plan.lights)
