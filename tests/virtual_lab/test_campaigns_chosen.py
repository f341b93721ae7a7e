from __future__ import annotations

import pytest

from labpipe.virtual_lab import ChosenTests, TensileCampaign, WireCampaign

CAMPAIGNS = (WireCampaign(), TensileCampaign())


def test_chosen_tests_are_as_in_their_campaigns() -> None:
    names = ("twist-tube-2b", "pet-tape-3", "B1-100-5")
    chosen = list(ChosenTests(CAMPAIGNS, names).scenarios(seed=3))
    all_of_them = [each for campaign in CAMPAIGNS for each in campaign.scenarios(seed=3)]
    assert [scenario.name for scenario, _ in chosen] == ["B1-100-5", "twist-tube-2b", "pet-tape-3"]
    assert chosen == [each for each in all_of_them if each[0].name in names]


def test_names_the_tests_that_no_campaign_has() -> None:
    chosen = ChosenTests(CAMPAIGNS, ("A9-085-1", "pet-tape-3"))
    with pytest.raises(KeyError, match="A9-085-1"):
        list(chosen.scenarios())
