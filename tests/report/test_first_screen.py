from __future__ import annotations

from dataclasses import replace

from labpipe.records.curve import Interval
from labpipe.records.group import Campaign
from labpipe.report.first_screen import answers, count_words, fold, key_blocks, to_decide
from labpipe.report.page_facts import PageTests
from labpipe.report.ranked_causes import find_causes
from tests.builders.bundle_campaigns import bundle_campaign, bundle_of, conduit_cases, three_of
from tests.builders.campaigns import build_campaign, build_group, build_sample, six_samples


def test_pairs_are_folded_by_their_question() -> None:
    found = {each.field: each for each in answers(bundle_campaign(conduit_cases()))}
    number = found["wire"]
    assert number.question == "Wire: B1, B1 & B2, B2"
    assert number.verdict.startswith("DIFFERENT ")
    assert number.difference.startswith("Bending stiffness +")
    assert number.difference.endswith(f", largest of {len(number.pairs.rows)} pairs")
    assert number.counts == "3 v 3"
    assert not answers(Campaign("S", ()))


def test_the_only_pair_of_a_question_stands_with_its_words() -> None:
    samples = [*three_of(bundle_of("7 B1")), *three_of(bundle_of("7 B2"))]
    (only,) = answers(bundle_campaign(samples))
    assert (only.question, only.verdict) == ("Wire: B2 against B1", "DIFFERENT")
    assert "largest" not in only.difference
    low, high = only.difference.split("(")[1].rstrip(")").split(" to ")
    assert float(low.rstrip(" %")) < 100.0 * (1.4 / 0.9 - 1.0) < float(high.rstrip(" %"))


def test_key_numbers_of_each_protocol() -> None:
    campaign = build_campaign()
    (block,) = key_blocks(campaign, ["a", "b", "c"])
    assert block.heads == (
        "Peak force, cycle 1 (N)", "Stiffness, first region (N/mm)",
        "Stiffness, second region (N/mm)",
    )  # fmt: skip
    assert [(row.name, row.n) for row in block.rows] == [
        ("twist-tube-10", 6), ("twist-tube-7", 1), ("twist-tube-5", 0),
    ]  # fmt: skip
    first, lone, empty = block.rows
    assert "\u00b1" in first.numbers[0].text
    assert "\u00b1" in lone.numbers[0].text  # how well the one test was measured
    assert "one test" in lone.numbers[0].tip
    assert [cell.text for cell in empty.numbers] == ["\u2013"] * 3
    assert first.spark is not None
    assert (empty.spark, empty.strip) == (None, None)
    other = replace(campaign.groups[1], protocol="another")
    two = key_blocks(replace(campaign, groups=(campaign.groups[0], other)), ["a", "b"])
    assert [len(each.rows) for each in two] == [1, 1]


def test_what_is_to_be_decided_until_somebody_did() -> None:
    campaign = build_campaign()
    tests = PageTests(campaign, ["a", "b", "c"])
    open_ones = to_decide(find_causes(campaign), tests)
    assert {each.line.head for each in open_ones} == {"Failed", "Doubtful", "Outlier"}
    assert count_words(campaign, open_ones).endswith(" 3 to decide")
    first = campaign.groups[0]
    decided = [replace(each, decided="fine (me)") for each in first.samples]
    settled = replace(campaign, groups=(replace(first, samples=tuple(decided)),))
    assert not to_decide(find_causes(settled), PageTests(settled, ["a"]))
    assert count_words(settled, []).endswith(" 0 to decide")


def test_the_screen_holds_what_there_is_room_for() -> None:
    groups = tuple(build_group(f"A{n}", [build_sample("s", "a")]) for n in range(2))
    blocks = key_blocks(Campaign("S", groups), ["a", "b"])
    assert fold(5, blocks, 1).groups >= 19
    crowded = fold(40, blocks, 30)
    assert (crowded.answers, crowded.decisions) == (8, 4)
    assert 3 <= crowded.groups < fold(0, blocks, 0).groups


def test_a_group_whose_values_are_alike_is_drawn() -> None:
    samples = six_samples()[:1] * 3
    (block,) = key_blocks(Campaign("S", (build_group("A", samples),)), ["a"])
    assert block.rows[0].strip is not None


def test_an_estimate_that_stands_apart_is_in_the_tooltip() -> None:
    group = build_group("A", six_samples()[:3])
    number = group.numbers[0]
    assert number.mean is not None
    chosen = replace(
        number.mean.chosen, mean=140.0, interval=Interval(130.0, 132.0), estimate=131.0
    )
    odd = replace(number, mean=replace(number.mean, chosen=chosen))
    (block,) = key_blocks(Campaign("S", (replace(group, numbers=(odd,)),)), ["a"])
    (cell,) = block.rows[0].numbers
    assert cell.text == "140.0 (130.0 to 132.0)"
    assert cell.tip == "interval of the estimate 131.0"
