"""Mutants: one small fault each in a module of the pure layers."""

from __future__ import annotations

import ast
import hashlib
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

LAYERS = (
    *("results", "fits", "bending", "signal", "markers"),
    *("statistics", "wire", "uncertainty", "law"),
)
SEED, COUNT = 20261122, 400
"""Fixed before the first run."""
_COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
_COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}


@dataclass(frozen=True)
class Mutant:
    """A fault at one place: which module, where, and what became of what."""

    module: str
    line: int
    column: int
    change: str
    source: str

    @property
    def key(self) -> str:
        """Names the fault and the text of the module that it was made in."""
        digest = hashlib.sha256(self.source.encode()).hexdigest()[:12]
        return f"{self.module}:{self.line}:{self.column} {self.change} [{digest}]"

    @property
    def text(self) -> str:
        """The module with the fault."""
        tree = ast.parse(self.source)
        for node, change in sites(tree):
            at = (getattr(node, "lineno", 0), getattr(node, "col_offset", 0))
            if at == (self.line, self.column) and change == self.change:
                mutate(node, change)
                return ast.unparse(tree)
        raise ValueError(self.key)


def sites(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Places at which a fault can be made, and what it is, in the order of the text."""
    for node in ast.walk(tree):
        match node:
            case ast.Compare(ops=[op]) if type(op) in _COMPARED:
                yield node, f"{type(op).__name__} to {_COMPARED[type(op)].__name__}"
            case ast.BinOp(op=op) if type(op) in _COMPUTED and not _is_text(node):
                yield node, f"{type(op).__name__} to {_COMPUTED[type(op)].__name__}"
            case ast.BoolOp(op=op):
                yield node, "And to Or" if isinstance(op, ast.And) else "Or to And"
            case ast.UnaryOp(op=ast.Not()):
                yield node, "Not dropped"
            case ast.Constant(value=value) if _is_number(node):
                yield node, f"{value!r} to {_other(value)!r}"
            case ast.IfExp():
                yield node, "branches swapped"


def mutate(node: ast.AST, change: str) -> None:
    """Make the fault that `sites` has named."""
    match node:
        case ast.Compare(ops=[op]):
            node.ops = [_COMPARED[type(op)]()]
        case ast.BinOp(op=operator):
            node.op = _COMPUTED[type(operator)]()
        case ast.BoolOp():
            node.op = ast.Or() if change == "And to Or" else ast.And()
        case ast.UnaryOp(op=ast.Not()):
            node.operand, node.op = ast.Call(ast.Name("bool"), [node.operand], []), ast.UAdd()
        case ast.Constant(value=value):
            node.value = _other(value)
        case ast.IfExp():
            node.body, node.orelse = node.orelse, node.body


def sampled(package: Path) -> list[Mutant]:
    """Draw the mutants, the same ones for the same text of the package."""
    found = []
    for layer in LAYERS:
        for path in sorted((package / layer).rglob("*.py")):
            source = path.read_text(encoding="utf-8")
            module = path.relative_to(package).as_posix()
            for node, change in sites(ast.parse(source)):
                line, column = getattr(node, "lineno", 0), getattr(node, "col_offset", 0)
                found.append(Mutant(module, line, column, change, source))
    return random.Random(SEED).sample(sorted(found, key=lambda each: each.key), COUNT)


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(each, ast.JoinedStr)
        or (isinstance(each, ast.Constant) and isinstance(each.value, str))
        for each in ast.walk(node)
    )


def _other(value: object) -> float:
    """Another number: one more, or half as much again."""
    if isinstance(value, int):
        return value + 1
    return 1.5 * float(str(value)) or 1.0
