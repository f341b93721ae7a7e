"""Rows of the studies: their seeds, what voids them, how they are made and kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from tests.coverage import lab, study
from tests.coverage.study import BY_KIND, STUDIES, Cost, append, differences, make_row, missing
from tests.judges.foreign.processed import chance_of

KEYS = ("truth", "value", "lower", "upper", "status")
BAR, TAPE = "lab/stiff-bar", "lab/pet-tape"


def row(kind: str, seed: int, value: float = 1.0, **more: Any) -> dict[str, Any]:
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
    tests, calibrations, lines = (each.seeds for each in STUDIES)
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
    assert len(BY_KIND) == len(tests) + len(calibrations) + len(lines)
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
        ({"value": 1.0 + 0.9e-9}, []),
        ({"value": 1.0 + 2e-9}, ["compliance value"]),
        ({"value": float("nan")}, ["compliance value"]),
        ({"error": "RuntimeError"}, ["error"]),
        ({"about": {"fault": "cut"}}, ["about fault"]),
        ({"rows": []}, [f"compliance {key}" for key in KEYS]),
        ({"kind": "push", "value": 1.0 + 0.9e-6}, []),
        ({"kind": "push", "value": 1.0 + 2e-6}, ["compliance value"]),
    ],
)  # fmt: skip
def test_what_differs(change: dict[str, Any], expected: list[str]) -> None:
    kind = change.get("kind", BAR)
    found = differences(row(kind, 1), row(**{"kind": kind, "seed": 1, **change}))
    assert [each.partition(":")[0] for each in found] == expected


def test_words_of_a_reason_do_not_count() -> None:
    one, other = row(BAR, 1), row(BAR, 1)
    other["rows"][0] |= {"why": "other words", "estimate": None}
    assert not differences(one, other)


def test_a_difference_voids_the_earlier_rows_of_its_kind() -> None:
    rows = [row(BAR, 1), row(BAR, 2), row(TAPE, 1), row(BAR, 2, commit="same"), row(TAPE, 2)]
    assert {kind: list(own) for kind, own in study.standing(rows).items() if own} == {
        TAPE: [1, 2],
        BAR: [1, 2],
    }
    found = study.standing([*rows, row(BAR, 2, value=1.1), row(BAR, 0, value=1.1)])
    assert list(found[BAR]) == [0, 2]
    assert list(found[TAPE]) == [1, 2]


def test_a_torn_line_is_left_out_and_not_written_on(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    append(file, row(BAR, 1))
    with file.open("a") as stream:
        stream.write('{"kind": "lab/stiff')
    append(file, row(BAR, 2))
    assert [each["seed"] for each in study.read(file)] == [1, 2]


def test_rounds_give_every_kind_the_same_share() -> None:
    none = study.standing([])
    kinds = ["foreign A2 85 mm 2 mN", "foreign A1 85 mm 2 mN"]  # 200 and 60
    begin = [kind for kind, _ in missing(none, kinds)][:130]
    assert (begin.count(kinds[0]), begin.count(kinds[1])) == (100, 30)
    first = missing(none, BY_KIND)[: len(BY_KIND)]
    assert [kind for kind, _ in first] == list(BY_KIND)


def made_here(
    wanted: list[tuple[str, int]], *, jobs: int, until: float = inf
) -> Iterator[dict[str, Any]]:
    """As `study.make_rows`, without processes."""
    return (make_row(*each) for each in wanted if monotonic() < until)


@pytest.mark.slow
def test_rows_are_made_by_processes() -> None:
    wanted = [(BAR, seed) for seed in range(27000, 27003)]
    made = study.standing(study.make_rows(wanted, jobs=2))[BAR]
    assert not [seed for seed in made if differences(made[seed], make_row(BAR, seed))]
    assert len(made) == 3
    assert not list(study.make_rows(wanted, jobs=2, until=monotonic()))


def test_going_on(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is missing, what a canary voids, what is asked for by name."""
    short = replace(STUDIES[0], seeds={BAR: range(27000, 27003)})
    monkeypatch.setattr(study, "BY_KIND", {BAR: short})
    monkeypatch.setattr(study, "STUDIES", (short,))
    monkeypatch.setattr(study, "make_rows", made_here)

    def run(minutes: float = 5.0, *, again: bool = False) -> tuple[int, int]:
        left = study.run([BAR], again=again, minutes=minutes, jobs=1)
        return left, len(list(study.read(study.WORKING)))

    assert run(0.0) == (3, 0)
    assert run() == (0, 3)
    made = study.standing(study.read(study.WORKING))[BAR]
    assert made[27001]["rows"][0]["name"] == "compliance"
    study.keep(study.WORKING)
    study.WORKING.unlink()
    assert run() == (0, 0), "nothing is missing"
    for each in made.values():
        each["rows"][0]["value"] *= 1.0 + 1e-6
        append(tmp_path / "older.jsonl", {**each, "commit": "abc"})
    study.keep(tmp_path / "older.jsonl")
    assert run() == (0, 3), "a canary differs"
    study.keep(study.WORKING)
    assert set(study.kept_rows()[BAR]) == {27000, 27001, 27002}
    study.WORKING.unlink()
    assert run(0.0, again=True) == (3, 0)


def test_what_is_kept(kept: Path, tmp_path: Path) -> None:
    """Rounded, without reasons; of the canary what is cheap, whole and without a fault."""
    file = tmp_path / "rows.jsonl"
    rows = [
        row(BAR, 27000, 1.0 / 3.0, seconds=4.0, error="Traceback\n  in x\nRuntimeError: no wire\n"),
        row(BAR, 27001, 2.0 / 3.0, seconds=3.0),
        row(BAR, 27002, seconds=2.0),
        row(BAR, 27003, seconds=1.0, about={"fault": "cut"}),
        row(BAR, 27004, seconds=0.5, rows=[]),
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

    append(file, row(BAR, 27005, 1.0, seconds=0.1))
    study.keep(file)
    assert study.costs()[BAR].canary == (27002, 27001), "stays"
    other = tmp_path / "other.jsonl"
    append(other, row(BAR, 27001, 5.0, seconds=7.0))
    assert study.keep(other)[BAR] == 1, "a number that differs voids the kind"
    assert study.costs() == {BAR: Cost(1.767, (27001,))}, "one row says little of the cost"
    assert "RuntimeError" not in str(study.changes([row(BAR, 27001, 5.0)]))
    told = study.remedy(study.changes([row(BAR, 27001, 6.0)]))
    assert "seed 27001, compliance value: 5.0 -> 6.0); 353 CPU s" in told
    assert "python -m tests.coverage run 'lab/stiff-bar' --again" in told


def test_kinds_by_name_pattern_and_study() -> None:
    assert study.kinds_of([]) == list(BY_KIND)
    assert study.kinds_of(["lines", "lab/*-tape"]) == [TAPE, *STUDIES[2].seeds]
    with pytest.raises(LookupError, match=r"^lab/tape: expected kinds among foreign/tensile"):
        study.kinds_of(["lab/tape", "push"])


def test_an_error_is_kept_in_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        message = "no such thing"
        raise RuntimeError(message)

    monkeypatch.setattr(lab, "rows", broken)
    made = make_row(BAR, 27000)
    assert "no such thing" in made["error"]
    assert (made["about"], made["rows"]) == ({}, [])
