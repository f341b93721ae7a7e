"""The faults themselves, and how many of them the tests notice."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import pytest
from coverage import CoverageData

from tests.mutation.__main__ import Counted, explained, main, token, tried
from tests.mutation.entered import PACKAGE, Entered
from tests.mutation.mutants import COUNT, Mutant, mutants_of, sampled
from tests.mutation.trials import in_session, noticed_by

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
    mutants = by_now()
    assert len(mutants) == 8
    was, lines = ast.unparse(ast.parse(SOURCE)), ast.unparse(mutants[line].tree)
    changed = [
        new for old, new in zip(was.splitlines(), lines.splitlines(), strict=True) if old != new
    ]
    assert [mutant.strip() for mutant in changed] == [line]


def test_a_mutant_stays_the_same_where_the_function_only_moves() -> None:
    moved = "import math\n\n" + SOURCE.replace("The lesser one.", "The smaller one.")
    before, after = (list(mutants_of("m.py", text)) for text in (SOURCE, moved))
    assert [(token(mutant), mutant.rank) for mutant in before] == [
        (token(mutant), mutant.rank) for mutant in after
    ]


def test_the_sample_is_the_same_each_time(repository: Path) -> None:
    drawn = sampled(repository / "labpipe")
    assert drawn == sampled(repository / "labpipe")
    assert len({mutant.key for mutant in drawn}) == COUNT


def test_tests_that_enter_are_asked_first_and_of_each_the_fastest() -> None:
    """Then those of their files, which may share what was made for them; not what takes long."""
    mutant = by_now()["return a if a <= b and (not b == 2) else a + b"]
    seconds = {"a::1": 3.0, "a::2": 1.0, "a::3": 0.1, "a::4": 21.0, "b::1": 2.0, "c::1": 0.1}
    data = CoverageData(no_disk=True)
    for test, line in {"a::1": 4, "a::2": 4, "a::4": 4, "b::1": 4, "c::1": 6, "": 6}.items():
        data.set_context(test)
        data.add_lines({str(PACKAGE / "m.py"): [line]})
    assert Entered(data, seconds).tests_of(mutant) == ["a::2", "b::1", "a::1", "a::3"]
    assert Entered(data, seconds).tests_of(mutant, "a::1")[0] == "a::1"
    seconds |= {"a::2": 9.0, "b::1": 9.5, "a::1": 20.0, "a::3": 1.6}
    assert Entered(data, seconds).tests_of(mutant) == ["a::2", "b::1", "a::1"]


@pytest.mark.slow
@pytest.mark.parametrize("is_at_import", [False, True])
def test_a_trial_tells_the_test_that_fails(repository: Path, *, is_at_import: bool) -> None:
    """In a session that has imported the sound package, and where it is imported again."""
    module, beside = "results/curves.py", "tests/results/test_slack.py"
    source = (repository / "labpipe" / module).read_text(encoding="utf-8")
    mutants = {mutant.function: mutant for mutant in mutants_of(module, source)}
    chosen = [mutants["compute_zero_crossing"], mutants["compute_polynomial_weights"]]
    by = list[str]()

    def ask(session: pytest.Session) -> None:
        tests = [item.nodeid for item in session.items]
        for mutant in chosen:
            at = range(0) if is_at_import else mutant.lines
            by.append(noticed_by(replace(mutant, lines=at), tests, session))

    in_session([beside], ask)
    assert by[0].startswith(f"{beside}::test_")
    assert by[1:] == [""]


def test_the_score() -> None:
    one, two, three, four, *_ = (
        replace(mutant, module="mechanics/law/plays.py") for mutant in mutants_of("m.py", SOURCE)
    )
    trials = {token(one): "tests/law/test_plays.py::test_a", token(two): "", token(three): ""}
    counted = Counted.of([one, two, three, four], trials, {two.key: "It is the same."})
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
    drawn, trials = sampled(repository / "labpipe"), tried()
    assert Counted.of(drawn, trials, explained()).share >= 0.9
    noticed = {mutant.key for mutant in drawn if trials.get(token(mutant))}
    assert not noticed & explained().keys(), "explained as without effect, but noticed"
