"""What jobs ask of a cluster, and how many of them it gets; `./kinran test slurm` runs them on one."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Project

PROFILES = ROOT / "profiles"
RULES = sorted((ROOT / "workflow" / "rules").glob("*.smk"))
WITHOUT_COST = {"chart", "charts", "chart_fabric", "stability", "register"}
"""Rules that only collect, or that are not of one fabric."""


def rules() -> dict[str, str]:
    """Text of each rule by its name."""
    text = "\n".join(path.read_text() for path in RULES)
    return {part.split(":")[0]: part for part in re.split(r"^rule ", text, flags=re.MULTILINE)[1:]}


@pytest.mark.parametrize("path", RULES, ids=lambda path: path.stem)
def test_no_rule_asks_for_all_cores_of_the_run(path: Path) -> None:
    """On a cluster there are none, and the workflow would not even be read."""
    assert "workflow.cores" not in path.read_text()


@pytest.mark.parametrize("name", rules())
def test_a_rule_says_what_its_jobs_take(name: str) -> None:
    text = rules()[name]
    if name in local_rules() | WITHOUT_COST:
        return
    assert f'memory_of("{name}")' in text
    assert f'runtime_of("{name}"' in text


def planned(project: Project, profile: str, folder: Path, *options: str) -> str:
    """Dry run with a profile, less what names the executor: groups and resources are Snakemake's own."""
    settings = yaml.safe_load((PROFILES / profile / "profile.yaml").read_text())
    executor = settings.pop("executor")
    own = {key: value for key, value in settings.items() if not key.startswith(executor)}
    folder.mkdir(exist_ok=True)
    (folder / "profile.yaml").write_text(yaml.safe_dump(own))
    return project.run("--profile", str(folder), "--dry-run", *options)


def submissions(text: str) -> dict[str, int]:
    """Submissions of a dry run by group or rule: a group is one, and jobs that run locally are none."""
    found: dict[str, int] = {}
    for name in re.findall(r"^\[.*\] Group job (\w+)", text, re.MULTILINE) + re.findall(
        r"^rule (\w+):", text, re.MULTILINE
    ):
        found[name] = found.get(name, 0) + 1
    return {name: count for name, count in found.items() if name != "all" and name not in local_rules()}


def local_rules() -> set[str]:
    """Rules whose jobs run where Snakemake does."""
    return {name for name, text in rules().items() if "localrule: True" in text}


@pytest.mark.parametrize("profile", ["slurm", "generic"])
def test_a_fabric_of_the_papers_grid_is_a_few_submissions(tmp_path: Path, profile: str) -> None:
    project = Project(tmp_path / "project")
    grid = {"thetas": list(range(0, 85, 5)), "phis": 72}
    project.configure(
        lambda config: (config["rig"].update(grid), config["fit"].update(compare=["takeda2008", "lambert"], jobs=2))
    )
    text = planned(project, profile, tmp_path / "profile")
    jobs = dict(re.findall(r"^(\w+) +(\d+)$", text, re.MULTILINE))
    assert (jobs["merge"], jobs["fit"]) == ("18", "6")
    sent = submissions(text)
    own = {"calibrate": 1, "merge_tiny": 3, "before_tiny": 1, "fit_tiny": 2, "after_tiny": 1}
    assert sent == {"mesh_generated": 1, **own}
    assert sum(sent.values()) <= 9


def test_groups_hold_whatever_the_config_asks_for(tmp_path: Path) -> None:
    """A group that waits for a job which waits for the group is refused by Snakemake."""
    project = Project(tmp_path / "project")
    asked = {"lobes": "choose", "residual": "all", "texels": "needed", "regions": "needed"}
    project.configure(lambda config: config["fit"].update(asked))
    text = planned(project, "slurm", tmp_path / "profile")
    own = {"calibrate", "merge_tiny", "before_tiny", "fit_tiny", "after_tiny"}
    assert set(submissions(text)) == {"mesh_generated", *own}


def test_members_of_a_group_take_turns(tmp_path: Path) -> None:
    """The executor runs them so: a group asks for its widest member, and for all their times."""
    for profile in ("slurm", "generic"):
        settings = yaml.safe_load((PROFILES / profile / "profile.yaml").read_text())
        assert settings["default-resources"]["turn"] == 1
        assert settings["set-resource-scopes"] == {"turn": "local"}
    assert yaml.safe_load((PROFILES / "default" / "profile.yaml").read_text())["resources"]["turn"] == 1


def test_profiles_share_no_key() -> None:
    """Of a key in both, Snakemake takes the one of profiles/default without a word."""
    default, slurm, generic = (
        set(yaml.safe_load((PROFILES / name / "profile.yaml").read_text())) for name in ("default", "slurm", "generic")
    )
    assert not default & slurm
    assert not default & generic


def test_a_failure_is_repeated_on_a_cluster_alone() -> None:
    """A local run whose input is wrong says so once."""
    settings = {path.parent.name: yaml.safe_load(path.read_text()) for path in PROFILES.glob("*/profile.yaml")}
    assert {name: profile.get("retries", 0) for name, profile in settings.items()} == {
        "default": 0,
        "generic": 2,
        "slurm": 2,
    }
    assert not re.search(r"^ +retries:", "\n".join(rules().values()), re.MULTILINE)


@pytest.mark.parametrize(("profile", "executor"), [("slurm", "slurm"), ("generic", "cluster_generic")])
@pytest.mark.parametrize("action", ["--dry-run", "--unlock"])
def test_the_profile_is_read_without_cores(tmp_path: Path, profile: str, executor: str, action: str) -> None:
    if importlib.util.find_spec(f"snakemake_executor_plugin_{executor}") is None:
        pytest.skip(f"snakemake_executor_plugin_{executor} is not installed; `./kinran test slurm` runs this with it")
    project = Project(tmp_path / "project")
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(project.folder)]
    done = subprocess.run(
        [*command, "--profile", str(PROFILES / profile), action], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
