from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from labpipe.report.drawn_rig import Rig, rig_of
from tests.store.builders_result import build_result


def with_protocol(text: str) -> Rig:
    return rig_of(replace(build_result(cycles=1, half_cycle=1.0), protocol_yaml=text))


def test_rollers_and_span_of_a_conduit(repository: Path) -> None:
    text = (repository / "protocols" / "conduit-bundle.yaml").read_text(encoding="utf-8")
    section = "section: {outer_diameter: 14.1 mm}"
    rig = with_protocol(text.replace(section, f"{section}\n  span: 152.4 mm"))
    assert rig == pytest.approx(Rig(0.1524, 0.005, 0.00705, 0.00855))
    assert rig.reach == pytest.approx(0.01205)


def test_a_cantilever_has_no_rollers(repository: Path) -> None:
    text = (repository / "protocols" / "wire-cantilever.yaml").read_text(encoding="utf-8")
    rig = with_protocol(text)
    assert (rig.span, rig.roller_radius) == (0.0, 0.0)
    assert rig.centre_offset == pytest.approx(0.0008)


@pytest.mark.parametrize("text", ["", "version: 0\nname: of an earlier grammar\n"])
def test_without_a_sound_protocol_nothing_is_known(text: str) -> None:
    assert with_protocol(text) == Rig()
