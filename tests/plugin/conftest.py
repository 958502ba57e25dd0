"""Variants of the plugin's tests, and the fabrics that they use.

Dr.Jit 1.5 aborts the whole process where libLLVM is 15 or 16: a backend is tried in a process of its own.
A variant that cannot be used here is skipped, unless KINRAN_REQUIRE_VARIANTS names its backend (llvm, cuda).
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plugin_fabrics import random_material

from kinran_bsdf import Material

REQUIRED = set(filter(None, os.environ.get("KINRAN_REQUIRE_VARIANTS", "").split(",")))
RGB = ("scalar_rgb", "llvm_ad_rgb", "cuda_ad_rgb")
JIT = tuple(f"{backend}_ad_{colour}" for backend in ("llvm", "cuda") for colour in ("rgb", "spectral", "mono"))
ALL = ("scalar_rgb", "scalar_spectral", *JIT, "llvm_ad_spectral_polarized", "cuda_ad_spectral_polarized")


@cache
def usable(variant: str) -> bool:
    """Whether a variant runs here: dr.maximum is what aborts."""
    code = (
        f"import mitsuba as mi, drjit as dr; mi.set_variant('{variant}');"
        "x = dr.maximum(mi.Float(1), 2); dr.eval(x); print('usable')"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    return "usable" in run.stdout


def choose(variant: str) -> None:
    backend = variant.split("_")[0]
    if not usable(f"{backend}_rgb" if backend == "scalar" else f"{backend}_ad_rgb"):
        why = f"{variant}: Dr.Jit has no usable backend '{backend}' here"
        if backend in REQUIRED:
            pytest.fail(f"{why}, and KINRAN_REQUIRE_VARIANTS asks for it")
        pytest.skip(why)
    mi.set_variant(variant)


def variants(names: tuple[str, ...]) -> Any:
    @pytest.fixture(params=names)
    def fixture(request: pytest.FixtureRequest) -> Iterator[str]:
        choose(request.param)
        yield request.param
        if not request.param.startswith("scalar"):
            dr.sync_thread()

    return fixture


variant_rgb = variants(RGB)
variant_jit = variants(JIT)
variant_any = variants(ALL)
variant_of_bands = variants(tuple(name for name in ALL if "spectral" not in name))
jit = variants(("llvm_ad_rgb", "cuda_ad_rgb"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run tests of one variant together: a switch costs time."""

    def variant(item: pytest.Item) -> str:
        params = getattr(getattr(item, "callspec", None), "params", {})
        return next((str(v) for k, v in params.items() if k.startswith("variant") or k == "jit"), "")

    here = [k for k, item in enumerate(items) if "plugin" in item.path.parts]
    for k, item in zip(here, sorted((items[k] for k in here), key=variant), strict=True):
        items[k] = item


@pytest.fixture
def fabric() -> Callable[..., Material]:
    return random_material


@pytest.fixture
def lights() -> np.ndarray:
    """Directions of lights above 8° of elevation, N among them."""
    rng = np.random.default_rng(7)
    vectors = rng.normal(size=(40, 3))
    vectors[:, 2] = np.abs(vectors[:, 2]) + 0.2
    vectors[0] = 0, 0, 1
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
