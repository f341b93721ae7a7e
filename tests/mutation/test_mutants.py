"""The faults themselves, and how many of them the tests notice."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import pytest

from tests.mutation.__main__ import Counted, explained, main, stages, token, tried
from tests.mutation.mutants import COUNT, Mutant, mutants_of, sampled
from tests.mutation.trials import Demo, noticed_by

SOURCE = '''
def least(a, b):
    """The lesser one."""
    return a if a < b and not b == 2 else a + b

LIMIT = 2
'''


def by_now() -> dict[str, Mutant]:
    return {mutant.now: mutant for mutant in mutants_of("m.py", SOURCE)}


@pytest.mark.parametrize(
    "line",
    [
        "return a if a <= b and (not b == 2) else a + b",
        "return a if a < b or not b == 2 else a + b",
        "return a if a < b and +bool(b == 2) else a + b",
        "return a if a < b and (not b != 2) else a + b",
        "return a if a < b and (not b == 3) else a + b",
        "return a if a < b and (not b == 2) else a - b",
        "return a + b if a < b and (not b == 2) else a",
        "LIMIT = 3",
    ],
)
def test_a_mutant_is_one_small_fault(line: str) -> None:
    found = by_now()
    assert len(found) == 8
    was, lines = ast.unparse(ast.parse(SOURCE)), ast.unparse(found[line].tree)
    changed = [
        new for old, new in zip(was.splitlines(), lines.splitlines(), strict=True) if old != new
    ]
    assert [each.strip() for each in changed] == [line]


def test_a_mutant_stays_the_same_where_the_function_only_moves() -> None:
    moved = "import math\n\n" + SOURCE.replace("The lesser one.", "The smaller one.")
    before, after = (list(mutants_of("m.py", text)) for text in (SOURCE, moved))
    assert [(token(each), each.rank) for each in before] == [
        (token(each), each.rank) for each in after
    ]


@pytest.mark.slow
def test_the_sample_is_the_same_each_time_and_each_mutant_has_tests(repository: Path) -> None:
    drawn = sampled(repository / "labpipe")
    assert [each.key for each in drawn] == [each.key for each in sampled(repository / "labpipe")]
    assert len({each.key for each in drawn}) == COUNT
    assert all(stages(each, "")[0] for each in drawn)


@pytest.mark.slow
def test_a_trial_tells_the_test_that_fails(tmp_path: Path, repository: Path) -> None:
    module, beside = "results/least_squares.py", "tests/results/test_slack.py"
    source = (repository / "labpipe" / module).read_text(encoding="utf-8")
    mutants = {mutant.function: mutant for mutant in mutants_of(module, source)}
    nothing = Demo.followed(tmp_path / "no demo")
    noticed = noticed_by(mutants["zero_of_line"], [[beside]], nothing)
    assert noticed.startswith(f"{beside}::test_")
    assert not noticed_by(mutants["polynomial_weights"], [[beside]], nothing)


def test_the_score() -> None:
    one, two, three, four, *_ = (
        replace(mutant, module="law/plays.py") for mutant in mutants_of("m.py", SOURCE)
    )
    known = {token(one): "tests/law/test_plays.py::test_a", token(two): "", token(three): ""}
    counted = Counted.of([one, two, three, four], known, {two.key: "It is the same."})
    assert counted.ends["law"] == {
        "tests of its room": 1,
        "explained": 1,
        "survived": 1,
        "not tried": 1,
    }
    assert counted.survived == (three.key,)
    assert counted.share == pytest.approx(2 / 3)
    assert "| `law` | 3 | 1 | 0 | 0 | 1 | 1 |" in counted.table


@pytest.mark.slow
def test_nine_of_ten_mutants_are_noticed_or_explained(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["mutation", "--seconds", "7200"])
    assert main() == 0
    drawn, known = sampled(repository / "labpipe"), tried()
    assert Counted.of(drawn, known, explained()).share >= 0.9
    noticed = {each.key for each in drawn if known.get(token(each))}
    assert not noticed & explained().keys(), "explained as without effect, but noticed"
