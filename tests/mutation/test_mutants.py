"""The faults themselves, and how many of them the tests notice."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutation.__main__ import files_for, score, try_for
from tests.mutation.mutants import COUNT, Mutant, sampled, sites

SOURCE = """
def least(a, b):
    return a if a < b and not b == 2 else a + b
"""


def mutant(change: str) -> str:
    found = {said: node for node, said in sites(ast.parse(SOURCE))}
    node = found[change]
    line, column = getattr(node, "lineno", 0), getattr(node, "col_offset", 0)
    return Mutant("m.py", line, column, change, SOURCE).text.splitlines()[-1].strip()


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ("Lt to LtE", "return a if a <= b and (not b == 2) else a + b"),
        ("And to Or", "return a if a < b or not b == 2 else a + b"),
        ("Not dropped", "return a if a < b and +bool(b == 2) else a + b"),
        ("Eq to NotEq", "return a if a < b and (not b != 2) else a + b"),
        ("2 to 3", "return a if a < b and (not b == 3) else a + b"),
        ("Add to Sub", "return a if a < b and (not b == 2) else a - b"),
        ("branches swapped", "return a + b if a < b and (not b == 2) else a"),
    ],
)
def test_a_mutant_is_one_small_fault(change: str, line: str) -> None:
    assert mutant(change) == line


def test_the_sample_is_the_same_each_time_and_each_mutant_has_tests(repository: Path) -> None:
    drawn = sampled(repository / "labpipe")
    assert [each.key for each in drawn] == [each.key for each in sampled(repository / "labpipe")]
    assert len(drawn) == COUNT
    for each in drawn[:20]:
        assert files_for(each)
        assert each.text != ast.unparse(ast.parse(each.source))


@pytest.mark.slow
def test_nine_of_ten_mutants_are_killed_or_explained() -> None:
    try_for(3600.0)
    ends, unexplained = score()
    assert len(unexplained) <= 0.1 * (COUNT - ends["not tried"])
