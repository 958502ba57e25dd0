"""Stand-ins for packages of others, so that a command can say what it takes without loading them.

What a command takes is in the types of its `main`, which its module has once it is imported; but the packages that it
computes with take seconds to load. The help needs none of them.
"""

import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

OURS = ("kinran", "kinran_bsdf", "benchmarks")
"""Packages of this project."""


class Anything:
    """Stands for a function, a class, an array or a number: what is done with it gives another."""

    def __getattr__(self, name: str) -> "Anything":
        if name.startswith("__"):  # what Python asks of an object
            raise AttributeError(name)
        return Anything()

    def __call__(self, *args: object, **options: object) -> "Anything":
        return Anything()

    def __mro_entries__(self, bases: object) -> tuple[type, ...]:
        return ()

    def __iter__(self) -> Iterator["Anything"]:
        return iter(())

    def __bool__(self) -> bool:
        return False

    def __float__(self) -> float:
        return 0.0

    def _gives_another(self, *others: object) -> "Anything":
        return Anything()

    __getitem__ = __or__ = __ror__ = __neg__ = _gives_another
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __pow__ = __rpow__ = _gives_another
    __truediv__ = __rtruediv__ = __matmul__ = __rmatmul__ = _gives_another


class _Module(ModuleType):
    def __getattr__(self, name: str) -> Anything:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything()


class StandIns:
    """Finds a stand-in for each package that is neither Python's nor this project's."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        top = name.partition(".")[0]
        if top in sys.stdlib_module_names or top in OURS:
            return None
        return ModuleSpec(name, self, is_package=True)  # type: ignore[arg-type]  # importlib.abc takes long to load, too

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _Module(spec.name)

    def exec_module(self, module: ModuleType) -> Any:
        """Nothing is in it."""
