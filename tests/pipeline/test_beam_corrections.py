"""Large deflection and rollers taken off the bending stiffness of a rod whose EI is known."""

from __future__ import annotations

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import parse_protocol
from labpipe.records.result import Result
from tests.builders.three_point import CONDUIT, BendingRecord, reduced

OLD = "corrections: [large-deflection, roller-radius], roller: {diameter: 10 mm}"
WINDOW = ("initial-stiffness, from: 0.2 mm, to: 5 mm", "initial-stiffness, from: 2 mm, to: 15 mm")


def stiffness(corrections: str) -> Result:
    change = (WINDOW, (OLD, corrections))
    return reduced(BendingRecord(), without=("markers",), change=change)[1]["bending_stiffness"]


def test_large_deflection_gives_the_true_value_back() -> None:
    plain, exact = stiffness("corrections: []"), stiffness("corrections: [large-deflection]")

    assert plain.value is not None
    assert exact.value is not None
    assert plain.value < 0.95 * 0.02
    assert exact.value == pytest.approx(0.02, rel=0.01)
    assert exact.interval is not None
    assert exact.interval.lower < 0.02 < exact.interval.upper
    assert "; corrected as an elastic beam: large-deflection +" in exact.method


def test_the_size_of_each_correction_is_said() -> None:
    more = "corrections: [large-deflection, roller-radius, roller-friction]"
    found = stiffness(f"{more}, roller: {{diameter: 10 mm, friction: 0.2}}")

    _, _, said = found.method.partition("corrected as an elastic beam: ")
    names = [each.split()[0] for each in said.split(", ")]
    assert names == ["large-deflection", "roller-radius", "roller-friction"]
    sizes = [float(each.split()[1]) for each in said.split(", ")]
    assert sizes[0] > 0.0 > sizes[1]
    assert sizes[2] < 0.0


@pytest.mark.parametrize(
    ("corrections", "told"),
    [
        (
            "corrections: [roller-radius], roller: {diameter: 10 mm}",
            "expected 'large-deflection' beside 'roller-radius', found none. Add "
            "'large-deflection' to the corrections.",
        ),
        (
            "corrections: [large-deflection, roller-friction], roller: {diameter: 10 mm}",
            "expected 'roller.friction' for 'roller-friction', found none. Add "
            "'roller: {friction: ...}'.",
        ),
        (
            "support: cantilever, corrections: [large-deflection]",
            "expected corrections for 'three-point' alone, found 'cantilever'. Remove them.",
        ),
    ],
)
def test_corrections_without_what_they_need(corrections: str, told: str) -> None:
    text = CONDUIT.read_text(encoding="utf-8")
    if "cantilever" in corrections:
        text = text.replace("support: three-point, ", "")
    with pytest.raises(ProtocolError) as info:
        parse_protocol(text.replace(OLD, corrections), "p.yaml")
    assert told in str(info.value)
