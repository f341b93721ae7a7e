"""From processed tests to the report of a campaign."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from labpipe import __version__
from labpipe.campaign.campaign_folders import name_of_campaign
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    decision_entry,
    decision_sentence,
    decisions_on,
    in_force,
    label_of,
)
from labpipe.campaign.grouping import (
    Settings,
    check_fields,
    division,
    find_differences,
    group_names,
    setting_notes,
    settings_by_test,
    settings_of,
    with_own_spools,
    without,
)
from labpipe.campaign.protocol_facts import NumberKinds, number_kinds, with_sizes
from labpipe.campaign.report_samples import frames_at_steps, sample_of
from labpipe.campaign.test_pages import pages_of
from labpipe.errors import LabpipeError, UsageError
from labpipe.process.output_paths import (
    find_copies,
    find_results,
    recording_of,
    refuse_repeated,
    shared_folder,
)
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Groups
from labpipe.records.group import Campaign, Group, Sample
from labpipe.report.lab_report import PLAIN, Extras, Letterhead, write_report
from labpipe.report.wording import is_main
from labpipe.statistics.group_fields import TYPE
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER, grouping_notes
from labpipe.statistics.groups import PoolingLimits, build_group
from labpipe.statistics.outliers import with_outliers
from labpipe.store.read import read_drawable
from labpipe.store.replace import locked, replacing_together
from labpipe.store.summaries import SUMMARY_FILE, check_summary
from labpipe.studies.bundle_bounds import find_places
from labpipe.studies.wire_specs import read_wire_sheet


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """What a report is wanted to show.

    Parameters
    ----------
    by : fields of the test sheets that groups are made by; if empty, the type and all else of the
        specimen that differs within a type
    alone : show only pairs of groups that differ in this field and no other; empty for all
    wires : wire sheet, for the bounds of harness bundles; None for none
    """

    by: tuple[str, ...] = ()
    alone: str = ""
    wires: Path | None = None


AS_SHEETS_DIFFER = ReportOptions()


@dataclass(frozen=True, slots=True)
class ReportContext:
    """What a report has beside groups and comparisons.

    Parameters
    ----------
    letterhead : who it is from and for
    formats : of figures as files: ``svg``, ``png``, ``pdf``; none for no files
    has_test_pages : a page for each test
    """

    letterhead: Letterhead = PLAIN
    formats: tuple[str, ...] = ()
    has_test_pages: bool = False


NOTHING_BESIDE = ReportContext()


RECIPE_FILE = "report.json"


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a report was made, kept beside it, so that it can be made again.

    Parameters
    ----------
    title : of the report
    wanted : groups and comparisons
    beside : letterhead, figures as files, pages of tests
    """

    title: str = ""
    wanted: ReportOptions = AS_SHEETS_DIFFER
    beside: ReportContext = NOTHING_BESIDE

    @classmethod
    def read(cls, folder: Path) -> Recipe:
        """Read the recipe of the report in a folder; an empty one where there is none."""
        try:
            kept = json.loads((folder / RECIPE_FILE).read_text(encoding="utf-8"))
            wires = None if kept["wires"] is None else folder / kept["wires"]
            letterhead = Letterhead(
                tuple((name, said) for name, said in kept["letterhead"]), kept["logo"]
            )
            beside = ReportContext(letterhead, tuple(kept["figures"]), kept["pages"])
            return cls(
                kept["title"], ReportOptions(tuple(kept["by"]), kept["compare"], wires), beside
            )
        except (OSError, ValueError, KeyError, TypeError):  # of an earlier labpipe, or changed
            return cls()

    def text(self, folder: Path) -> str:
        """JSON; the wire sheet as seen from the folder of the report."""
        wires, letterhead = self.wanted.wires, self.beside.letterhead
        kept = {
            "title": self.title,
            "by": self.wanted.by,
            "compare": self.wanted.alone,
            "wires": None if wires is None else os.path.relpath(wires, folder),
            "letterhead": letterhead.facts,
            "logo": letterhead.logo,
            "figures": self.beside.formats,
            "pages": self.beside.has_test_pages,
        }
        return json.dumps(kept, indent=1, ensure_ascii=False) + "\n"

    def or_earlier(self, earlier: Recipe) -> Recipe:
        """What this one says, and where it says nothing, what an earlier one said.

        Parameters
        ----------
        earlier : recipe
        """
        own, then = self.beside, earlier.beside
        facts = dict(then.letterhead.facts) | dict(own.letterhead.facts)
        logo = own.letterhead.logo or then.letterhead.logo
        return Recipe(
            self.title or earlier.title,
            ReportOptions(
                self.wanted.by or earlier.wanted.by,
                self.wanted.alone or earlier.wanted.alone,
                self.wanted.wires or earlier.wanted.wires,
            ),
            ReportContext(
                Letterhead(tuple(facts.items()), logo),
                own.formats or then.formats,
                own.has_test_pages or then.has_test_pages,
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
    """A report and where it was written.

    Parameters
    ----------
    folder : holds report.html and tables.xlsx; figures and pages of tests where they are wanted
    campaign : what it shows
    files : all of them, the page first
    """

    folder: Path
    campaign: Campaign
    files: tuple[Path, ...]


def report_tests(
    targets: Sequence[Path],
    *,
    out: Path | None = None,
    title: str = "",
    say: Callable[[str], None] = lambda _: None,
    wanted: ReportOptions = AS_SHEETS_DIFFER,
    beside: ReportContext = NOTHING_BESIDE,
) -> Reported:
    """Put processed tests together into one report.

    Parameters
    ----------
    targets : result.h5 files, or folders that hold some
    out : folder of the report; None for ``report`` in the folder that all tests share
    title : of the report; the name of that folder if empty
    say : is given the name of each test as it is read
    wanted : groups and comparisons
    beside : letterhead, figures as files, pages of tests

    Returns
    -------
    The report and its files.

    Raises
    ------
    LabpipeError
        If there is no processed test, none can be read, two have one name, no test sheet has a
        field that is wanted, the wire sheet has faults, or the report cannot be written; an earlier
        report is then as it was.
    """
    files = find_results(targets)
    shared = shared_folder(files)
    campaign = make_campaign(files, title or shared.resolve().name, say, wanted)
    folder = shared / "report" if out is None else out
    with locked(folder), replacing_together(folder) as stage:
        say("report")
        pages = pages_of(campaign) if beside.has_test_pages else {}
        extras = Extras(beside.letterhead, beside.formats, pages)
        written = write_report(campaign, stage, extras)
        recipe = Recipe(title, wanted, beside).text(folder)
        (stage / RECIPE_FILE).write_text(recipe, encoding="utf-8", newline="\n")
    return Reported(folder, campaign, tuple(folder / path.relative_to(stage) for path in written))


def make_campaign(
    files: Sequence[Path],
    title: str,
    say: Callable[[str], None] = lambda _: None,
    wanted: ReportOptions = AS_SHEETS_DIFFER,
) -> Campaign:
    """Read processed tests one after the other and put them into groups.

    Parameters
    ----------
    files : result.h5 files; one that cannot be read, is made of the same recording as another, or
        was rejected is left out, with the reason
    title : of the report
    say : is given the name of each test as it is read
    wanted : groups and comparisons

    Returns
    -------
    Groups that have the wanted fields and the protocol alike, and how they differ.

    Raises
    ------
    LabpipeError
        If no file can be read, all were rejected, decisions cannot be read, two tests have one
        name, no test sheet has a field that is wanted, or the wire sheet has faults.
    """
    wires = None if wanted.wires is None else read_wire_sheet(wanted.wires)
    read = _read(files, say)
    check_fields(wanted.by, read.samples, "--by")
    check_fields(list(filter(None, [wanted.alone])), read.samples, "--compare")
    groups, by = _groups(read, wanted.by), wanted.by or (TYPE,)
    differences = find_differences(groups, read.wishes, read.settings, by=by, alone=wanted.alone)
    return Campaign(
        title=title,
        groups=tuple(groups),
        differences=differences.shown,
        left_out=read.left_out,
        rejected=read.rejected,
        labpipe_version=__version__,
        by=by,
        compared=wanted.alone,
        pairs_not_shown=differences.pairs_not_shown,
        places=() if wires is None else tuple(find_places(groups, wires)),
        wire_sheet="" if wanted.wires is None else wanted.wires.name,
        rejected_samples=tuple(read.rejected_samples),
        name=name_of_campaign(shared_folder(files)),
        decisions=tuple(map(decision_entry, read.decisions)),
        made_on=datetime.now(tz=UTC).date(),
    )


@dataclass(frozen=True, slots=True)
class _Read:
    """What was read: samples, what protocols say of them, settings by file, what does not count."""

    samples: list[Sample]
    wishes: dict[str, Groups]
    kinds: dict[str, NumberKinds]
    settings: dict[str, Settings]
    left_out: dict[str, str]
    rejected: dict[str, str]
    rejected_samples: list[Sample]
    decisions: list[Decision]


def _read(files: Sequence[Path], say: Callable[[str], None]) -> _Read:
    read = _Read([], {}, {}, {}, {}, {}, [], [])
    decided, shared = decisions_on(files), shared_folder(files)
    recordings: list[tuple[Path, Hashable]] = []
    for file in files:
        say(file.parent.name)
        try:
            drawable = read_drawable(file, frames_at_steps)
            result = drawable.result
            check_summary(result, file.parent / SUMMARY_FILE)
            # What concerns a group is said by its protocol, as each result stored it.
            protocol = parse_protocol(result.protocol_yaml, str(file))
        except LabpipeError as error:
            read.left_out[str(file)] = str(error)
            continue
        specimen = with_sizes(result.specimen, protocol.specimen)
        sized = replace(drawable, result=replace(result, specimen=specimen))
        sample = sample_of(sized, source=str(file), label=label_of(file, shared))
        read.decisions.extend(decided.get(file, ()))
        decision = in_force(decided.get(file, ()), run=result.run)
        if decision is not None:
            sample = replace(sample, decided=decision_sentence(decision))
        if decision is not None and decision.decision == REJECT:
            read.rejected[str(file)] = decision_sentence(decision)
            read.rejected_samples.append(sample)
            continue
        read.wishes[result.protocol] = protocol.groups
        read.kinds[result.protocol] = number_kinds(protocol)
        read.settings[str(file)] = settings_of(protocol)
        recordings.append((file, recording_of(result, protocol)))
        read.samples.append(sample)
    if not read.samples:
        said = [f"{file}: rejected: {why}" for file, why in read.rejected.items()]
        raise UsageError("\n".join([*read.left_out.values(), *said]))
    refuse_repeated([(sample.test, Path(sample.source)) for sample in read.samples], "name")
    copies = find_copies(recordings)
    samples = [sample for sample in read.samples if sample.source not in copies]
    return replace(read, samples=samples, left_out=read.left_out | copies)


def _groups(read: _Read, by: Sequence[str]) -> list[Group]:
    members, by = division(read.samples, by), by or (TYPE,)
    names = group_names(list(members), by)
    groups = []
    for key, name in names.items():
        said = read.wishes[key.protocol], read.kinds[key.protocol]
        group = _group(name, members[key], *said, without(key, by))
        noted = [note.where for note in group.notes if note.code == PROTOCOLS_DIFFER]
        unlike = setting_notes(settings_by_test(group.samples, read.settings), noted)
        groups.append(replace(group, notes=(*unlike, *group.notes)))
    return with_outliers(groups)


def _group(
    name: str,
    members: Sequence[Sample],
    settings: Groups,
    kinds: NumberKinds,
    not_said: Sequence[str],
) -> Group:
    samples, renamed = with_own_spools(members)
    # Results that say something about the specimen, so that no table has to leave any out.
    of_specimens = [
        replace(sample, results=tuple(one for one in sample.results if is_main(one.name)))
        for sample in samples
    ]
    group = build_group(
        name,
        members[0].protocol,
        of_specimens,
        limits=PoolingLimits(min_p=settings.min_p, max_spool_share=settings.max_spool_share),
        scaled=settings.scaled,
        signed=kinds.signed,
        set_by_rig=kinds.set_by_rig,
    )
    numbers = {number.name: number for number in group.numbers}
    first = [numbers.pop(name) for name in settings.main if name in numbers]
    whole = {sample.source: sample for sample in samples}
    return replace(
        group,
        samples=tuple(whole[sample.source] for sample in group.samples),
        numbers=(*first, *numbers.values()),
        notes=(*grouping_notes(not_said, renamed), *group.notes),
    )
