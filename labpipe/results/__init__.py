"""List all kinds of results of a protocol, each of which is one record.

A new kind is a class in the module of its subject. Grammar, checks, JSON Schema, descriptions
and the reference page derive from `KINDS`.
"""

from __future__ import annotations

from labpipe.results import (
    bending,
    cycles,
    failures,
    kinds,
    kinks_and_plateaus,
    slack_and_slips,
    stiffness,
    tension,
)

_MODULES = kinds, stiffness, kinks_and_plateaus, cycles, failures, slack_and_slips, tension, bending
KINDS: tuple[type[kinds.Kind], ...] = tuple(
    kind
    for module in _MODULES
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, kinds.Kind)
    if kind.__module__ == module.__name__ and hasattr(kind, "result")
)
"""Kinds in the order of the reference page, without base classes, which name no result."""
