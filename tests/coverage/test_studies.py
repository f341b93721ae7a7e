"""The studies: what they draw, how they judge, what voids their rows, what is kept."""

from __future__ import annotations

from dataclasses import replace
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.mechanics.law.sliders import SliderLaw
from labpipe.mechanics.wire.calibration.law_components import make_loading_table, split_law
from labpipe.mechanics.wire.first_loading import find_equilibria
from tests.builders.three_point import ElasticModel
from tests.coverage import lab_bending, line_judgement, study
from tests.coverage.drawn_lines import KINDS as LINES
from tests.coverage.drawn_lines import NODES, draw
from tests.coverage.judgement import (
    Held,
    Row,
    Verdict,
    counted,
    holm,
    judged,
)
from tests.coverage.line_judgement import ASKED
from tests.coverage.study import BY_KIND, STUDIES, Cost, Study, append, differences
from tests.coverage.true_lines import PreparedLine, held_at, true_line, true_stops
from tests.coverage.wire_campaigns import (
    DEEPEST,
    POINTS,
    TRUTH,
    rig_of,
    true_curve,
    wire_of,
)
from tests.coverage.wire_judgement import NAMES, too_seldom
from tests.judges.foreign import wire_section as foreign
from tests.judges.foreign.processed import chance_of


def band(name: str, truth: float, *, half: float = 0.1, value: float = 1.0, **more: Any) -> Row:
    ends = {"lower": value - half, "upper": value + half}
    return {"name": name, "status": "ok", "value": value, "truth": truth, **ends, **more}


def test_holm_by_the_usual_example() -> None:
    """Four hypotheses at 5 %: 0.005 < 0.0125, 0.01 < 0.0167, but 0.03 > 0.025 ends it.

    The chance of 26 of 30 or fewer is one less that of 27 and more.
    """
    assert holm([0.01, 0.04, 0.03, 0.005], 0.05) == [True, False, False, True]
    more = sum(comb(30, k) * 0.95**k * 0.05 ** (30 - k) for k in range(27, 31))
    assert Held(26, 30).chance == pytest.approx(1.0 - more)
    assert judged([Held(182, 182), Held(180, 182)]) == [Verdict.WIDE, Verdict.HOLDS]
    assert judged([Held(5, 19)]) == [Verdict.FEW]


def test_how_often_a_result_holds_and_how_wide_it_is() -> None:
    """Errors of 1 and 10 in two noises, intervals of twice the ideal in each."""
    random = np.random.default_rng(3)
    results = [
        (noise, band("slack", 0.0, half=2.0 * 1.96 * size, value=9.0, estimate=float(off)))
        for noise, size in (("white", 1.0), ("pink", 10.0))
        for off in size * random.standard_normal(4000)
    ]
    empty = {**band("slack", 0.0), "lower": None, "upper": None}
    parts = [[-0.1, 0.1], [3.0, 4.0]]
    results += [("", empty), ("", band("slack", 3.5, status="doubtful", parts=parts))]
    results += [("", band("slack", 0.0, status="failed"))]
    rows = [
        {"kind": BAR, "about": {"noise": noise, "fault": ""}, "rows": [each]}
        for noise, each in results
    ]
    (found,) = counted([*rows, {**rows[0], "about": {"noise": "white", "fault": "slip"}}])
    assert (found.ok, found.doubtful, found.failed) == (Held(4000, 8001), Held(1, 1), 1)
    assert found.width == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("own", STUDIES, ids=lambda own: own.name)
def test_a_page_says_what_is_counted_of_the_kept_rows(own: Study) -> None:
    """All tables of all pages: shares, verdicts, widths, faults and noises."""
    page = (study.ROOT / "docs" / "explanations" / own.page).read_text(encoding="utf-8")
    shown = page.partition(f"<!-- {own.name}: begin -->")[2].partition(f"<!-- {own.name}: end")[0]
    assert shown.strip() == study.published(own, study.kept_rows(own.seeds))
    assert "| **too" not in shown, "an interval that holds too seldom is not explained"


@pytest.mark.parametrize(("tenths", "is_seldom"), [(10, False), (9, False), (8, True)])
def test_what_holds_too_seldom(tenths: int, *, is_seldom: bool) -> None:
    """Nine of ten of 60 is chance, eight of ten is not."""
    kinds = {"calibrations": list(NAMES), "lines": list(ASKED)}
    rows = {
        study_name: [
            {
                "kind": "push",
                "about": {"notes": []},
                "rows": [
                    band(name, 1.0 if seed % 10 < tenths else 5.0, status="identified")
                    for name in names
                ],
            }
            for seed in range(60)
        ]
        for study_name, names in kinds.items()
    }
    parameters = too_seldom(rows["calibrations"])
    held = Held(6 * tenths, 60)
    assert parameters == {("push", name): (held, is_seldom) for name in NAMES}
    assert line_judgement.judged(rows["lines"]) == dict.fromkeys(ASKED, is_seldom)


def test_an_elastic_bar_is_as_stiff_as_itself() -> None:
    """On rollers that rub, at deflections that are not small."""
    rig = lab_bending.conduit_bundle(0).test
    stiffness = lab_bending.windowed(replace(rig, bundle=ElasticModel(0.03)))
    assert lab_bending.as_elastic_bar(rig, stiffness) == pytest.approx(0.03, rel=1e-4)
    assert stiffness * rig.span**3 / 48.0 != pytest.approx(0.03, rel=0.01)


KEYS = ("truth", "value", "lower", "upper", "status")
BAR, TAPE = "lab/stiff-bar", "lab/pet-tape"


def kept_row(kind: str, seed: int, value: float = 1.0, **more: Any) -> dict[str, Any]:
    result = {"name": "compliance", "truth": 1.0, "value": value, "lower": 0.9, "upper": 1.1}
    made = {"kind": kind, "seed": seed, "commit": "abc", "seconds": 2.0, "error": "", "about": {}}
    return {**made, "rows": [{**result, "status": "ok"}], **more}


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of kept rows, and an empty file of those made."""
    monkeypatch.setattr(study, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(study, "WORKING", tmp_path / "working.jsonl")
    return tmp_path / "kept"


def test_seeds_are_those_of_the_first_run() -> None:
    """Nobody looks for seeds that please."""
    seeds_of = {study.name: study.seeds for study in STUDIES}
    tests, calibrations, lines = (seeds_of[name] for name in ("tests", "calibrations", "lines"))
    assert set(map(tuple, seeds_of["short"].values())) == {tuple(range(32000, 34000))}
    assert {kind.partition("/")[0]: seeds for kind, seeds in tests.items()} == {
        "foreign": range(26000, 26200),
        "lab": range(27000, 27200),
    }
    assert [(seeds[0], len(seeds)) for seeds in calibrations.values()] == [(31000, 200)] * 8 + [
        (31000, 60)
    ] * 36
    assert lines == dict.fromkeys(
        ("push", "bow", "slack", "space bow", "space push"), range(41000, 41040)
    )
    assert len(BY_KIND) == sum(map(len, seeds_of.values()))
    foreign = [kind for kind in tests if kind.startswith("foreign")]
    drawn = [chance_of(kind.partition("/")[2], seed) for kind in foreign for seed in tests[kind]]
    assert sum(bool(each.fault) for each in drawn) == 18 * len(foreign)


def test_every_protocol_with_a_curve_is_studied(repository: Path) -> None:
    shipped = {path.stem for path in (repository / "protocols").glob("*.yaml")}
    assert {f"foreign/{name}" for name in shipped} - set(BY_KIND) == {"foreign/markers-only"}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, []),
        ({"seconds": 9.0, "commit": "def"}, []),
        ({"value": 1.0 + 2e-6}, []),
        ({"value": 1.0 + 2e-5}, ["compliance value"]),
        ({"value": float("nan")}, ["compliance value"]),
        ({"error": "RuntimeError"}, ["error"]),
        ({"about": {"fault": "cut"}}, ["about fault"]),
        ({"rows": []}, [f"compliance {key}" for key in KEYS]),
        ({"kind": "push", "value": 1.0 + 2e-4}, []),
        ({"kind": "push", "value": 1.0 + 4e-4}, ["compliance value"]),
    ],
)  # fmt: skip
def test_what_differs(change: dict[str, Any], expected: list[str]) -> None:
    kind = change.get("kind", BAR)
    found = differences(kept_row(kind, 1), kept_row(**{"kind": kind, "seed": 1, **change}))
    assert [finding.partition(":")[0] for finding in found] == expected


def test_a_difference_voids_the_earlier_rows_of_its_kind() -> None:
    rows = [
        kept_row(BAR, 1),
        kept_row(BAR, 2),
        kept_row(TAPE, 1),
        kept_row(BAR, 2, commit="same"),
        kept_row(TAPE, 2),
    ]
    assert {kind: list(own) for kind, own in study.standing(rows).items() if own} == {
        TAPE: [1, 2],
        BAR: [1, 2],
    }
    found = study.standing(
        [
            *rows,
            kept_row(BAR, 0, value=1.1, commit="new"),
            kept_row(BAR, 2, value=1.1, commit="new"),
        ]
    )
    assert list(found[BAR]) == [0, 2]
    assert list(found[TAPE]) == [1, 2]


def test_what_is_kept(kept: Path, tmp_path: Path) -> None:
    """Rounded, without reasons; of the canary what is cheap, whole and without a fault."""
    file = tmp_path / "rows.jsonl"
    rows = [
        kept_row(
            BAR, 27000, 1.0 / 3.0, seconds=4.0, error="Traceback\n  in x\nRuntimeError: no wire\n"
        ),
        kept_row(BAR, 27001, 2.0 / 3.0, seconds=3.0),
        kept_row(BAR, 27002, seconds=2.0),
        kept_row(BAR, 27003, seconds=1.0, about={"fault": "cut"}),
        kept_row(BAR, 27004, seconds=0.5, rows=[]),
    ]
    for each in rows:
        append(file, each)
    assert study.keep(file)[BAR] == 5
    own = study.kept_rows()[BAR]
    assert own[27001]["rows"][0]["value"] == 0.66666666667
    assert own[27000]["error"] == "RuntimeError: no wire"
    assert "seconds" not in own[27000]
    assert not differences(own[27001], rows[1])
    assert study.costs() == {BAR: Cost(2.1, (27002, 27001))}

    append(file, kept_row(BAR, 27005, 1.0, seconds=0.1))
    study.keep(file)
    assert study.costs()[BAR].canary == (27002, 27001), "stays"
    other = tmp_path / "other.jsonl"
    append(other, kept_row(BAR, 27001, 5.0, seconds=7.0, commit="new"))
    assert study.keep(other)[BAR] == 1, "a number that differs voids the kind"
    assert study.costs() == {BAR: Cost(1.767, (27001,))}, "one row says little of the cost"
    assert "RuntimeError" not in str(study.describe_changes([kept_row(BAR, 27001, 5.0)]))
    told = study.remedy(study.describe_changes([kept_row(BAR, 27001, 6.0)]))
    assert "seed 27001, compliance value: 5.0 -> 6.0); 353 CPU s" in told
    assert "python -m tests.coverage run 'lab/stiff-bar' --again" in told


def test_the_truth_is_solved_where_it_is_asked() -> None:
    """C5 slips in the first tenths of a millimetre: between other points it is 94 uN off."""
    at = tuple(np.linspace(0.0, DEEPEST, POINTS)[:8].tolist())
    wire, rig = wire_of("C5"), rig_of(0.12)
    parts = split_law(wire.section, wire.contacts)
    values = np.array([TRUTH.friction, TRUTH.modulus, TRUTH.copper])
    table = make_loading_table(parts, values, 40.0)
    asked = np.array(at[1:])
    exact = find_equilibria(table, 0.12, rig, wire.self_weight, asked, n_stations=48)
    curve = true_curve("own", "C5", 120, at)
    assert curve(asked) == pytest.approx(exact.force[1:], abs=1e-6)


BY_NAME = {kind.name: kind for kind in LINES}


@pytest.mark.parametrize("name", ["push", "bow"])
def test_both_rods_agree_on_a_line_with_memory(name: str) -> None:
    """The same law and numbers, links with angles beside nodes with frames."""
    kind = BY_NAME[name]
    drawn = draw(kind, 41007)
    off, stops = drawn.off, true_stops(drawn)
    truth = true_line(kind, drawn, 1e-3)
    kept = stops.stiffness > 0.0
    law = SliderLaw(stops.spring, stops.stiffness[kept], stops.width[kept], 0.0, 100.0)
    mass = foreign.weight_of(foreign.BUILDS[drawn.wire]) / foreign.GRAVITY
    laid = PreparedLine(
        *(law, 1e-3, mass * float(np.exp(off["mass_factor"]))),
        *(drawn.length * float(np.exp(off["length_factor"])), (0.0, off["free_curvature_2"]), off),
    )
    path = laid.follow(kind, drawn)
    held = path.states[held_at(kind)]
    assert np.abs(held.positions - truth.held).max() < 1e-3 * drawn.length
    assert np.abs(path.last.positions - truth.back).max() < 1e-3 * drawn.length
    assert held.reaction_moments[0, 1] == pytest.approx(truth.moment[1], rel=0.02)
    assert len(held.positions) == NODES + 1
