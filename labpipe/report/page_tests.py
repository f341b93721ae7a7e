"""Tables of all tests on the page: state, day, first number, decision; and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

from labpipe.records.group import Campaign
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
    day, operator : empty if unknown
    first : its first main number
    decided : ``accept``, ``reject`` or empty
    decision : with reason, person and day
    page : address of its own page
    why : reasons of doubtful or failed results, or of the rejection
    """

    __test__ = False

    test: PageTest
    group: str
    day: str
    operator: str
    first: Cell
    decided: str
    decision: str
    page: str
    why: str

    @property
    def address(self) -> str:
        """Return the address of its page, quoted for a link."""
        return quote(self.page, errors="replace")


def test_rows(campaign: Campaign, tests: PageTests, stems: Mapping[str, str]) -> list[TestRow]:
    """Return the rows of the table of tests.

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
        first=_first_number_cell(test, main),
        decided=decided,
        decision=test.why or sample.decided,
        page=page_file(sample.label or sample.test),
        why=problems_of(test),
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


def _first_number_cell(test: PageTest, main: str) -> Cell:
    """Return the cell of the first main number with its unit, as the quantities differ."""
    result = next((result for result in test.sample.results if result.name == main), None)
    if result is None:
        return Cell(DASH)
    unit = shown_in(main, result.unit, test.sample.display)
    cell = result_cell(result, unit.factor)
    return Cell(cell.text, heading(main, unit.unit), cell.mark, cell.tip, result.value)


def problems_of(test: PageTest) -> str:
    """Return the reasons of doubtful and failed results of a test, or of its rejection.

    Parameters
    ----------
    test : of the page
    """
    if test.why:
        return f"Rejected: {test.why}"
    reasons = [
        reason
        for result in test.sample.results
        if str(result.status) != "ok"
        for reason in result.reasons
    ]
    return sentences(reasons)


def export_table(tests: PageTests) -> Table:
    """Return the table of recorded files of each test with their SHA-256.

    Parameters
    ----------
    tests : of the page
    """
    rows = tuple(
        (
            Cell(test.sample.test),
            Cell(
                "; ".join(f"{source.file}: {source.sha256}" for source in test.sample.inputs)
                or DASH
            ),
        )
        for test in tests.every
    )
    heads = ("Test", "Recorded files with SHA-256")
    return Table("Sources of the numbers", heads, rows)
