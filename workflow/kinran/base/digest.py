"""Digest of a module and of all that it uses of this project: modules that it imports, templates that it names.

A rule holds it as a parameter, so that a job runs again when the code that it calls changes, and not when a
comment, a docstring, the help of an option, the layout or a file's time stamp does. Imports are resolved on the file
system, without importing.

A package's `__init__` counts where a name is taken from it, and not where an import only leads through it: those of
this project hold a docstring, hand names on, or say where compiled code is kept.

Some modules of `base` never count (`BESIDE`), and a rule can name more that do not count for it: they move files, check
them or talk, and decide no value in a result.
"""

import ast
import functools
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

from kinran.base.project import ROOT

TEMPLATE = re.compile(r"""["']([\w-]+\.html)["']""")
"""Pattern of a template's name in quotes, as a module or another template refers to it."""
PACKAGES = {
    "kinran": ROOT / "workflow" / "kinran",
    "kinran_bsdf": ROOT / "plugins" / "kinran_bsdf",
    "benchmarks": ROOT / "benchmarks",
}
"""Folders of the packages that a digest looks into."""
BESIDE = frozenset(f"kinran.base.{name}" for name in ("checksums", "command_line", "digest", "files", "log", "project"))
"""Modules that no digest holds: they write a file under a temporary name and rename it, read it back and check it,
parse a command line, tell how far a stage is, and find code. No value that a stage computes depends on how."""


@functools.cache
def digest(module: str, *beside: str) -> str:
    """Return twelve hexadecimal digits that change when the code behind `module` does.

    Parameters
    ----------
    module
        Name of the module.
    beside
        Names of modules that do not count for this digest, nor what only they import.

    Raises
    ------
    ModuleNotFoundError
        The project has no such module.
    """
    whole = hashlib.sha256()
    for name, content in sorted(_contents(modules(module, *beside)).items()):
        whole.update(name.encode() + b"\0" + content.encode() + b"\0")
    return whole.hexdigest()[:12]


def modules(module: str, *beside: str) -> list[str]:
    """Return the sorted names of the modules that a digest holds: a module, and those that it imports, directly or not.

    Parameters and errors are those of `digest`.
    """
    if unknown := next((name for name in beside if not _file(name)), None):
        raise ModuleNotFoundError(unknown)
    found: set[str] = set()
    todo = [module]
    while todo:
        name = todo.pop()
        if name not in found and name not in BESIDE.union(beside) and _file(name):
            found.add(name)
            todo += imports(name)
    if module not in found:
        raise ModuleNotFoundError(module)
    return sorted(found)


def imports(module: str) -> list[str]:
    """Return the modules of this project that a module imports itself: a submodule, not its package."""
    return [name for name in _read(module)[1] if _file(name)]


def _contents(names: list[str]) -> dict[str, str]:
    """Return, by name, the syntax of modules and the text of the templates beside them that they or templates name."""
    found = {name: _read(name)[0] for name in names}
    folders = {path.parent for name in names if (path := _file(name))}
    todo = list(found.values())
    while todo:
        for template in TEMPLATE.findall(todo.pop()):
            for path in (folder / template for folder in folders):
                name = f"{path.parent.name}/{path.name}"
                if name not in found and path.is_file():
                    found[name] = path.read_text(encoding="utf-8")
                    todo.append(found[name])
    return found


@functools.cache
def _read(module: str) -> tuple[str, tuple[str, ...]]:
    """Return the syntax of a module as text, and the names that it imports."""
    path = _file(module)
    assert path
    tree = _Running().visit(ast.parse(path.read_text(encoding="utf-8")))
    return ast.dump(tree), tuple(_imports(tree, module, path.name == "__init__.py"))


class _Running(ast.NodeTransformer):
    """The part of a module's syntax that runs: no docstrings, no help texts, no imports for type checkers alone."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:  # a docstring, a constant's too, is a string alone
        return None if _is_text(node.value) else self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | None:
        if ast.unparse(node.test).removeprefix("typing.") == "TYPE_CHECKING":
            node.body = []
        return self.generic_visit(node) if node.body or node.orelse else None

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if ast.unparse(node.value) == "Annotated" and isinstance(node.slice, ast.Tuple):
            node.slice.elts = [part for part in node.slice.elts if not _is_text(part)]
        return self.generic_visit(node)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _file(module: str) -> Path | None:
    package, *parts = module.split(".")
    if package not in PACKAGES:
        return None
    base = PACKAGES[package].joinpath(*parts)
    return next((path for path in (base / "__init__.py", base.with_suffix(".py")) if path.is_file()), None)


def _imports(tree: ast.AST, module: str, is_package: bool) -> Iterator[str]:
    parents = module.split(".") if is_package else module.split(".")[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = parents[: len(parents) - node.level + 1] if node.level else []
            base = ".".join(above + (node.module.split(".") if node.module else []))
            inside = [f"{base}.{alias.name}" for alias in node.names]
            yield from (name if _file(name) else base for name in inside)
