"""Variants of the plugin's tests, and the fabrics that they use.

A backend is tried in a process of its own, since a wrong libLLVM aborts it (`kinran.base.probes`).
A variant that cannot be used here is skipped, unless KINRAN_REQUIRE_VARIANTS names its backend (llvm, cuda).
"""

import os
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plugin_fabrics import random_material

from kinran.base.probes import variant_fault
from kinran_bsdf import Material

REQUIRED = set(filter(None, os.environ.get("KINRAN_REQUIRE_VARIANTS", "").split(",")))
RGB = ("scalar_rgb", "llvm_ad_rgb", "cuda_ad_rgb")
JIT = tuple(f"{backend}_ad_{colour}" for backend in ("llvm", "cuda") for colour in ("rgb", "spectral", "mono"))
ALL = ("scalar_rgb", "scalar_spectral", *JIT, "llvm_ad_spectral_polarized", "cuda_ad_spectral_polarized")


fault_of = cache(variant_fault)


def choose(variant: str) -> None:
    backend = variant.split("_")[0]
    if fault := fault_of(f"{backend}_rgb" if backend == "scalar" else f"{backend}_ad_rgb"):
        why = f"{variant}: Dr.Jit has no usable backend '{backend}' here ({fault})"
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
