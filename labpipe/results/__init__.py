"""All kinds of results of a protocol, as one record each.

A new one is a dataclass in the module of its family, and its name in the list at the end of that
module; grammar, checks, JSON Schema, descriptions and reference page derive from `KINDS`.
"""

from __future__ import annotations

from labpipe.results import (
    beam,
    cycles,
    failures,
    kinds,
    plateau,
    shapes,
    slack_and_slips,
    stiffness,
    two_lines,
)
from labpipe.results.kinds import Kind

KINDS: tuple[type[Kind], ...] = (
    *kinds.KINDS,
    *stiffness.KINDS,
    *two_lines.KINDS,
    *cycles.KINDS,
    *failures.KINDS,
    *slack_and_slips.KINDS,
    *plateau.KINDS,
    *beam.KINDS,
    *shapes.KINDS,
)
"""In the order of the reference page."""
