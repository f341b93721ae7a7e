from __future__ import annotations

import numpy as np

from labpipe.records.group import Campaign
from labpipe.report.page_comparisons import questions
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of


def stems(campaign: Campaign) -> dict[str, str]:
    return {group.name: f"g{at}" for at, group in enumerate(campaign.groups)}


def test_groups_that_differ_in_one_field_are_drawn_together() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    campaign = bundle_campaign(samples)
    (question,) = questions(campaign, stems(campaign))
    assert (question.field, question.name) == ("wire", "Wire")
    assert [row[0].text for row in question.answers.rows] == ["Wire: B2 against B1"]
    (comparison,) = question.comparisons
    means, numbers = comparison.plots
    assert {line.group for line in means.lines} == {"g0", "g1"}
    assert [key.words for key in means.keys] == ["B1 (n = 3)", "B2 (n = 3)"]
    dots = [line for line in numbers.lines if line.look.startswith("dot")]
    group = campaign.groups[0]
    mean = next(each.mean for each in group.numbers if each.name == "bending_stiffness")
    assert mean is not None
    np.testing.assert_allclose(dots[0].x, 1e6 * mean.chosen.mean)
    assert [float(line.y[0]) for line in dots] == [0.0, -1.0]
    assert numbers.y.is_bare


def test_every_question_has_its_pairs_and_tables() -> None:
    campaign = bundle_campaign(conduit_cases())
    found = questions(campaign, stems(campaign))
    assert [each.name for each in found] == ["Wire", "Number", "Taping", "Conduit"]
    for each in found:
        assert len(each.answers.rows) == len(each.tables)
        assert each.comparisons
    assert not questions(Campaign("S", ()), {})
