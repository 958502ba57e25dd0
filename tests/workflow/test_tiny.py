"""The tiny project of `.test`, which users run, too."""

import re

import yaml
from conftest import ROOT, TINY


def test_its_scene_is_the_project_s_with_a_smaller_picture() -> None:
    """So what the tests render is what users render."""
    defaults = re.compile(r'(<default name="(?:width|height|spp)" value=)"[0-9]+"')
    shipped, small = ((path.read_text()) for path in (ROOT / "scenes" / "drape.xml", TINY / "small.xml"))
    assert small != shipped
    assert defaults.sub(r"\1", small) == defaults.sub(r"\1", shipped)


def test_the_catalog_reads_how_the_workflow_is_used() -> None:
    usage = yaml.safe_load((ROOT / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    assert usage["report"] is True
    assert set(usage) == {"mandatory-flags", "software-stack-deployment", "report"}
    assert set(usage["mandatory-flags"]) == {"desc", "flags"}
    assert usage["software-stack-deployment"]["apptainer"] is True
