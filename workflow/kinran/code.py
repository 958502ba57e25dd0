"""Digest of a module and of everything that it imports from this project.

A rule holds it as a parameter, so that a job runs again when the code that it calls changes, and not when a
comment, the layout or a file's time stamp does. Imports are resolved on the file system, without importing.
"""

import ast
import functools
import hashlib
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"kinran": ROOT / "workflow" / "kinran", "kinran_bsdf": ROOT / "plugins" / "kinran_bsdf"}
IGNORED = {tokenize.COMMENT, tokenize.NL, tokenize.ENCODING}


@functools.cache
def digest(module: str) -> str:
    """Return twelve hexadecimal digits that change when the code behind `module` does.

    Raises
    ------
    ModuleNotFoundError
        No such module in this project.
    """
    sources: dict[str, bytes] = {}
    todo = [module]
    while todo:
        name = todo.pop()
        path = _file(name)
        if path is None or name in sources:
            continue
        sources[name], imports = _read(path, name)
        todo += imports
    if module not in sources:
        raise ModuleNotFoundError(module)
    whole = hashlib.sha256()
    for name, tokens in sorted(sources.items()):
        whole.update(name.encode() + b"\0" + tokens + b"\0")
    return whole.hexdigest()[:12]


@functools.cache
def _read(path: Path, module: str) -> tuple[bytes, tuple[str, ...]]:
    """Tokens of a module, and what it imports."""
    source = path.read_text(encoding="utf-8")
    return _tokens(source), tuple(_imports(ast.parse(source), module, path.name == "__init__.py"))


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
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _tokens(source: str) -> bytes:
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    words = ("\t" if t.type == tokenize.INDENT else t.string for t in tokens if t.type not in IGNORED)
    return "\0".join(words).encode()
