"""All kinds of results of a protocol, as one record each.

A new one is a dataclass in the module of its family; grammar, checks, JSON Schema, descriptions and
reference page derive from `KINDS`.
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

_FAMILIES = (
    *(kinds, stiffness, kinks_and_plateaus, cycles),
    *(failures, slack_and_slips, tension, bending),
)
KINDS: tuple[type[kinds.Kind], ...] = tuple(
    kind
    for family in _FAMILIES
    for kind in vars(family).values()
    if isinstance(kind, type) and issubclass(kind, kinds.Kind)
    if kind.__module__ == family.__name__ and hasattr(kind, "result")
)
"""Kinds in the order of the reference page; a base class, which names no result, is not one."""
