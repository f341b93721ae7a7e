"""List facts of a report: its tests by number, their states, days, operators and instruments."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from labpipe.records.group import Campaign, Sample
from labpipe.records.result import Instrument, Status
from labpipe.report.wording import write_count
from labpipe.statistics.group_samples import SPOOL, list_fields


@dataclass(frozen=True, slots=True)
class PageTest:
    """A test on the page.

    Parameters
    ----------
    number : position in the table of tests
    sample : numbers and specimen of the test
    stem : stem of the file names of its group; empty for a rejected test that matches no group
    state : ``ok``, ``doubtful``, ``failed`` or ``rejected``
    rejection : reason, person and day of a rejection; empty for other tests
    """

    number: int
    sample: Sample
    stem: str
    state: str
    rejection: str = ""


class PageTests:
    """Tests of a report in the order of their numbers: group by group, rejected tests last.

    Parameters
    ----------
    campaign : content of the report
    stems : stem of the file names of each group
    """

    def __init__(self, campaign: Campaign, stems: Sequence[str]) -> None:
        groups = list(zip(campaign.groups, stems, strict=True))
        samples = [(sample, stem) for group, stem in groups for sample in group.samples]
        included = [
            PageTest(number, sample, stem, find_state(sample))
            for number, (sample, stem) in enumerate(samples)
        ]
        stems_by_group = {group.name: stem for group, stem in groups}
        rejected = []
        for number, sample in enumerate(campaign.rejected_samples, start=len(included)):
            stem = stems_by_group.get(find_group_of_rejected(sample, campaign), "")
            rejection = campaign.rejected.get(sample.source, sample.decision)
            rejected.append(PageTest(number, sample, stem, "rejected", rejection))
        self.all_tests = (*included, *rejected)

    @cached_property
    def number(self) -> Mapping[str, int]:
        """Return the numbers of the tests by source file and name."""
        return {make_key(test.sample): test.number for test in self.all_tests}

    @cached_property
    def by_name(self) -> Mapping[str, PageTest]:
        """Return the tests by name."""
        return {test.sample.test: test for test in self.all_tests}

    def rejected(self, stem: str) -> list[PageTest]:
        """Return the rejected tests of the group with this stem."""
        return [test for test in self.all_tests if test.state == "rejected" and test.stem == stem]


def make_stems(names: Iterable[str]) -> list[str]:
    """Convert names of groups to stems of file names: ASCII, lower case, unique.

    Examples
    --------
    >>> make_stems(["A2, wire cantilever", "A2-wire-cantilever", "°"])
    ['a2-wire-cantilever', 'a2-wire-cantilever-2', 'group']
    """
    stems: list[str] = []
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "group"
        stem, number = plain, 1
        while stem in stems:
            number += 1
            stem = f"{plain}-{number}"
        stems.append(stem)
    return stems


def make_key(sample: Sample) -> str:
    """Return a unique key of a sample in a report."""
    return f"{sample.source}\n{sample.test}"


def find_group_of_rejected(sample: Sample, campaign: Campaign) -> str:
    """Find the group to which a rejected test would belong.

    Parameters
    ----------
    sample : rejected
    campaign : with its groups

    Returns
    -------
    Name of the group; empty if there is none. Test and group have the same protocol, and the same
    values of the fields by which the campaign is grouped, except the spool. Of several groups, the
    one with most fields in common is returned.
    """
    fields = list_fields(sample.specimen)
    n_common_fields = {
        group.name: sum(fields.get(name) == value for name, value in group.fields.items())
        for group in campaign.groups
        if group.protocol == sample.protocol
        and all(fields.get(name) == group.fields.get(name) for name in campaign.by if name != SPOOL)
    }
    return max(n_common_fields, key=lambda name: n_common_fields[name], default="")


def find_state(sample: Sample) -> str:
    """Find the worst state of the numbers of a test: ``ok``, ``doubtful`` or ``failed``."""
    states = {result.status for result in sample.results}
    states_by_severity = (Status.FAILED, Status.DOUBTFUL)
    return next((str(status) for status in states_by_severity if status in states), str(Status.OK))


def compute_report_id(campaign: Campaign) -> str:
    """Compute the identifier of a report, ten hexadecimal digits.

    Parameters
    ----------
    campaign : the same title, groups, runs of tests, rejections and version of labpipe give the
        same identifier
    """
    digest = hashlib.sha256()
    for group in campaign.groups:
        for sample in group.samples:
            digest.update(f"{group.name}\n{sample.test}\n{sample.run}\n".encode(errors="replace"))
    for rejection in campaign.rejected.items():
        digest.update("\n".join(rejection).encode(errors="replace"))
    digest.update(f"{campaign.title}\n{campaign.labpipe_version}".encode(errors="replace"))
    return digest.hexdigest()[:10]


def list_samples(campaign: Campaign) -> list[Sample]:
    """List the samples of all groups."""
    return [sample for group in campaign.groups for sample in group.samples]


def describe_days(samples: Iterable[Sample]) -> str:
    """Describe the days of tests, such as ``2026-03-02 to 2026-03-06, 2 tests of unknown day``."""
    days = [sample.date for sample in samples]
    dates = sorted({day for day in days if day is not None})
    missing = sum(day is None for day in days)
    if not dates:
        return "on an unknown day (no sheet states one)"
    period = " to ".join(dict.fromkeys(map(str, (dates[0], dates[-1]))))
    return f"{period}, {write_count(missing, 'test')} of unknown day" if missing else period


def describe_operators(samples: Iterable[Sample]) -> str:
    """Name the operators, and count tests without operator."""
    names = Counter(sample.operator for sample in samples)
    missing = names.pop("", 0)
    stated = ", ".join(names)
    if not stated:
        return "operator not stated"
    return f"{stated} ({write_count(missing, 'test')} without operator)" if missing else stated


@dataclass(frozen=True, slots=True)
class InstrumentLine:
    """An instrument of a report.

    Parameters
    ----------
    name : its channel, and the certificate of its calibration
    due : due date of the calibration; if it is overdue, also the number of affected tests
    is_overdue : whether a test was made after the due date
    """

    name: str
    due: str
    is_overdue: bool


def list_instruments(samples: Sequence[Sample]) -> list[InstrumentLine]:
    """List the instruments of tests, each certificate once.

    Parameters
    ----------
    samples : all of the report
    """
    tests_by_instrument: dict[Instrument, list[Sample]] = {}
    for sample in samples:
        for instrument in sample.instruments:
            tests_by_instrument.setdefault(instrument, []).append(sample)
    return [
        _describe_instrument(instrument, tests) for instrument, tests in tests_by_instrument.items()
    ]


def _describe_instrument(instrument: Instrument, tests: Sequence[Sample]) -> InstrumentLine:
    due = instrument.due
    overdue_tests = [
        test for test in tests if due is not None and test.date is not None and test.date > due
    ]
    text = "no due date stated" if due is None else f"calibration due {due}"
    if overdue_tests:
        text = f"calibration OVERDUE since {due} in {write_count(len(overdue_tests), 'test')}"
    return InstrumentLine(
        f"{instrument.channel} {instrument.certificate}", text, bool(overdue_tests)
    )


def name_roles(samples: Iterable[Sample]) -> str:
    """Name the roles of the recorded files of the tests."""
    return ", ".join(dict.fromkeys(source.role for sample in samples for source in sample.inputs))
