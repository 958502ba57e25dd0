"""Where the workflow lists models by name, they are those of the plugin."""

import re

import yaml

from kinran.code import ROOT
from kinran_bsdf.models import MODELS


def test_config_and_rules_name_the_models_of_the_plugin() -> None:
    fit = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"))["properties"][
        "fit"
    ]
    assert set(fit["properties"]["model"]["enum"]) == set(MODELS)
    assert set(fit["properties"]["compare"]["items"]["enum"]) == set(MODELS)
    wildcard = re.search(r'\bmodel="([\w|]+)"', (ROOT / "workflow/rules/common.smk").read_text(encoding="utf-8"))
    assert wildcard is not None
    assert set(wildcard[1].split("|")) == set(MODELS)
