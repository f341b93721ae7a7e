"""Rig of a test in figures of shapes: rollers, and the offset of markers from the axis."""

from __future__ import annotations

from typing import NamedTuple

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.result import TestResult
from labpipe.results.beam import BendingStiffness


class Rig(NamedTuple):
    """Support of a specimen.

    Parameters
    ----------
    span : m, between supports; 0 for a clamped specimen
    roller_radius : m; 0 if not stated
    section_radius : m, half the outer diameter of the specimen; 0 if not stated
    centre_offset : m, from the axis to the centres of the markers, positive towards the pull
    """

    span: float = 0.0
    roller_radius: float = 0.0
    section_radius: float = 0.0
    centre_offset: float = 0.0

    @property
    def reach(self) -> float:
        """Distance from the axis of the specimen to the axis of a roller, m."""
        return self.roller_radius + self.section_radius


def rig_of(result: TestResult) -> Rig:
    """Return the rig of a test from its protocol.

    Parameters
    ----------
    result : with its resolved protocol; without one, or with one of an earlier grammar that is no
        longer valid, the rig is empty
    """
    try:
        protocol = parse_protocol(result.protocol_yaml, result.test)
    except ProtocolError:
        return Rig()
    sizes, section = protocol.specimen, protocol.specimen.section
    rollers = [
        result.roller.diameter or 0.0
        for result in protocol.results
        if isinstance(result, BendingStiffness) and result.roller is not None
    ]
    depth = section.outer_diameter if section is not None else None
    beside = protocol.markers.centre_offset if protocol.markers is not None else 0.0
    return Rig(sizes.span or 0.0, 0.5 * max(rollers, default=0.0), 0.5 * (depth or 0.0), beside)
