"""The bookkeeping of the study of calibrations, and how it judges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labpipe.wire.calibration.wire_parts import loading_table, take_apart
from labpipe.wire.heavy_loading import heavy_states
from tests.coverage import study, wire_campaigns
from tests.coverage.study import append
from tests.coverage.wire_campaigns import (
    DEEPEST,
    FIRST_SEED,
    KINDS,
    MAIN,
    POINTS,
    TRUTH,
    WireKind,
    campaign,
    rig_of,
    true_curve,
    wire_of,
)
from tests.coverage.wire_judgement import (
    BEGIN,
    END,
    Held,
    bands,
    counted,
    is_held,
    publish,
    tables,
    too_seldom,
)
from tests.coverage.wire_study import carry_on, missing, one, read, rests_on

FIRST, SECOND = KINDS[0], KINDS[1]


def line(kind: WireKind, seed: int, *, held: bool = True, **more: Any) -> dict[str, Any]:
    parameter = {"truth": 1.0 if held else 5.0, "parts": [[0.8, 1.2]], "verdict": "identified"}
    names = ("radial_friction", "insulation_modulus", "copper_scale")
    made = {
        "kind": kind.name,
        "seed": seed,
        "rests_on": rests_on(),
        "seconds": 1.0,
        "error": "",
        "parameters": dict.fromkeys(names, parameter),
        "bands": [[1.0, 0.9, 1.1], [1.0, 1.1, 1.2]],
        "solutions": 1,
    }
    return {**made, **more}


def test_seeds_and_kinds_are_fixed() -> None:
    assert FIRST_SEED == 31000
    assert [(kind.wire, kind.length, kind.campaigns) for kind in KINDS[:4]] == [
        (*each, 200) for each in MAIN
    ]
    assert len({kind.name for kind in KINDS}) == len(KINDS) == 44
    assert {kind.model for kind in KINDS} == {"own", "foreign"}


def test_the_study_goes_on_where_it_stopped(tmp_path: Path) -> None:
    file = tmp_path / "study.jsonl"
    append(file, line(SECOND, FIRST_SEED + 1))
    append(file, line(FIRST, FIRST_SEED))
    append(file, {**line(FIRST, FIRST_SEED + 1), "rests_on": "older code"})
    file.write_text(file.read_text(encoding="utf-8") + '{"kind": "torn', encoding="utf-8")
    assert [(each["kind"], each["seed"]) for each in read(file)] == [
        (FIRST.name, FIRST_SEED),
        (SECOND.name, FIRST_SEED + 1),
    ]
    left = missing(file, [FIRST, SECOND])
    assert left[:3] == [(SECOND, FIRST_SEED), (FIRST, FIRST_SEED + 1), (FIRST, FIRST_SEED + 2)]
    assert len(left) == 398
    assert carry_on(file, minutes=0.0, jobs=1, kinds=[FIRST]) == 199


def test_a_campaign_is_the_same_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def straight(*_: object) -> Any:
        return lambda deflection: 2.0 * deflection

    monkeypatch.setattr(wire_campaigns, "true_curve", straight)
    (gain, curves), (again, same) = (campaign(FIRST, FIRST_SEED) for _ in range(2))
    assert gain == again
    assert curves[2].force.tolist() == same[2].force.tolist()
    assert len({curve.sample for curve in curves}) == 3
    assert curves[0].self_weight == pytest.approx(0.0672, abs=1e-4)
    assert campaign(FIRST, FIRST_SEED + 1)[0] != gain
    assert campaign(SECOND, FIRST_SEED)[0] != gain


def test_the_truth_is_solved_where_it_is_asked() -> None:
    """C5 slips in the first tenths of a millimetre: between other points it is 94 uN off."""
    at = tuple(np.linspace(0.0, DEEPEST, POINTS)[:8].tolist())
    wire, rig = wire_of("C5"), rig_of(0.12)
    parts = take_apart(wire.section, wire.contacts)
    values = np.array([TRUTH.friction, TRUTH.modulus, TRUTH.copper])
    table = loading_table(parts, values, 40.0)
    asked = np.array(at[1:])
    exact = heavy_states(table, 0.12, rig, wire.self_weight, asked, n_stations=48)
    curve = true_curve("own", "C5", 120, at)
    assert curve(asked) == pytest.approx(exact.tension - exact.rest_tension, abs=1e-6)


def test_an_error_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        message = "no such thing"
        raise RuntimeError(message)

    monkeypatch.setattr(wire_campaigns, "rows", broken)
    assert "no such thing" in one(FIRST, FIRST_SEED)["error"]


def test_any_part_of_an_interval_may_hold_the_truth() -> None:
    parts = [[0.5, 0.9], [3.0, 4.0]]
    assert is_held({"truth": 3.5, "parts": parts})
    assert not is_held({"truth": 1.0, "parts": parts})


def test_what_holds_too_seldom() -> None:
    """Nine of ten is chance in 60 campaigns, and not in 400."""
    seeds = range(FIRST_SEED, FIRST_SEED + 60)
    lines = [line(FIRST, seed, held=seed % 10 > 0) for seed in seeds]
    assert counted(lines, "copper_scale", identified=True) == Held(54, 60)
    assert bands(lines) == Held(60, 120)
    assert not any(too_seldom(lines).values())
    many = [line(SECOND, seed, held=seed % 10 > 0) for seed in range(400)]
    assert all(too_seldom(many).values())
    weak = line(FIRST, FIRST_SEED)
    weak["parameters"]["copper_scale"] = {
        **weak["parameters"]["copper_scale"],
        "verdict": "two solutions",
    }
    assert counted([weak], "copper_scale", identified=True) == Held(0, 0)
    assert counted([weak], "copper_scale", identified=False) == Held(1, 1)


def test_the_page_says_what_was_counted(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    lines = [line(FIRST, seed, held=seed % 5 > 0) for seed in range(200)]
    publish([*lines, {**line(FIRST, 300), "error": "x", "parameters": {}}], "abc", page)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "\nold\n" not in text
    assert "201 campaigns of 1 kinds" in text
    assert "1 ended without a calibration" in text
    assert "3 hold significantly less often than in 95 %" in text
    assert "**160 of 200**" in tables(lines, "abc")


def test_lines_that_are_kept_come_before_those_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "KEPT", tmp_path / "kept")
    file = tmp_path / "lines.jsonl"
    old = [line(FIRST, FIRST_SEED), line(FIRST, FIRST_SEED + 1)]
    kept = study.keep(file, old)
    assert read(file) == old, "without a file"
    newer = line(FIRST, FIRST_SEED + 1, seconds=2.0)
    append(file, newer)
    append(file, line(FIRST, FIRST_SEED + 2))
    assert [each["seconds"] for each in read(file)] == [1.0, 2.0, 1.0]
    assert (FIRST, FIRST_SEED) not in missing(file)
    study.keep(file, ())
    assert not kept.exists()
    assert len(read(file)) == 2
