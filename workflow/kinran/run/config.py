"""The configuration: checked by schema, with defaults filled in, and with what a fabric has of its own."""

import copy
import functools
import shlex
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.capture.directions import Directions, read_directions
from kinran.fit.few_lights import FEW_LIGHTS

ADAPTIVE = "adaptive"
"""The plan of a rig whose fabrics have a sheet of directions each, which `kinran propose` appends to."""
OWN = ("rig", "virtual", "fit", "scene", "holdout")
"""Sections of the config that a fabric may have of its own."""
ONE_RIG = ("device", "camera", "usb", "serial", "speeds", "accelerations", "homing_s", "backlash", "photodiode")
"""Settings of the section `rig` that no fabric has of its own: there is one rig, and all fabrics lie on it in turn."""
SCHEMAS = ROOT / "workflow" / "schemas"


def lobes_of(fit: dict[str, Any], lights: int) -> tuple[int, str] | None:
    """Number and tail of a fabric's slope lobes: those of its section `fit`, but one GGX lobe under few lights.

    None where `kinran choice` chooses them for each fabric. With few directions two lobes explode: on a path-traced
    brocade under 29 lights their held-out error was 1.17, that of one lobe less than that of the four steps, 0.99.
    """
    if fit["lobes"] == "choose":
        return None
    if lights < FEW_LIGHTS:
        return 1, "ggx"
    return fit["lobes"], fit["tail"]


def check(value: dict[str, Any], schema: str, where: str) -> None:
    """Check a value against a schema of `workflow/schemas` and fill in the defaults.

    Raises
    ------
    InputError
        The value does not fit the schema.
    """
    rules = read_schema(schema)
    _fill(value, rules)
    error = jsonschema.exceptions.best_match(jsonschema.Draft202012Validator(rules).iter_errors(value))
    if error is not None:
        at = ".".join(str(part) for part in error.absolute_path)
        raise InputError(
            f"{where}: {at + ': ' if at else ''}{error.message}; see workflow/schemas/{schema}.schema.yaml"
        )


@functools.cache
def read_schema(name: str) -> dict[str, Any]:
    """Return a schema of `workflow/schemas`, which is not to be changed."""
    rules: dict[str, Any] = yaml.safe_load((SCHEMAS / f"{name}.schema.yaml").read_text(encoding="utf-8"))
    return rules


def _fill(value: dict[str, Any], rules: dict[str, Any]) -> None:
    for key, rule in rules.get("properties", {}).items():
        if "default" in rule:
            value.setdefault(key, copy.deepcopy(rule["default"]))
        if isinstance(value.get(key), dict):
            _fill(value[key], rule)


def own_settings(config: dict[str, Any], cells: dict[str, str], where: str) -> tuple[dict[str, Any], str]:
    """Return the sections of the config with what a fabric has of its own, and the file that has it.

    Parameters
    ----------
    config
        The config, checked.
    cells
        The fabric's row of the sheet.
    where
        Sheet and line, for messages.

    Raises
    ------
    InputError
        The file is wrong, or its row names one that is not there.
    """
    named = cells.get("settings", "")
    path = Path(named) if named else Path(config["fabrics"]).parent / "fabrics" / f"{cells['fabric']}.yaml"
    shared = {name: config[name] for name in OWN}
    if not path.exists():
        if named:
            raise InputError(f"{where}: settings: {path} is no file; correct it, or leave the cell empty")
        return shared, "config.yaml"
    try:
        own = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read ({' '.join(str(error).split())}); correct it") from None
    if not isinstance(own, dict):
        raise InputError(f"{path}: has no sections; it takes {', '.join(OWN)} as config.yaml has them")
    if others := [name for name in own if name not in OWN]:
        raise InputError(f"{path}: '{others[0]}' is no section of a fabric; it takes {', '.join(OWN)}")
    rig = own.get("rig")
    if isinstance(rig, dict) and (machine := [name for name in ONE_RIG if name in rig]):
        raise InputError(
            f"{path}: rig.{machine[0]}: is the same for all fabrics, as there is one rig; set it in config.yaml"
        )
    merged = _merge(config, own)
    check(merged, "config", str(path))
    return {name: merged[name] for name in OWN}, str(path)


def _merge(shared: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return shared settings with a fabric's own in their place; what is no mapping is replaced as a whole."""
    merged = copy.deepcopy(shared)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both else value
    return merged


def sheet_of(rig: dict[str, Any], fabric: str) -> Path | None:
    """Return the sheet of a fabric's directions by the section `rig` of the config; None for a grid."""
    if rig["plan"] == "grid":
        return None
    return Path(f"captures/{fabric}/directions.tsv" if rig["plan"] == ADAPTIVE else rig["plan"])


def rig_directions(rig: dict[str, Any], fabric: str) -> Directions | None:
    """Return the directions of a fabric's sheet; None for a grid.

    Raises
    ------
    InputError
        The sheet is wrong, or not yet there.
    """
    sheet = sheet_of(rig, fabric)
    if rig["plan"] == ADAPTIVE and sheet and not sheet.exists():
        raise InputError(f"{sheet}: is not there yet; kinran adaptive begins it, and adds to it")
    return None if sheet is None else read_directions(sheet)


def directions_options(rig: dict[str, Any], fabric: str) -> str:
    """Return the options of `kinran plan` for the directions of the light."""
    if sheet := sheet_of(rig, fabric):
        return f"--directions {shlex.quote(str(sheet))}"
    thetas = ",".join(f"{theta:g}" for theta in rig["thetas"])
    return f"--thetas {thetas} --phis {rig['phis']} --meridians {rig['meridians']}"


def motion_options(rig: dict[str, Any]) -> str:
    """Return the options of `kinran plan` for the motion of the rig, as far as the config states it."""
    options = [f"--backlash {rig['backlash']:g}"] if rig["backlash"] else []
    for name in ("speeds", "accelerations"):
        if rig.get(name):
            options.append(f"--{name} {','.join(f'{value:g}' for value in rig[name])}")
    if not rig["photodiode"]:
        options.append("--no-photodiode")
    return " ".join(options)
