"""A small virtual campaign of stranded wires, processed once: two samples of A2, one of B1."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from labpipe.cli import main
from labpipe.virtual_lab import simulate_campaigns, simulate_test
from labpipe.virtual_lab.campaigns import WireCampaign, WireGroup
from labpipe.virtual_lab.specimens import WIRES

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
    for test in simulate_campaigns([CAMPAIGN], raw, seed=3):
        main(["process", str(test), "--out", str(out), "--no-figures"])
    return out


def processed_rest(home: Path, slack: float) -> Path:
    """Folder of a processed test of A2 whose wire hung under the counterweight at rest.

    Parameters
    ----------
    home : everything is made in it
    slack : m, travel of the clamp before the string pulls
    """
    one = replace(CAMPAIGN, groups=CAMPAIGN.groups[:1], samples=1)
    ((scenario, seed),) = one.scenarios(3)
    hung = replace(scenario, name="A2-085-hung", mechanics=replace(scenario.mechanics, slack=slack))
    test = simulate_test(hung, home / "raw" / hung.name, seed)
    main(["process", str(test), "--out", str(home / "processed"), "--no-figures"])
    return home / "processed" / hung.name
