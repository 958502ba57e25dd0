"""The methods of the chart, one module for each kind: a new file adds a kind, and only its job runs."""

import importlib
import pkgutil

from kinran.compare.method import FAMILIES, Method


def kinds() -> list[str]:
    """Names of the modules."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__))


def of(kind: str) -> tuple[Method, ...]:
    """Methods of a module."""
    found: tuple[Method, ...] = importlib.import_module(f"{__name__}.{kind}").METHODS
    return found


def methods() -> list[Method]:
    """All methods, by family."""
    return sorted((method for kind in kinds() for method in of(kind)), key=lambda m: FAMILIES.index(m.family))
