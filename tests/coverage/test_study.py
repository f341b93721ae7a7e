"""The study: its seeds, its rounds, and going on where it stopped."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.coverage import lab, study
from tests.coverage.study import KINDS, Kind, append, carry_on, missing, one, read
from tests.judges.foreign.processed import chance_of

BAR = Kind("foreign", "stiff-bar")


def line(kind: Kind, seed: int, **more: Any) -> dict[str, Any]:
    about = {"simulator": kind.simulator, "kind": kind.name, "seed": seed}
    return {**about, "rests_on": kind.rests_on, "rows": [], **more}


def test_seeds_are_those_of_the_first_run() -> None:
    """Nobody looks for seeds that please."""
    assert {"foreign": range(26000, 26200), "lab": range(27000, 27200)} == study.SEEDS
    foreign = [kind for kind in KINDS if kind.simulator == "foreign"]
    drawn = [chance_of(kind.name, seed) for kind in foreign for seed in kind.seeds]
    assert sum(bool(each.fault) for each in drawn) == 18 * len(foreign)


def test_every_protocol_with_a_curve_is_studied(repository: Path) -> None:
    shipped = {path.stem for path in (repository / "protocols").glob("*.yaml")}
    studied = {kind.name for kind in KINDS if kind.simulator == "foreign"}
    assert shipped - studied == {"markers-only"}


def test_rounds_have_one_of_each_kind(tmp_path: Path) -> None:
    wanted = missing(tmp_path / "none.jsonl")
    assert [kind for kind, _ in wanted[: len(KINDS)]] == list(KINDS)
    assert len(wanted) == 200 * len(KINDS)
    assert wanted[-1] == (KINDS[-1], KINDS[-1].seeds[-1])


def test_what_changed_is_made_again(tmp_path: Path) -> None:
    file = tmp_path / "study.jsonl"
    append(file, line(BAR, 26000))
    append(file, line(BAR, 26001, rests_on="of yesterday"))
    assert list(read(file)) == [(BAR, 26000)]
    assert [seed for _, seed in missing(file, [BAR])][:2] == [26001, 26002]


def test_a_torn_line_is_left_out_and_not_written_on(tmp_path: Path) -> None:
    file = tmp_path / "study.jsonl"
    append(file, line(BAR, 26000))
    with file.open("a") as stream:
        stream.write('{"simulator": "foreign", "kind": "stiff')
    append(file, line(BAR, 26002))
    assert [seed for _, seed in read(file)] == [26000, 26002]


@pytest.mark.slow
def test_going_on(tmp_path: Path) -> None:
    """Two tests in two parts, by a process of their own."""
    file = tmp_path / "study.jsonl"
    append(file, line(BAR, 26000))
    assert carry_on(file, minutes=5.0, jobs=1, kinds=[BAR], rounds=2) == 0
    (first, second) = read(file).values()
    assert (first["seed"], second["seed"]) == (26000, 26001)
    (row,) = second["rows"]
    assert row["name"] == "compliance"
    assert row["lower"] <= row["value"] <= row["upper"]
    assert second["noise"] == chance_of(BAR.name, 26001).noise
    assert carry_on(file, minutes=0.0, jobs=1, kinds=[BAR], rounds=3) == 1
    assert len(file.read_text().splitlines()) == 2


def test_an_error_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        message = "no such thing"
        raise RuntimeError(message)

    monkeypatch.setattr(lab, "rows", broken)
    made = one(Kind("lab", "stiff-bar"), 27000)
    assert "no such thing" in made["error"]
    assert json.dumps(made)
