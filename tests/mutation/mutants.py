"""Mutants: one small fault each in a module of the pure layers."""

from __future__ import annotations

import ast
import copy
import hashlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

LAYERS = (
    *("results", "signal", "markers"),
    *("statistics", "uncertainty", "mechanics/wire", "mechanics/law"),
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
_BLOCKS = ("body", "orelse", "finalbody")
_Owner = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Mutant:
    """A fault in one statement: what stood there, and what stands there now.

    Nothing in it depends on where in the file the function stands, so that it is the same fault as
    long as the statement reads the same.

    Parameters
    ----------
    module : below the package, as ``signal/filters.py``
    function : dotted name in the module; empty for a statement outside functions and classes
    was, now : the statement before and after; of a compound one its head
    nth : counts faults in a function that read the same, from 1
    digest : fingerprint of the function without its docstring and its layout
    place : counts the places of the module at which a fault can be made
    lines : of the statement; none where it runs as the module is imported
    source : text of the module
    """

    module: str
    function: str
    was: str
    now: str
    nth: int
    digest: str
    place: int = field(compare=False)
    lines: range = field(compare=False)
    source: str = field(compare=False, repr=False)

    @property
    def key(self) -> str:
        """Names the fault, in one line."""
        nth = f" ({self.nth})" if self.nth > 1 else ""
        return f"{self.module} {self.function or '-'}: {self.was}  =>  {self.now}{nth}"

    @property
    def is_at_import(self) -> bool:
        """Whether the statement runs as the module is imported."""
        return not self.lines or self.was.startswith(("def ", "@"))

    @property
    def rank(self) -> str:
        """Where it stands in the order in which faults are drawn."""
        key = self.key.removeprefix("mechanics/")
        return hashlib.sha256(f"{SEED} {key}".encode()).hexdigest()

    @property
    def room(self) -> str:
        """Folder of its tests."""
        return self.module.removeprefix("mechanics/").partition("/")[0]

    @property
    def tree(self) -> ast.Module:
        """The module with the fault, its lines numbered as in its file."""
        tree = ast.parse(self.source)
        place = list(places(tree))[self.place]
        mutate(place.node, place.change)
        return ast.fix_missing_locations(tree)


@dataclass(frozen=True)
class Place:
    """Where a fault can be made: in which statement of which function, at what, and which."""

    function: str
    owner: ast.AST
    statement: ast.stmt
    node: ast.AST
    change: str

    @property
    def lines(self) -> range:
        """Lines of the statement, of a function those of its body; none outside functions."""
        if not isinstance(self.owner, ast.FunctionDef | ast.AsyncFunctionDef):
            return range(0)
        if self.statement is self.owner:
            return range(self.owner.body[0].lineno, (self.owner.end_lineno or 0) + 1)
        first, body = self.statement.lineno, getattr(self.statement, "body", None)
        last = max(first, body[0].lineno - 1) if body else self.statement.end_lineno or first
        return range(first, last + 1)


def sampled(package: Path) -> list[Mutant]:
    """Draw the mutants: those of lowest rank, so that a change adds and takes away its own alone.

    Parameters
    ----------
    package : folder of the layers
    """
    mutants = [
        mutant
        for layer in LAYERS
        for path in sorted((package / layer).rglob("*.py"))
        for mutant in mutants_of(
            path.relative_to(package).as_posix(), path.read_text(encoding="utf-8")
        )
    ]
    return sorted(mutants, key=lambda finding: finding.rank)[:COUNT]


def mutants_of(module: str, source: str) -> Iterator[Mutant]:
    """Every mutant of a module."""
    seen: Counter[tuple[str, str, str]] = Counter()
    digests: dict[ast.AST, str] = {}
    for number, place in enumerate(places(ast.parse(source))):
        was = _head(place.statement)
        with _mutated(place):
            now = _head(place.statement)
        seen[place.function, was, now] += 1
        if place.owner not in digests:
            digests[place.owner] = _digest(place.owner)
        digest = digests[place.owner] if place.function else ""
        nth = seen[place.function, was, now]
        yield Mutant(module, place.function, was, now, nth, digest, number, place.lines, source)


def places(tree: ast.Module) -> Iterator[Place]:
    """Places at which a fault can be made, in the order of the text."""
    for function, owner, statement in _statements(tree, "", tree):
        for node, change in sites(_bare(statement)):
            yield Place(function, owner, statement, node, change)


def sites(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Nodes of a tree at which a fault can be made, and what it is."""
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
            node.operand, node.op = (
                ast.Call(ast.Name("bool", ast.Load()), [node.operand], []),
                ast.UAdd(),
            )
        case ast.Constant(value=value):
            node.value = _other(value)
        case ast.IfExp():
            node.body, node.orelse = node.orelse, node.body


@contextmanager
def _mutated(place: Place) -> Iterator[None]:
    before = dict(vars(place.node))
    mutate(place.node, place.change)
    yield
    vars(place.node).update(before)


def _statements(
    block: ast.AST, function: str, owner: ast.AST
) -> Iterator[tuple[str, ast.AST, ast.stmt]]:
    """Every statement below a node, with the function or class that it stands in."""
    for node in ast.iter_child_nodes(block):
        if isinstance(node, _Owner):
            name = f"{function}.{node.name}" if function else node.name
            yield name, node, node
            yield from _statements(node, name, node)
            continue
        if isinstance(node, ast.stmt):
            yield function, owner, node
        if isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield from _statements(node, function, owner)


def _bare(statement: ast.stmt) -> ast.stmt:
    """A statement without the statements in it; what is left are the nodes of the statement."""
    bare: Any = copy.copy(statement)
    for name in _BLOCKS:
        if getattr(bare, name, None):
            setattr(bare, name, [ast.Pass()] if name == "body" else [])
    if isinstance(bare, ast.Try):
        bare.handlers, bare.finalbody = [], [ast.Pass()]
    if isinstance(bare, ast.Match):
        bare.cases = [ast.match_case(case.pattern, case.guard, [ast.Pass()]) for case in bare.cases]
    return bare  # type: ignore[no-any-return]


def _head(statement: ast.stmt) -> str:
    """Text of a statement without the statements in it, in one line."""
    lines = ast.unparse(_bare(statement)).splitlines()
    return " ".join(line.strip() for line in lines if line.strip() != "pass")


def _digest(owner: ast.AST) -> str:
    """Fingerprint of a function or class, without its docstring and its layout."""
    if not isinstance(owner, _Owner):
        return ""
    bare = copy.copy(owner)
    told = ast.get_docstring(owner, clean=False) is not None
    bare.body = owner.body[1:] if told and len(owner.body) > 1 else owner.body
    return hashlib.sha256(ast.dump(bare).encode()).hexdigest()[:12]


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(node, ast.JoinedStr)
        or (isinstance(node, ast.Constant) and isinstance(node.value, str))
        for node in ast.walk(node)
    )


def _other(value: object) -> float:
    """Another number: one more, or half as much again."""
    if isinstance(value, int):
        return value + 1
    return 1.5 * float(str(value)) or 1.0
