"""Pulls of crimps: limits of a card, kinds of separation, peaks of pulls that slip or are cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ProtocolError
from labpipe.process.story import Reduction, reduce_recordings
from labpipe.protocol.grammar import read_limit_card
from labpipe.protocol.load import load_test_sheet, parse_protocol, resolve_protocol
from labpipe.protocol.yaml_text import FaultsError
from labpipe.records.arrays import Floats
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, Specimen
from labpipe.results.failures import ForceLimit
from labpipe.statistics.lots import judge_sample
from labpipe.virtual_lab import observe
from labpipe.virtual_lab.tensile import build_crimp_pull
from tests.builders.tensile_tests import reduced_in_memory

PROTOCOL = (Path(__file__).parents[2] / "protocols/crimp-pull.yaml").read_text(encoding="utf-8")
CARD_ENTRY = "{result: force-limit, card: crimp-pull, column: silver-tin}"
MEASURED: dict[int, tuple[float, list[float]]] = {
    12: (489.5, [568]),
    14: (311.5, [412.4]),
    16: (222.3, [240, 236.9]),
    18: (142, [182, 200, 199.3, 432]),
    20: (89, [130, 130, 141, 149.5, 287]),
    22: (53.4, [91.45]),
    24: (35.6, [67]),
    26: (22.3, [33.65]),
    28: (13.4, [14.35]),
}
"""Limit and largest forces, N, by AWG, as the public report prints them."""


def pulled(
    force: Floats, conductor: str, entry: str = CARD_ENTRY, separation: str = "slip"
) -> Reduction:
    """Reduce a pull at 25 mm/min with 20 samples per second."""
    time = np.arange(len(force)) / 20.0
    path = np.maximum(time - 1.0, 0.0) * 25e-3 / 60.0
    values: dict[str, tuple[str, str, Floats]] = {
        "force": ("Load", "N", force),
        "displacement": ("Crosshead", "m", path),
    }
    channels = tuple(
        Channel(name, where, numbers, unit=unit) for name, (where, unit, numbers) in values.items()
    )
    recording = Recording("load-frame", clocks=(Clock("time", time),), channels=channels)
    labels = {"conductor": conductor} if conductor else {}
    observed = {"separation": separation} if separation else {}
    specimen = Specimen("c", "r", "1", labels=labels, observed=observed)
    protocol = parse_protocol(PROTOCOL.replace(CARD_ENTRY, entry), "p.yaml")
    return reduce_recordings({"frame": recording}, protocol, specimen=specimen)


def rising(peak: float, *, then: float = 0.0) -> Floats:
    """A force that rises to its peak in 4 s and then goes to a share of it."""
    force = np.concatenate([np.zeros(20), np.linspace(0.0, peak, 80)])
    force = np.append(force, np.full(20, then * peak))
    noise: Floats = np.random.default_rng(1).normal(0.0, 1e-4 * peak, len(force))
    return force + noise


def named(reduced: Reduction) -> dict[str, Result]:
    return {result.name: result for result in reduced.results}


@pytest.mark.parametrize("awg", MEASURED)
def test_every_row_of_the_report_is_judged_as_printed(awg: int) -> None:
    limit, forces = MEASURED[awg]
    for force in forces:
        results = named(pulled(rising(force), f"AWG {awg}"))
        assert results["force_limit"].value == limit
        share = results["peak_over_limit"]
        assert share.value == pytest.approx(force / limit, rel=1e-3)
        assert str(judge_sample(share).value_answer) == "pass"


OWN = "{result: force-limit, at_least: 60 N, conductor: AWG 22}"
OWN_CARD = (
    "{result: force-limit, column: c, card: {source: lab, rows: "
    "[{awg: 20, section: 0.5 mm^2, limits: {c: 70 N}}]}}"
)
NICKEL = CARD_ENTRY.replace("silver-tin", "nickel")
NO_LIMIT = [
    ("", CARD_ENTRY, "no_conductor", "found none"),
    ("0.5 mm", CARD_ENTRY, "no_conductor", "0.5 mm"),
    ("0.5 mm^2", CARD_ENTRY, "section_not_in_card", "AWG 22 (0.324 mm^2) and AWG 20 (0.519 mm^2)"),
    ("AWG 21", CARD_ENTRY, "section_not_in_card", "AWG 20 (0.519 mm^2) and AWG 22 (0.324 mm^2)"),
    ("4 mm^2", CARD_ENTRY, "section_not_in_card", "AWG 12"),
    ("AWG 18", NICKEL, "limit_not_given", "silver-tin, third, stamped"),
    ("AWG 20", CARD_ENTRY.replace("silver-tin", "gold"), "limit_not_given", "nickel"),
    ("AWG 20", OWN, "other_section", "AWG 22"),
]


@pytest.mark.parametrize(("conductor", "entry", "code", "said"), NO_LIMIT)
def test_without_a_limit_there_is_no_verdict_but_a_reason(
    conductor: str, entry: str, code: str, said: str
) -> None:
    results = named(pulled(rising(100.0), conductor, entry))
    share = results["peak_over_limit"]
    assert share.codes == (code,)
    assert said in share.reason_text
    assert judge_sample(share).text == "cannot tell"
    assert results["peak_force.1"].value == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("conductor", "entry", "limit"),
    [
        ("20 AWG", CARD_ENTRY, 89.0),
        ("0.519 mm^2", NICKEL, 84.6),
        ("awg 22", OWN, 60.0),
        ("", "{result: force-limit, at_least: 60 N}", 60.0),
        ("0.5 mm^2", OWN_CARD, 70.0),
    ],
)
def test_limits_of_cards_and_of_the_lab(conductor: str, entry: str, limit: float) -> None:
    assert named(pulled(rising(100.0), conductor, entry))["force_limit"].value == limit


def test_a_kind_of_separation_that_is_not_stated_makes_the_verdict_doubtful() -> None:
    reduced = pulled(rising(130.0), "AWG 20", separation="")
    share = named(reduced)["peak_over_limit"]
    assert share.codes == ("question_open",)
    assert "contact broken outside" in share.reason_text
    assert judge_sample(share).text == "pass (cannot tell with its interval)"
    assert named(reduced)["peak_force.1"].codes == ()
    assert "question_open" in {note.code for note in reduced.reduced_test.findings.notes}


def test_a_pull_that_is_cut_is_doubtful() -> None:
    share = named(pulled(rising(130.0)[:100], "AWG 20"))["peak_over_limit"]
    assert "partial_cycle" in share.codes


def test_a_sample_that_slips_and_takes_up_again_has_the_larger_peak() -> None:
    first, again = rising(80.0)[:100], rising(95.0)[20:]
    results = named(pulled(np.concatenate([first, again]), "AWG 20"))
    assert results["peak_over_limit"].value == pytest.approx(95.0 / 89.0, rel=2e-3)
    place = results["displacement_at_peak_force.1"].value
    assert place is not None
    assert place > 2.5e-3


@pytest.mark.parametrize("separation", ["slip", "conductor broken in crimp"])
def test_peaks_of_virtual_crimps_lie_in_their_intervals(separation: str) -> None:
    is_inside = {"peak_force.1": 0, "displacement_at_peak_force.1": 0}
    seeds = range(10)
    for seed in seeds:
        scenario = build_crimp_pull(
            "c", seed, strength=130.0, conductor="AWG 20", separation=separation
        )
        test = observe(scenario, seed)
        protocol = parse_protocol(PROTOCOL, "p.yaml")
        results = {result.name: result for result in reduced_in_memory(test, protocol)}
        truth = test.truth["peak_force"], test.truth["peak_displacement"] - test.truth["foot"]
        for name, true in zip(is_inside, truth, strict=True):
            interval = results[name].interval
            assert interval is not None
            is_inside[name] += interval.lower <= true <= interval.upper
    assert min(is_inside.values()) >= 9, is_inside


SHEET = """\
test: c-1
protocol: crimp-pull
specimen: {type: c, spool: r, sample: 1, observed: {ANSWER}}
files: {frame: c.txt}
"""


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("separation: slipped", "'slip'"),
        ("separation: slipped", "'contact broken outside'"),
        ("seperation: slip", "separation"),
    ],
)
def test_a_wrong_answer_lists_the_valid_ones(answer: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "test.yaml"
    path.write_text(SHEET.replace("ANSWER", answer), encoding="utf-8")
    with pytest.raises(ProtocolError) as caught:
        resolve_protocol(load_test_sheet(path), path, Path(__file__).parents[2] / "protocols")
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("{result: force-limit}", "at_least"),
        ("{result: force-limit, card: crimp-pull}", "column"),
        ("{result: force-limit, card: crimp-push, column: x}", "crimp-pull"),
        (OWN[:-1] + ", card: crimp-pull, column: nickel}", "at_least"),
    ],
)
def test_a_limit_is_stated_once(entry: str, said: str) -> None:
    with pytest.raises(ProtocolError, match=said):
        parse_protocol(PROTOCOL.replace(CARD_ENTRY, entry), "p.yaml")


def test_a_protocol_holds_its_card_with_the_source() -> None:
    (limit,) = (
        entry
        for entry in parse_protocol(PROTOCOL, "p.yaml").results
        if isinstance(entry, ForceLimit)
    )
    assert limit.card is not None
    assert limit.card.source.startswith("NICOMATIC")
    assert [row.awg for row in limit.card.rows] == list(range(30, 10, -2))
    assert "nickel" not in limit.card.rows[6].limits
    with pytest.raises(FaultsError):
        read_limit_card("no-card")
