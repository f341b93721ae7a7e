"""What the head of a report says: who tested what, when, with what, and which tests there are."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from functools import cached_property

from labpipe.records.group import Campaign, Group, Sample
from labpipe.records.result import Instrument, Status
from labpipe.report.wording import count_of
from labpipe.statistics.group_fields import SPOOL, fields_of

_ID_LENGTH = 10


@dataclass(frozen=True, slots=True)
class PageTest:
    """A test on the page.

    Parameters
    ----------
    number : of the test, in the order of the table of tests
    sample : what is known of it
    stem : of its group; empty for a rejected test that fits no group
    state : ``ok``, ``doubtful``, ``failed`` or ``rejected``
    why : why it was rejected, by whom and when; empty for any other
    """

    number: int
    sample: Sample
    stem: str
    state: str
    why: str = ""


class PageTests:
    """All tests of a report by number, group by group, the rejected ones last.

    Parameters
    ----------
    campaign : all of it
    stems : of its groups
    """

    def __init__(self, campaign: Campaign, stems: Sequence[str]) -> None:
        groups = list(zip(campaign.groups, stems, strict=True))
        own = [(sample, stem) for group, stem in groups for sample in group.samples]
        kept = [
            PageTest(number, sample, stem, state_of(sample))
            for number, (sample, stem) in enumerate(own)
        ]
        homes = {group.name: stem for group, stem in groups}
        rejected = [
            PageTest(number, sample, homes.get(home_of(sample, campaign), ""), "rejected", why)
            for number, (sample, why) in enumerate(_rejected(campaign), start=len(kept))
        ]
        self.every = (*kept, *rejected)

    @cached_property
    def number(self) -> Mapping[str, int]:
        """Number by the file that a sample was read from and its name."""
        return {key_of(each.sample): each.number for each in self.every}

    @cached_property
    def by_name(self) -> Mapping[str, PageTest]:
        """Tests by name; names are told apart by the folder."""
        return {each.sample.test: each for each in self.every}

    def rejected(self, stem: str) -> list[PageTest]:
        """Rejected tests of a group."""
        return [each for each in self.every if each.state == "rejected" and each.stem == stem]


def key_of(sample: Sample) -> str:
    """What tells two samples of a report apart."""
    return f"{sample.source}\n{sample.test}"


def _rejected(campaign: Campaign) -> Iterator[tuple[Sample, str]]:
    for sample in campaign.rejected_samples:
        yield sample, campaign.rejected.get(sample.source, sample.decided)


def home_of(sample: Sample, campaign: Campaign) -> str:
    """Find the group that a rejected test would be in.

    Parameters
    ----------
    sample : rejected
    campaign : with its groups

    Returns
    -------
    Name of the group of its protocol that it has most in common with, of those that it has all
    fields in common with that groups are made by; empty where there is none.
    """
    own = fields_of(sample.specimen)
    alike = {
        group.name: sum(own.get(name) == word for name, word in group.fields.items())
        for group in campaign.groups
        if group.protocol == sample.protocol and _fits(own, group, campaign.by)
    }
    return max(alike, key=lambda name: alike[name], default="")


def _fits(own: Mapping[str, str], group: Group, by: Iterable[str]) -> bool:
    return all(own.get(name) == group.fields.get(name) for name in by if name != SPOOL)


def state_of(sample: Sample) -> str:
    """Worst state of the numbers of a test: ``ok``, ``doubtful`` or ``failed``."""
    found = {result.status for result in sample.results}
    worst = (Status.FAILED, Status.DOUBTFUL)
    return next((str(status) for status in worst if status in found), str(Status.OK))


def report_id(campaign: Campaign) -> str:
    """Make an identifier of what a report shows: its tests and what was decided on them.

    Parameters
    ----------
    campaign : all of it; the same tests, decisions and groups give the same identifier
    """
    digest = hashlib.sha256()
    for group in campaign.groups:
        for sample in group.samples:
            digest.update(f"{group.name}\n{sample.test}\n{sample.run}\n".encode(errors="replace"))
    for why in campaign.rejected.items():
        digest.update("\n".join(why).encode(errors="replace"))
    digest.update(f"{campaign.title}\n{campaign.labpipe_version}".encode(errors="replace"))
    return digest.hexdigest()[:_ID_LENGTH]


def samples_of(campaign: Campaign) -> list[Sample]:
    """List the samples of all groups."""
    return [sample for group in campaign.groups for sample in group.samples]


def days_words(samples: Iterable[Sample]) -> str:
    """Say when tests were made, such as ``2026-03-02 to 2026-03-06, 2 of unknown day``."""
    days = [sample.date for sample in samples]
    known = sorted({day for day in days if day is not None})
    missing = sum(day is None for day in days)
    if not known:
        return "on an unknown day (no sheet states one)"
    words = _days(known)
    return f"{words}, {count_of(missing, 'test')} of unknown day" if missing else words


def _days(known: Sequence[date]) -> str:
    first, last = known[0], known[-1]
    return f"{first}" if first == last else f"{first} to {last}"


def operators_words(samples: Iterable[Sample]) -> str:
    """Name who tested; says where sheets name nobody."""
    names = Counter(sample.operator for sample in samples)
    missing = names.pop("", 0)
    known = ", ".join(names)
    if not known:
        return "operator not stated"
    return f"{known} ({count_of(missing, 'test')} without operator)" if missing else known


@dataclass(frozen=True, slots=True)
class InstrumentLine:
    """An instrument of a report.

    Parameters
    ----------
    name : its channel, and the certificate of its calibration
    due : when its calibration is due; says since when it was overdue
    is_overdue : some test was made after it was due
    """

    name: str
    due: str
    is_overdue: bool


def instrument_lines(samples: Sequence[Sample]) -> list[InstrumentLine]:
    """List the instruments of tests, each calibration once.

    Parameters
    ----------
    samples : all of the report
    """
    used: dict[Instrument, list[Sample]] = {}
    for sample in samples:
        for instrument in sample.instruments:
            used.setdefault(instrument, []).append(sample)
    return [_instrument_line(each, tests) for each, tests in used.items()]


def _instrument_line(instrument: Instrument, tests: Sequence[Sample]) -> InstrumentLine:
    due = instrument.due
    late = [test for test in tests if due is not None and test.date is not None and test.date > due]
    words = "no due date stated" if due is None else f"calibration due {due}"
    if late:
        words = f"calibration OVERDUE since {due} in {count_of(len(late), 'test')}"
    return InstrumentLine(f"{instrument.channel} {instrument.certificate}", words, bool(late))


def roles_words(samples: Iterable[Sample]) -> str:
    """Name what recorded the tests, by the roles of their exports."""
    return ", ".join(dict.fromkeys(each.role for sample in samples for each in sample.inputs))
