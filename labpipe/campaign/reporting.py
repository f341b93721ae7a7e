"""Make the report of a campaign from processed tests."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Hashable, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path

from labpipe import __version__
from labpipe.campaign.campaign_folders import name_of_campaign
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    applicable_decision,
    decision_entry,
    decision_sentence,
    decisions_on,
    label_of,
)
from labpipe.campaign.grouping import (
    Settings,
    check_fields,
    division,
    find_differences,
    group_names,
    missing_fields,
    rename_shared_spools,
    setting_notes,
    settings_by_test,
    settings_of,
)
from labpipe.campaign.report_samples import (
    NumberKinds,
    add_sizes,
    frames_at_steps,
    number_kinds,
    sample_of,
)
from labpipe.errors import LabpipeError, UsageError
from labpipe.mechanics.studies.bundle_bounds import find_places
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.process.output_paths import (
    find_copies,
    find_results,
    recording_of,
    refuse_repeated,
    shared_folder,
)
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Groups
from labpipe.records.group import Campaign, Group, LotRule, Sample
from labpipe.report.lab_report import PLAIN, Extras, Letterhead, write_report
from labpipe.report.page_facts import compute_report_id, list_samples
from labpipe.report.page_tables import name_page_file
from labpipe.report.single_test import render_test
from labpipe.report.wording import is_main
from labpipe.statistics.group_fields import TYPE
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER, make_grouping_notes
from labpipe.statistics.groups import PoolingLimits, build_group
from labpipe.statistics.lots import judge_lot
from labpipe.statistics.outliers import mark_outliers
from labpipe.store.read import read_reported, read_result
from labpipe.store.replace import locked, replacing_together
from labpipe.store.summaries import SUMMARY_FILE, check_summary

RECIPE_FILE = "report.json"


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """Options of a report, stored beside it to make it again.

    Parameters
    ----------
    title : of the report; if empty, the name of the common folder of the tests
    by : fields of the test sheets to group by; if empty, the type and all fields of the specimen
        that differ within a type
    alone : show only pairs of groups that differ in this field alone; empty for all
    wires : wire sheet, for the bounds of harness bundles
    letterhead : laboratory, customer and order
    formats : of figure files: ``svg``, ``png``, ``pdf``; empty for no files
    has_test_pages : whether each test has a page
    """

    title: str = ""
    by: tuple[str, ...] = ()
    alone: str = ""
    wires: Path | None = None
    letterhead: Letterhead = PLAIN
    formats: tuple[str, ...] = ()
    has_test_pages: bool = False

    @classmethod
    def read(cls, folder: Path) -> ReportOptions:
        """Read the options of the report in a folder; without any, return empty ones."""
        try:
            stored = json.loads((folder / RECIPE_FILE).read_text(encoding="utf-8"))
            facts, logo = (stored["letterhead"][key] for key in ("facts", "logo"))
            stored["letterhead"] = Letterhead(tuple((name, text) for name, text in facts), logo)
            stored["wires"] = stored["wires"] and folder / stored["wires"]
            return cls(**stored | {key: tuple(stored[key]) for key in ("by", "formats")})
        except (OSError, ValueError, KeyError, TypeError):  # of an earlier labpipe, or edited
            return cls()

    def text(self, folder: Path) -> str:
        """Write JSON, with the wire sheet relative to the folder of the report."""
        wires = self.wires and os.path.relpath(self.wires, folder)
        return json.dumps(asdict(self) | {"wires": wires}, indent=1, ensure_ascii=False) + "\n"

    def or_earlier(self, earlier: ReportOptions) -> ReportOptions:
        """Fill the missing options from those of an earlier report.

        Parameters
        ----------
        earlier : options
        """
        own, then = self.letterhead, earlier.letterhead
        facts = dict(then.facts) | dict(own.facts)
        letterhead = Letterhead(tuple(facts.items()), own.logo or then.logo)
        names = [entry.name for entry in fields(self)]
        filled = {name: getattr(self, name) or getattr(earlier, name) for name in names}
        return ReportOptions(**filled | {"letterhead": letterhead})


DEFAULT_OPTIONS = ReportOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
    """A report and its files.

    Parameters
    ----------
    folder : with report.html, tables.xlsx, and optional figures and pages of tests
    campaign : its content
    files : the page first
    """

    folder: Path
    campaign: Campaign
    files: tuple[Path, ...]


def report_tests(
    targets: Sequence[Path],
    *,
    out: Path | None = None,
    say: Callable[[str], None] = lambda _: None,
    options: ReportOptions = DEFAULT_OPTIONS,
) -> Reported:
    """Make one report from processed tests.

    Parameters
    ----------
    targets : result.h5 files, or folders with some
    out : folder of the report; None for ``report`` in the common folder of the tests
    say : called with the name of each test when it is read
    options : title, groups, letterhead and further files

    Returns
    -------
    The report and its files.

    Raises
    ------
    LabpipeError
        If there is no processed test, none can be read, two have the same name, no test sheet has a
        requested field, the wire sheet has faults, or the report cannot be written; an earlier
        report is then unchanged.
    """
    files = find_results(targets)
    shared = shared_folder(files)
    read = _read_tests(files, say)
    campaign = _campaign_of(read, files, options.title or shared.resolve().name, options)
    folder = shared / "report" if out is None else out
    with locked(folder), replacing_together(folder) as stage:
        say("report")
        paged = (*list_samples(campaign), *campaign.rejected_samples)
        pages = {
            name_page_file(sample.label or sample.test): page_of_test(
                Path(sample.source), compute_report_id(campaign)
            )
            for sample in (paged if options.has_test_pages else ())
        }
        extras = Extras(options.letterhead, options.formats, pages, "journal" in read.styles)
        written = write_report(campaign, stage, extras)
        recipe = options.text(folder)
        (stage / RECIPE_FILE).write_text(recipe, encoding="utf-8", newline="\n")
    return Reported(folder, campaign, tuple(folder / path.relative_to(stage) for path in written))


def make_campaign(
    files: Sequence[Path],
    title: str,
    say: Callable[[str], None] = lambda _: None,
    options: ReportOptions = DEFAULT_OPTIONS,
) -> Campaign:
    """Read processed tests and group them.

    Parameters
    ----------
    files : result.h5 files; unreadable, repeated and rejected ones are left out with the reason
    title : of the report
    say : called with the name of each test when it is read
    options : groups and comparisons

    Returns
    -------
    Groups of equal fields and protocol, and their differences.

    Raises
    ------
    LabpipeError
        If no file can be read, all were rejected, decisions cannot be read, two tests have the same
        name, no test sheet has a requested field, or the wire sheet has faults.
    """
    return _campaign_of(_read_tests(files, say), files, title, options)


def _campaign_of(
    read: _ReadTests, files: Sequence[Path], title: str, options: ReportOptions
) -> Campaign:
    wires = None if options.wires is None else read_wire_sheet(options.wires)
    check_fields(options.by, read.samples, "--by")
    check_fields(list(filter(None, [options.alone])), read.samples, "--compare")
    groups, by = _groups(read, options.by), options.by or (TYPE,)
    differences = find_differences(groups, read.wishes, read.settings, by=by, alone=options.alone)
    return Campaign(
        title=title,
        groups=tuple(groups),
        differences=differences.listed,
        left_out=read.left_out,
        rejected=read.rejected,
        labpipe_version=__version__,
        by=by,
        compared=options.alone,
        pairs_not_shown=differences.pairs_not_shown,
        places=() if wires is None else tuple(find_places(groups, wires)),
        wire_sheet="" if options.wires is None else options.wires.name,
        rejected_samples=tuple(read.rejected_samples),
        name=name_of_campaign(shared_folder(files)),
        decisions=tuple(map(decision_entry, read.decisions)),
        made_on=datetime.now(tz=UTC).date(),
    )


@dataclass(slots=True)
class _ReadTests:
    """Samples with settings of their protocols, and tests that are left out or rejected."""

    samples: list[Sample] = field(default_factory=list)
    wishes: dict[str, Groups] = field(default_factory=dict)
    kinds: dict[str, NumberKinds] = field(default_factory=dict)
    settings: dict[str, Settings] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    rejected: dict[str, str] = field(default_factory=dict)
    rejected_samples: list[Sample] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    styles: set[str] = field(default_factory=set)


def _read_tests(files: Sequence[Path], say: Callable[[str], None]) -> _ReadTests:
    read = _ReadTests()
    decided, shared = decisions_on(files), shared_folder(files)
    recordings: list[tuple[Path, Hashable]] = []
    for file in files:
        say(file.parent.name)
        try:
            drawable = read_reported(file, frames_at_steps)
            result = drawable.result
            check_summary(result, file.parent / SUMMARY_FILE)
            # Group settings come from the protocol stored in each result.
            protocol = parse_protocol(result.protocol_yaml, str(file))
        except LabpipeError as error:
            read.left_out[str(file)] = str(error)
            continue
        specimen = add_sizes(result.specimen, protocol.specimen)
        sized = replace(drawable, result=replace(result, specimen=specimen))
        sample = sample_of(sized, source=str(file), label=label_of(file, shared))
        read.decisions.extend(decided.get(file, ()))
        decision = applicable_decision(decided.get(file, ()), run=result.run)
        if decision is not None:
            sample = replace(sample, decision=decision_sentence(decision))
        if decision is not None and decision.decision == REJECT:
            read.rejected[str(file)] = sample.decision
            read.rejected_samples.append(sample)
            continue
        read.styles.add(protocol.report.style)
        read.wishes[result.protocol] = protocol.groups
        read.kinds[result.protocol] = number_kinds(protocol)
        read.settings[str(file)] = settings_of(protocol)
        recordings.append((file, recording_of(result, protocol)))
        read.samples.append(sample)
    if not read.samples:
        rejections = [f"{file}: rejected: {why}" for file, why in read.rejected.items()]
        raise UsageError("\n".join([*read.left_out.values(), *rejections]))
    refuse_repeated([(sample.test, Path(sample.source)) for sample in read.samples], "name")
    copies = find_copies(recordings)
    read.samples = [sample for sample in read.samples if sample.source not in copies]
    read.left_out |= copies
    return read


def _groups(read: _ReadTests, by: Sequence[str]) -> list[Group]:
    members, by = division(read.samples, by), by or (TYPE,)
    names = group_names(list(members), by)
    groups = []
    for key, name in names.items():
        facts = read.wishes[key.protocol], read.kinds[key.protocol]
        group = _group(name, members[key], *facts, missing_fields(key, by))
        noted = [note.where for note in group.notes if note.code == PROTOCOLS_DIFFER]
        unlike = setting_notes(settings_by_test(group.samples, read.settings), noted)
        groups.append(replace(group, notes=(*unlike, *group.notes)))
    return mark_outliers(groups)


def _group(
    name: str,
    members: Sequence[Sample],
    settings: Groups,
    kinds: NumberKinds,
    not_said: Sequence[str],
) -> Group:
    samples, renamed = rename_shared_spools(members)
    # Only results that describe the specimen.
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
    by_source = {sample.source: sample for sample in samples}
    return replace(
        group,
        samples=tuple(by_source[sample.source] for sample in group.samples),
        numbers=(*first, *numbers.values()),
        notes=(*make_grouping_notes(not_said, renamed), *group.notes),
        lot=judge_lot(
            [by_source[sample.source] for sample in group.samples],
            LotRule(settings.coverage, settings.confidence),
        ),
    )


def page_of_test(file: Path, report: str = "") -> str:
    """Make the page of a test: facts, numbers and figures.

    Parameters
    ----------
    file : its result.h5
    report : id of the report that links to it; empty for none

    Returns
    -------
    A self-contained HTML document without scripts.

    Raises
    ------
    StoreError
        If the result cannot be read.
    """
    return render_test(read_result(file), report=report)
