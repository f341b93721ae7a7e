"""A small virtual campaign of stranded wires, processed once: two samples of A2, one of B1."""

from __future__ import annotations

from pathlib import Path

from labpipe.cli import main
from labpipe.virtual_lab.stranded import WIRES
from labpipe.virtual_lab.wire_campaign import WireCampaign, WireGroup, simulate_wires

CAMPAIGN = WireCampaign(
    groups=(WireGroup(WIRES["A2"], 0.085), WireGroup(WIRES["B1"], 0.1)),
    samples=2,
    fps=25.0,
    cycles=2,
    has_mishaps=False,
)


def processed_wires(home: Path) -> Path:
    """Folder with the processed tests."""
    raw, out = home / "raw" / "wires", home / "processed" / "wires"
    for test in simulate_wires(CAMPAIGN, raw, seed=3):
        main(["process", str(test), "--out", str(out), "--no-figures"])
    return out
