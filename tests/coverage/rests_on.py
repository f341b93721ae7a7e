"""What the numbers of the study rest on: a digest of the code that makes them.

Comments, docstrings, descriptions of settings and layout are not in the digest, nor is code that
only writes or draws: a module counts if it is imported, at any depth, on the way from recordings to
results, or by the simulator. What a protocol says counts for tests of its kind.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("labpipe", "tests")
PIPELINE = ("labpipe.process.reading", "labpipe.process.story", "labpipe.protocol.load")
SIMULATORS = {
    "foreign": ("tests.judges.foreign.cameras", "tests.judges.foreign.frames"),
    "lab": ("tests.coverage.lab",),
}
LENGTH = 12


def digest(simulator: str, protocol: str) -> str:
    """Of the tests of a simulator under a protocol.

    Parameters
    ----------
    simulator : key of `SIMULATORS`
    protocol : name of a shipped one
    """
    names = sorted({*modules(*PIPELINE), *modules(*SIMULATORS[simulator])})
    parts = [f"{name} {_plain(name)}" for name in names]
    parts.append((ROOT / "protocols" / f"{protocol}.yaml").read_text(encoding="utf-8"))
    return _short("\n".join(parts))


def digest_of(*starts: str) -> str:
    """Of modules with all that they import."""
    return _short("\n".join(f"{name} {_plain(name)}" for name in sorted(modules(*starts))))


def together(digests: list[str]) -> str:
    """One digest for several."""
    return _short(" ".join(sorted(set(digests))))


def _short(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:LENGTH]


@cache
def modules(*starts: str) -> frozenset[str]:
    """Modules of the project that others import, at any depth, and these themselves."""
    found: set[str] = set()
    left = list(starts)
    while left:
        name = left.pop()
        if name not in found and (path := _file(name)) is not None:
            found.add(name)
            left += _imported(name, ast.parse(path.read_text(encoding="utf-8")))
    return frozenset(found)


def _file(name: str) -> Path | None:
    """File of a module of the project; None for a name that is no module."""
    place = ROOT.joinpath(*name.split("."))
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if name.partition(".")[0] in PACKAGES and path.is_file():
            return path
    return None


def _imported(name: str, tree: ast.Module) -> Iterator[str]:
    """Names of modules that a module may import, also within its functions."""
    yield name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{each.name}" for each in node.names)


@cache
def _plain(name: str) -> str:
    """Digest of a module without comments, docstrings and layout."""
    path = _file(name)
    if path is None:
        raise LookupError(name)
    return _short(plain(path.read_text(encoding="utf-8")))


def plain(source: str) -> str:
    """Python without comments, docstrings, descriptions of settings and layout."""
    return ast.dump(_Plain().visit(ast.parse(source)))


class _Plain(ast.NodeTransformer):
    """Takes out words that are for people."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> ast.AST | None:
        return None if node.arg == "description" else self.generic_visit(node)
