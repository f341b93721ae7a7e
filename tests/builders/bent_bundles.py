"""Two cycles of a taped bundle with the virtual lab's law, which is not the one that is fitted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.protocol.load import format_protocol, load_protocol
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.result import Result, Specimen, TestResult
from labpipe.virtual_lab.specimens import TAPED_TYPES
from tests.builders.bundles import bundle

_PROTOCOL = load_protocol(Path(__file__).resolve().parents[2] / "protocols" / "taped-bundle.yaml")
LENGTH = 0.1143
_TURNS = (1e-4, 0.04, 0.02, 0.04, 0.02)
"""m, where the tip turns; at 20 mm the string still pulls."""
_POINTS = 80


@cache
def bent_bundle() -> TestResult:
    """Seven B1 wires under PET tape as a cantilever: two cycles, kink and no plateau."""
    law = TAPED_TYPES["TWB-B2-7-PET"]
    law = replace(law, wires=(("B1", 7),), locking=1.0)
    branches = [np.linspace(start, stop, _POINTS) for start, stop in pairwise(_TURNS)]
    deflection = np.concatenate(branches)
    force = compute_end_load_path(law.build_law(), LENGTH, deflection).load
    kink = law.slip_curvature * LENGTH**2 / 3.0
    rising = slice(0, _POINTS)
    values = {
        "kink_displacement": (kink, "m"),
        "kink_force": (float(np.interp(kink, deflection[rising], force[rising])), "N"),
    }
    return TestResult(
        test="TWB-1",
        specimen=Specimen("TWB", "s1", "1", {"length": LENGTH}, bundle=bundle(("B1", 7))),
        protocol="taped-bundle",
        protocol_yaml=format_protocol(_PROTOCOL),
        test_yaml="",
        labpipe_version="0",
        inputs=(),
        recordings={},
        aligned=None,
        curve=Curve(
            time=np.arange(len(deflection), dtype=np.float64),
            displacement=deflection,
            force=force,
            branches=tuple(map(_branch, range(len(branches)))),
        ),
        shape=None,
        results=tuple(Result(name, value, unit) for name, (value, unit) in values.items()),
        quality=(),
    )


def _branch(number: int) -> Branch:
    start, stop = number * _POINTS, (number + 1) * _POINTS
    way = Direction.UNLOADING if number % 2 else Direction.LOADING
    return Branch(start, stop, number // 2 + 1, way, float(start), float(stop))
