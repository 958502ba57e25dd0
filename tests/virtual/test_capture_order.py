"""A capture on the virtual rig does not depend on the order in which its groups are shot."""

import hashlib
import json
import random
import signal
from pathlib import Path

import numpy as np
import pytest
from killed_runs import content
from killed_stages import stages

from kinran.__main__ import main
from kinran.base.distances import Distances
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import Plan, write_plan
from kinran.rig.motion import mdeg
from kinran.virtual.simulated_camera import CACHE
from kinran.virtual.weave import VirtualFabric

SCENE = {"texels": 16, "seed": 5}


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Two groups of eight lights, each with repeats of θ = 0; what the path tracer would say is there already."""
    monkeypatch.chdir(tmp_path)
    plan = plan_grid("swatch", (0, 30), 16, (1 / 25, 1 / 1000), 8, Distances(lamp_mm=600.0, field_mm=4.8))
    fabric = VirtualFabric(**SCENE)
    for shot in (shot for group in plan.groups for shot in group.shots):
        theta, phi = mdeg(shot.theta), mdeg(shot.phi) if shot.theta else 0
        path = CACHE / fabric.digest() / f"{theta}_{phi}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.full((16, 16, 3), 0.3, np.float32))
    return plan


def command(root: Path, group: str, revisions: str = "{}") -> list[str]:
    """The command that captures a group."""
    options = ["--device", "virtual", "--virtual", json.dumps(SCENE), "--revisions", revisions]
    return ["capture", "--plan", str(root / "plan.json"), "--group", group, *options, f"{root}/groups/{group}.json"]


def capture(plan: Plan, folder: str, *groups: str, revisions: str = "{}") -> dict[tuple[str, str, int], str]:
    """Digests of the frames, by group, shot and exposure."""
    root, found = Path(folder), {}
    root.mkdir(exist_ok=True)
    write_plan(root / "plan.json", plan)
    for group in groups:
        manifest = root / "groups" / f"{group}.json"
        manifest.parent.mkdir(exist_ok=True)
        assert main(command(root, group, revisions)) == 0
        for shot in json.loads(manifest.read_text())["shots"]:
            for k, frame in enumerate(shot["frames"]):
                content = hashlib.sha256((root / frame["file"]).read_bytes()).hexdigest()
                found[group, shot["shot"], k] = content
    return found


def test_the_order_of_the_groups_changes_no_frame(plan: Plan) -> None:
    first, second = (group.name for group in plan.groups if group.lights)
    there = capture(plan, "there", first, second)
    assert capture(plan, "back", second, first) == there
    assert len(set(there.values())) == len(there)  # repeats of one direction are no copies of each other


def test_another_code_of_the_rig_is_shot_anew(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every frame of the group, once, at its own time of the lamp; the old ones stay."""
    group = next(group for group in plan.groups if group.lights)
    before = capture(plan, "code", group.name)
    assert capture(plan, "code", group.name) == before
    monkeypatch.setattr("kinran.capture.capture.digest", lambda module: "other")
    for _ in range(2):
        assert capture(plan, "code", group.name) == before
        kept = [hashlib.sha256(path.read_bytes()).hexdigest() for path in Path("code/superseded").rglob("*.dng")]
        assert sorted(kept) == sorted(before.values())


def test_a_frame_that_is_shot_again_has_noise_of_its_own(plan: Plan) -> None:
    group = next(group for group in plan.groups if group.lights)
    name = next(shot.shot for shot in group.shots if shot.kind == "light")
    before = capture(plan, "again", group.name)
    after = capture(plan, "again", group.name, revisions=json.dumps({name: 1}))
    assert {key[1] for key in before if before[key] != after[key]} == {name}


def test_a_killed_capture_takes_the_frames_of_an_undisturbed_one(plan: Plan, tmp_path: Path) -> None:
    """Lamp, noise and time are a shot's own: what the merge reads is the same. The lamp is warm at step 380."""
    group, chance = next(group.name for group in plan.groups if group.lights), random.Random(1)
    there = capture(plan, "there", group)
    Path("killed/groups").mkdir(parents=True)
    write_plan(Path("killed/plan.json"), plan)
    with stages("capture") as run:
        codes = [run.one(tmp_path, command(Path("killed"), group), chance.randint(390, 560))[0] for _ in range(2)]
    assert codes == [-signal.SIGKILL] * 2
    assert capture(plan, "killed", group) == there
    one, two = (content(Path(f"{folder}/groups/{group}.json")) for folder in ("there", "killed"))
    assert one == two
