"""The tables of all tests on the page: state, day, first number, decision; and their exports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from urllib.parse import quote

from labpipe.records.group import Campaign
from labpipe.records.result import Result
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.issues import sentences
from labpipe.report.page_facts import PageTest, PageTests
from labpipe.report.page_groups import result_cell
from labpipe.report.wording import heading, is_main, shown_in


@dataclass(frozen=True, slots=True)
class TestRow:
    """A test in the table of tests.

    Parameters
    ----------
    test : with its number, state and key
    group : name of its group
    day, operator : empty where nothing says them
    first : its first main number
    decided : ``accept``, ``reject`` or empty
    said : what was decided, why, by whom and when
    page : address of its own page
    why : what is doubtful or failed in it, or why it was rejected
    """

    __test__ = False

    test: PageTest
    group: str
    day: str
    operator: str
    first: Cell
    decided: str
    said: str
    page: str
    why: str

    @property
    def address(self) -> str:
        """Of its page, as a link has it: a name may hold signs that mean something there."""
        return quote(self.page, errors="replace")


def test_rows(campaign: Campaign, tests: PageTests, stems: Mapping[str, str]) -> list[TestRow]:
    """Make the rows of the table of tests.

    Parameters
    ----------
    campaign : with its groups
    tests : of the page
    stems : names of groups by their stems
    """
    mains = {
        stem: next((number.name for number in group.numbers if is_main(number.name)), "")
        for stem, group in zip(stems, campaign.groups, strict=False)
    }
    return [_row(test, stems.get(test.stem, ""), mains.get(test.stem, "")) for test in tests.every]


def _row(test: PageTest, group: str, main: str) -> TestRow:
    sample = test.sample
    decided = "reject" if test.state == "rejected" else "accept" if sample.decided else ""
    return TestRow(
        test=test,
        group=group,
        day="" if sample.date is None else str(sample.date),
        operator=sample.operator,
        first=_first(test, main),
        decided=decided,
        said=test.why or sample.decided,
        page=page_file(sample.label or sample.test),
        why=why_of(test),
    )


def page_file(label: str) -> str:
    """Name the page of a test, below the folder of the report.

    Parameters
    ----------
    label : of the test

    Examples
    --------
    >>> page_file("wires/A2-085-1")
    'tests/wires__A2-085-1.html'
    """
    return f"tests/{label.replace('/', '__')}.html"


def _first(test: PageTest, main: str) -> Cell:
    """The first main number with its unit, as the column holds several quantities."""
    result = next((result for result in test.sample.results if result.name == main), None)
    if result is None:
        return Cell(DASH)
    shown = shown_in(main, result.unit, test.sample.display)
    words = result_cell(result, shown.factor)
    return Cell(words.text, heading(main, shown.unit), words.mark, words.tip, result.value)


def why_of(test: PageTest) -> str:
    """Say in sentences what is doubtful or failed in a test; of a rejected one, why.

    Parameters
    ----------
    test : of the page
    """
    if test.why:
        return f"Rejected: {test.why}"
    reasons = [reason for each in _troubled(test) for reason in each.reasons]
    return sentences(reasons)


def _troubled(test: PageTest) -> Iterator[Result]:
    return (result for result in test.sample.results if str(result.status) != "ok")


def export_table(tests: PageTests) -> Table:
    """Make the table of exports: of each test its files with their SHA-256.

    Parameters
    ----------
    tests : of the page
    """
    rows = tuple(
        (
            Cell(test.sample.test),
            Cell("; ".join(f"{each.file}: {each.sha256}" for each in test.sample.inputs) or DASH),
        )
        for test in tests.every
    )
    heads = ("Test", "Exports with their SHA-256")
    return Table("Where the numbers come from", heads, rows)
