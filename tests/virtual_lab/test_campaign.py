"""A small campaign: samples differ, seeds repeat."""

from __future__ import annotations

import json
from pathlib import Path

from labpipe.virtual_lab.campaign import campaign_scenarios, simulate_campaign
from labpipe.virtual_lab.scenario import WireModel


def test_campaign_on_disk(tmp_path: Path) -> None:
    folders = simulate_campaign(tmp_path, samples=2, rate=100.0)
    assert [folder.name for folder in folders] == ["A2-085-1", "A2-085-2"]
    truths = [json.loads((folder / "truth.json").read_text("utf-8")) for folder in folders]
    peaks = [truth["cycles"][0]["peak_force"] for truth in truths]
    assert peaks[0] != peaks[1]
    assert all(1.0 < peak < 1.5 for peak in peaks)
    assert truths[0]["clock"] != truths[1]["clock"]


def test_samples_of_a_spool_scatter_mildly_and_reproducibly() -> None:
    scenarios = campaign_scenarios(samples=3, rate=1000.0, scatter=0.03, seed=1)
    again = campaign_scenarios(samples=3, rate=1000.0, scatter=0.03, seed=1)
    other = campaign_scenarios(samples=3, rate=1000.0, scatter=0.03, seed=2)
    assert scenarios == again != other
    wires = [scenario.mechanics.wire for scenario in scenarios]
    stiffness = {wire.stick_stiffness for wire in wires if isinstance(wire, WireModel)}
    assert len(stiffness) == 3
    assert all(abs(value / 5e-3 - 1) < 0.12 for value in stiffness)
    assert [s.sample for s in scenarios] == [1, 2, 3]
    assert {s.spool for s in scenarios} == {"A2-s1"}
