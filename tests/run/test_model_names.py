"""The models that the config can name are those of the plugin."""

import yaml

from kinran.base.project import ROOT
from kinran_bsdf.models import MODELS


def test_config_names_the_models_of_the_plugin() -> None:
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text(encoding="utf-8"))
    fit = schema["properties"]["fit"]
    assert set(fit["properties"]["model"]["enum"]) == set(MODELS)
    assert set(fit["properties"]["compare"]["items"]["enum"]) == set(MODELS)
