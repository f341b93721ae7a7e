"""Make the report of a campaign: read processed tests, group and compare them, write its files."""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from labpipe import __version__
from labpipe.campaign.campaign_files import find_campaign_name
from labpipe.campaign.decisions import (
    REJECT,
    Decision,
    find_decision_folder,
    find_decision_in_force,
    read_decisions_by_file,
)
from labpipe.errors import LabpipeError, UsageError, sort_by_likeness
from labpipe.messages import format_sentence
from labpipe.process.output_paths import (
    RecordingIdentity,
    find_copies,
    find_results,
    find_shared_folder,
    identify_recording,
    refuse_duplicates,
)
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.schema import Groups, Protocol, SpecimenBlock
from labpipe.records.arrays import Floats, Ints, average_blocks
from labpipe.records.curve import Branch, Curve, Direction
from labpipe.records.declarations import Output
from labpipe.records.group import (
    BoundedStiffness,
    Campaign,
    Difference,
    Group,
    Sample,
    SampleCurve,
)
from labpipe.records.quality import QualityNote
from labpipe.records.result import Specimen, TestResult
from labpipe.report.figures import choose_frames_at_steps, interpolate_loading_deflection
from labpipe.report.lab_report import render_test, write_report
from labpipe.report.page_tables import compute_report_id, list_samples, name_page_file
from labpipe.report.wording import is_main
from labpipe.statistics.group_samples import (
    NOT_STATED,
    PROTOCOLS_DIFFER,
    TYPE,
    describe_values,
    divide_samples,
    find_differing_fields,
    list_field_names,
    list_fields,
    list_minority_tests,
    make_field_sort_key,
    make_grouping_notes,
)
from labpipe.statistics.groups import build_group, compare_groups
from labpipe.statistics.lots import judge_lot
from labpipe.statistics.means import PoolingLimits
from labpipe.statistics.significance import judge_family, mark_outliers
from labpipe.store.replace import lock, replace_files
from labpipe.store.result_files import read_report_parts, read_result
from labpipe.store.summaries import SUMMARY_FILE, check_summary

_SECTIONS = ("align", "steps", "curve", "branches", "results")
"""Sections of a protocol whose settings are compared among the tests."""

_NO_VALUE = "none"
"""Text in place of the value of a setting that a protocol does not have."""
Settings = Mapping[str, str]
"""Values of settings, keyed by dotted key."""
TestsByValue = Mapping[str, list[str]]
"""Names of tests, keyed by the value of a setting."""


def list_settings(protocol: Protocol) -> Settings:
    """List the processing settings of a protocol.

    Parameters
    ----------
    protocol : resolved protocol, with the overrides of the test

    Returns
    -------
    Values of the settings, keyed by dotted keys such as ``results.stiffness_first.from``. The key
    of an item of a list is its name or its kind, with a number if an earlier item has the same key.
    A list also has an entry of its own, which gives the order of its items.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return dict(
        _flatten_data({key: data[key] for key in _SECTIONS if data.get(key) is not None}, "")
    )


def _flatten_data(data: object, path: str) -> Iterator[tuple[str, str]]:
    """Yield the dotted keys and the values of nested data.

    Parameters
    ----------
    data : mapping, list or value
    path : dotted key of the data; empty for the whole protocol
    """
    items: dict[str, Any] = {}
    if isinstance(data, dict):
        items = data
    elif isinstance(data, list) and any(isinstance(item, dict) for item in data):
        counts: Counter[str] = Counter()
        for item in data:
            label = next((str(item[key]) for key in ("name", "step", "result") if key in item), "")
            counts[label] += 1
            items[label if counts[label] == 1 else f"{label} {counts[label]}"] = item
        yield path, ", ".join(items)
    else:
        yield path, str(data)
    for key, value in items.items():
        yield from _flatten_data(value, f"{path}.{key}" if path else key)


def note_differing_settings(
    settings: Mapping[str, Settings], noted_results: Sequence[str] = ()
) -> list[QualityNote]:
    """Make quality notes on processing settings that differ among the tests of a group.

    Parameters
    ----------
    settings : settings of each test, keyed by test
    noted_results : results, or ``slips``, whose differing settings already have a note

    Returns
    -------
    One note ``protocols_differ`` for each block of the protocol in which settings differ. It names
    the key of the setting. If several settings differ, it names the block, their number and the
    first key.
    """
    noted_keys = tuple(
        key for name in noted_results for key in (f"results.{name}.", f"curve.{name}.decision")
    )
    differences_by_block = defaultdict[str, dict[str, TestsByValue]](dict)
    for key, tests_by_value in find_differing_settings(settings).items():
        if not key.startswith(noted_keys):
            differences_by_block[key.partition(".")[0]][key] = tests_by_value
    notes = []
    for block, differences in differences_by_block.items():
        key = next(iter(differences))
        text = describe_values(differences[key])
        if len(differences) > 1:
            key, text = block, f"{len(differences)} settings, the first {key}: {text}"
        minority = [test for tests in differences.values() for test in list_minority_tests(tests)]
        note = QualityNote.of("campaign.settings_differ", key, text=text)
        notes.append(replace(note, tests=tuple(dict.fromkeys(minority))))
    return notes


def find_differing_settings(settings: Mapping[str, Settings]) -> dict[str, TestsByValue]:
    """Find the settings that differ among tests.

    Parameters
    ----------
    settings : settings of each test, keyed by test

    Returns
    -------
    Tests with each value of a setting, keyed by the dotted key of the setting. If a test lacks an
    item of a list, the key of the list is returned instead of the keys of the item.
    """
    differences: dict[str, TestsByValue] = {}
    for key in dict.fromkeys(key for values in settings.values() for key in values):
        tests = defaultdict[str, list[str]](list)
        for test, test_settings in settings.items():
            tests[test_settings.get(key, _NO_VALUE)].append(test)
        is_in_list = _NO_VALUE in tests and any(key.startswith(f"{path}.") for path in differences)
        if len(tests) > 1 and not is_in_list:
            differences[key] = tests
    return differences


def describe_differing_settings(settings: Mapping[str, Settings]) -> tuple[str, ...]:
    """Describe the settings that differ among the tests of two groups.

    Parameters
    ----------
    settings : settings of each test, keyed by test

    Returns
    -------
    A tuple of one text; empty if no settings differ. The text lists the keys, or only their blocks
    if more than three keys differ.
    """
    max_keys = 3
    keys = list(find_differing_settings(settings))
    if len(keys) > max_keys:
        keys = list(dict.fromkeys(key.partition(".")[0] for key in keys))
    return (format_sentence("campaign.settings_of_pair", keys=", ".join(keys)),) if keys else ()


class GroupKey(NamedTuple):
    """Fields and protocol that the samples of a group have in common.

    Parameters
    ----------
    fields : name and value of each grouping field, and of each field that divides the samples of
        one type, such as a length; the value is empty if the sheet does not state it
    protocol : name of the protocol
    """

    fields: tuple[tuple[str, str], ...]
    protocol: str

    @property
    def missing_fields(self) -> list[str]:
        """Names of the fields that the sheets do not state."""
        return [name for name, value in self.fields if not value]

    @property
    def rank(self) -> tuple[object, ...]:
        """Key that sorts by fields, then by protocol; types are sorted alphabetically."""
        ranks = [
            value if name == TYPE else make_field_sort_key(name, value or NOT_STATED)
            for name, value in self.fields
        ]
        return tuple(ranks), self.protocol


def divide_into_groups(
    samples: Sequence[Sample], grouping_fields: Sequence[str] = ()
) -> dict[GroupKey, list[Sample]]:
    """Divide samples into the groups of a report.

    Parameters
    ----------
    samples : samples in any order
    grouping_fields : names of the fields by which samples are grouped; if empty, the type and all
        fields of the specimen that differ within a type, as `divide_samples` finds them

    Returns
    -------
    Samples of each group, in the order of the groups. Tests of different protocols are in different
    groups.
    """
    groups: dict[GroupKey, list[Sample]] = {}
    for sample in samples:
        stated_fields = list_fields(sample.specimen)
        fields = tuple((name, stated_fields.get(name, "")) for name in grouping_fields or (TYPE,))
        groups.setdefault(GroupKey(fields, sample.protocol), []).append(sample)
    if not grouping_fields:
        groups = {
            key._replace(fields=(*key.fields, *subgroup.fields.items())): list(subgroup.samples)
            for key, members in groups.items()
            for subgroup in divide_samples(members)
        }
    return {key: groups[key] for key in sorted(groups, key=lambda key: key.rank)}


def name_groups(keys: Sequence[GroupKey]) -> dict[GroupKey, str]:
    """Name groups by their fields, and by their protocol if groups of two protocols share them.

    Parameters
    ----------
    keys : keys of the groups

    Returns
    -------
    Names, keyed by group. A type and a length are written without the name of the field.

    Examples
    --------
    >>> keys = [GroupKey((("wire", "B2"), ("taping", "")), "taped-bundle"),
    ...         GroupKey((("type", "A1"), ("length", "85 mm")), "bend")]
    >>> list(name_groups(keys).values())
    ['wire B2, without taping', 'A1, 85 mm']
    """
    n_protocols = Counter(key.fields for key in keys)
    names = {}
    for key in keys:
        labels = [_name_field(*field) for field in key.fields]
        labels += [key.protocol] if n_protocols[key.fields] > 1 else []
        names[key] = ", ".join(labels)
    return names


def _name_field(name: str, value: str) -> str:
    """Write a field and its value as part of the name of a group."""
    label = name.replace("_", " ")
    if not value:
        return f"without {label}"
    return value if name in (TYPE, "length") else f"{label} {value}"


def check_fields(requested_fields: Sequence[str], samples: Sequence[Sample], option: str) -> None:
    """Refuse names of fields that no test sheet has.

    Parameters
    ----------
    requested_fields : names of fields, as typed
    samples : all samples of the report
    option : option of the command line that names the fields

    Raises
    ------
    UsageError
        If a field is in no sheet; the message lists the existing fields.
    """
    existing_fields = list_field_names(sample.specimen for sample in samples)
    unknown_fields = [name for name in requested_fields if name not in existing_fields]
    if unknown_fields:
        raise UsageError.about(
            "campaign.unknown_field", option, fields=", ".join(existing_fields),
            found=", ".join(map(repr, unknown_fields)),
            near=sort_by_likeness(unknown_fields[0], existing_fields, limit=1)[0],
        )  # fmt: skip


def rename_shared_spools(samples: Sequence[Sample]) -> tuple[list[Sample], list[str]]:
    """Rename spools of different types that have the same name.

    Parameters
    ----------
    samples : samples of one group

    Returns
    -------
    renamed_samples : the samples, with the type before the name of such spools
    shared_names : original names of these spools
    """
    spools = {(sample.specimen.type, sample.specimen.spool) for sample in samples}
    n_types = Counter(spool for _, spool in spools)
    shared_names = sorted(spool for spool, count in n_types.items() if count > 1)
    renamed_samples = []
    for sample in samples:
        specimen = sample.specimen
        if specimen.spool in shared_names:
            specimen = replace(specimen, spool=f"{specimen.type} {specimen.spool}")
        renamed_samples.append(replace(sample, specimen=specimen))
    return renamed_samples, shared_names


_FIELD_ORDER = ("wire", "number", "composition", "arrangement", "taping", "tape", "conduit")
"""Fields in the order in which a report compares them; other fields follow."""
QUESTION_FAMILY = "answers to questions"
TYPE_FAMILY = "differences of types"
OTHER_FAMILY = "other main numbers"
"""Families of differences; a verdict is corrected for the number of differences in its family."""


def find_differences(
    groups: Sequence[Group],
    group_settings: Mapping[str, Groups],
    settings: Mapping[str, Settings],
    grouping_fields: Sequence[str],
    *,
    only_field: str = "",
) -> tuple[tuple[Difference, ...], int]:
    """Compare the main numbers of groups that have the same protocol, and judge the differences.

    Parameters
    ----------
    groups : groups of the report
    group_settings : settings for groups, keyed by protocol
    settings : processing settings of each test, keyed by test
    grouping_fields : names of the fields by which the samples are grouped
    only_field : name of a field; pairs that differ in another field are excluded. Empty to include
        all pairs

    Returns
    -------
    differences : differences of all included pairs and numbers
    n_excluded : number of pairs that `only_field` excludes

    Notes
    -----
    Pairs that differ in one field come first, sorted by field. In each pair, the lower value comes
    first: none before half-lap, 7 before 12. Pairs of types keep the order of the groups.

    Only pairs that differ in one field are judged, in three families: `QUESTION_FAMILY`, the first
    main number in pairs that differ in a field other than the type; `TYPE_FAMILY`, the first main
    number in pairs of types; `OTHER_FAMILY`, the other main numbers. If the settings have no main
    numbers, the first number of the first group of a pair is compared.
    """
    pairs = [
        _compare_pair(first, second, group_settings[first.protocol], settings, grouping_fields)
        for first, second in combinations(groups, 2)
        if first.protocol == second.protocol
    ]
    pairs = [pair for pair in pairs if pair]
    included_pairs = [p for p in pairs if not only_field or list(p[0].fields) == [only_field]]
    included_pairs.sort(key=_compute_pair_rank)
    differences = [difference for pair in included_pairs for difference in pair]
    for family in (QUESTION_FAMILY, TYPE_FAMILY, OTHER_FAMILY):
        indices = [n for n, difference in enumerate(differences) if difference.family == family]
        judgements = judge_family(family, [differences[n] for n in indices]) if indices else []
        for index, difference in zip(indices, judgements, strict=True):
            differences[index] = difference
    return tuple(differences), len(pairs) - len(included_pairs)


def _compute_pair_rank(pair: Sequence[Difference]) -> tuple[int, str]:
    """Compute the sort key of a pair of groups by the field in which they differ.

    Pairs that differ in known fields come first, followed by those that differ in other fields, in
    the type, and in several fields.
    """
    known_fields = (*_FIELD_ORDER, None, TYPE, "")
    field = pair[0].single_field
    return (known_fields.index(field), "") if field in known_fields else (len(_FIELD_ORDER), field)


def _compare_pair(
    first: Group,
    second: Group,
    group_settings: Groups,
    settings: Mapping[str, Settings],
    grouping_fields: Sequence[str],
) -> list[Difference]:
    """Compare a pair of groups, and add the family and the caveats to each difference.

    Parameters
    ----------
    first, second : groups of the same protocol
    group_settings : settings for groups of the protocol
    settings : processing settings of each test, keyed by test
    grouping_fields : names of the fields by which the samples are grouped
    """
    fields, family = find_differing_fields(first, second, grouping_fields), ""
    if len(fields) == 1:
        ((name, values),) = fields.items()
        family = TYPE_FAMILY if name == TYPE else QUESTION_FAMILY
        first_key, second_key = (make_field_sort_key(name, value) for value in values)
        if name != TYPE and second_key < first_key:
            first, second, fields = second, first, {name: values[::-1]}
    tests = [sample.test for sample in (*first.samples, *second.samples)]
    caveats = describe_differing_settings({test: settings[test] for test in tests})
    names = group_settings.main or tuple(number.name for number in first.numbers[:1])
    differences = []
    for difference in compare_groups(first, second, names=names, margin=group_settings.margin):
        all_caveats = (*difference.caveats, *caveats)
        differences.append(replace(difference, caveats=all_caveats, fields=fields, family=family))
        family = family and OTHER_FAMILY  # only the first number answers the question
    return differences


OPTIONS_FILE = "report.json"


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """Options of a report, stored in its folder so that it can be made again.

    Parameters
    ----------
    title : title of the report; if empty, the name of the common folder of the tests
    by : names of the fields of the test sheets by which tests are grouped; if empty, the type and
        all fields of the specimen that differ within a type
    alone : name of a field; only pairs of groups that differ in no other field are shown. Empty to
        show all pairs
    wires : path of the wire sheet with which harness bundles are compared; None without one
    letterhead : texts of the letterhead, keyed by name, such as laboratory, customer and order
    logo : picture as a ``data:`` address; may be empty
    formats : formats of the figure files: ``svg``, ``png``, ``pdf``; empty for no files
    has_test_pages : whether each test has a page
    """

    title: str = ""
    by: tuple[str, ...] = ()
    alone: str = ""
    wires: Path | None = None
    letterhead: Mapping[str, str] = field(default_factory=dict)
    logo: str = ""
    formats: tuple[str, ...] = ()
    has_test_pages: bool = False

    @classmethod
    def read(cls, folder: Path) -> ReportOptions:
        """Read the options of the report in a folder.

        The default options are returned if there are none, or if they cannot be read because they
        were edited or written by an earlier labpipe.
        """
        try:
            data = json.loads((folder / OPTIONS_FILE).read_text(encoding="utf-8"))
            wires, logo = data["wires"] and folder / data["wires"], data["logo"]
            lists = {key: tuple(data[key]) for key in ("by", "formats")}
            return cls(**data | lists | {"wires": wires, "logo": logo})
        except (OSError, ValueError, KeyError, TypeError):
            return cls()

    def write_json(self, folder: Path) -> str:
        """Write the options as JSON, with the wire sheet relative to the folder of the report."""
        wires = self.wires and os.path.relpath(self.wires, folder)
        return json.dumps(asdict(self) | {"wires": wires}, indent=1, ensure_ascii=False) + "\n"

    def fill_from(self, earlier_options: ReportOptions) -> ReportOptions:
        """Return the options, in which those of an earlier report replace empty options.

        Parameters
        ----------
        earlier_options : options of the earlier report
        """
        letterhead = {**earlier_options.letterhead, **self.letterhead}
        names = [entry.name for entry in fields(self)]
        options = {name: getattr(self, name) or getattr(earlier_options, name) for name in names}
        return ReportOptions(**options | {"letterhead": letterhead})


DEFAULT_OPTIONS = ReportOptions()


@dataclass(frozen=True, slots=True, eq=False)
class WrittenReport:
    """A report and its files.

    Parameters
    ----------
    folder : folder with report.html, tables.xlsx, and figures and pages of tests if requested
    campaign : content of the report
    files : paths of all files except report.json; the first one is report.html
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
) -> WrittenReport:
    """Make one report from processed tests.

    Parameters
    ----------
    targets : result.h5 files, or folders that contain some
    out : folder of the report; None for ``report`` in the common folder of the tests
    say : function that is called with the folder name of each test before it is read, and with
        ``report`` before the report is written
    options : title, groups, comparisons, letterhead and further files

    Returns
    -------
    The report and its files.

    Raises
    ------
    LabpipeError
        If there is no processed test, no test can be read, all tests were rejected, decisions
        cannot be read, two tests have the same name, no test sheet has a requested field, the wire
        sheet has faults, or the report cannot be written. An earlier report is then unchanged.
    """
    tests = read_tests(find_results(targets), say)
    campaign = make_campaign(tests, options.title or tests.folder.resolve().name, options)
    folder = tests.folder / "report" if out is None else out
    with lock(folder), replace_files(folder) as temporary_folder:
        say("report")
        samples = (*list_samples(campaign), *campaign.rejected_samples)
        report_id, pages = compute_report_id(campaign), dict[str, str]()
        for sample in samples if options.has_test_pages else ():
            page = render_test(read_result(Path(sample.source)), report=report_id)
            pages[name_page_file(sample.label or sample.test)] = page
        written_files = write_report(
            campaign,
            temporary_folder,
            letterhead=options.letterhead,
            logo=options.logo,
            formats=options.formats,
            test_pages=pages,
            is_journal="journal" in {entry.report.style for entry in tests.protocols.values()},
        )
        text = options.write_json(folder)
        (temporary_folder / OPTIONS_FILE).write_text(text, encoding="utf-8", newline="\n")
    paths = tuple(folder / path.relative_to(temporary_folder) for path in written_files)
    return WrittenReport(folder, campaign, paths)


def make_campaign(tests: ReportTests, title: str, options: ReportOptions) -> Campaign:
    """Group tests, and compare the groups.

    Parameters
    ----------
    tests : tests of the report
    title : title of the report; the title of the options is ignored
    options : groups, comparisons and wire sheet

    Returns
    -------
    Groups of equal fields and protocol, and their differences.

    Raises
    ------
    LabpipeError
        If no test sheet has a requested field, or the wire sheet has faults.
    """
    check_fields(options.by, tests.samples, "--by")
    check_fields([options.alone] if options.alone else [], tests.samples, "--compare")
    groups, grouping_fields = _make_groups(tests, options.by), options.by or (TYPE,)
    group_settings = {name: protocol.groups for name, protocol in tests.protocols.items()}
    differences, n_excluded = find_differences(
        groups, group_settings, tests.settings, grouping_fields, only_field=options.alone
    )
    bounded_stiffnesses: list[BoundedStiffness] = []
    if options.wires is not None:
        # imported here, because the import takes a tenth of a second
        from labpipe.mechanics.studies.bundle_bounds import bound_stiffnesses
        from labpipe.mechanics.studies.wire_sheets import read_wire_sheet

        bounded_stiffnesses += bound_stiffnesses(groups, read_wire_sheet(options.wires).specs)
    return Campaign(
        title=title,
        groups=tuple(groups),
        differences=differences,
        failures=tests.left_out,
        rejected=tests.rejected,
        labpipe_version=__version__,
        grouping_fields=grouping_fields,
        compared_field=options.alone,
        pairs_not_shown=n_excluded,
        bounded_stiffnesses=tuple(bounded_stiffnesses),
        wire_sheet="" if options.wires is None else options.wires.name,
        rejected_samples=tuple(tests.rejected_samples),
        name=find_campaign_name(tests.folder),
        decisions=tuple(asdict(decision) for decision in tests.decisions),
        date=datetime.now(tz=UTC).date(),
    )


@dataclass(slots=True)
class ReportTests:
    """The tests of a report.

    Parameters
    ----------
    folder : folder that contains all tests
    samples : samples in order, without those that are left out or rejected
    protocols : last protocol of each name, keyed by name
    settings : processing settings of each test, keyed by test
    left_out, rejected : reason for each test that is left out or rejected, keyed by file
    rejected_samples : samples of the rejected tests, in order
    decisions : all decisions on these tests
    """

    folder: Path
    samples: list[Sample] = field(default_factory=list)
    protocols: dict[str, Protocol] = field(default_factory=dict)
    settings: dict[str, Settings] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    rejected: dict[str, str] = field(default_factory=dict)
    rejected_samples: list[Sample] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)


def read_tests(files: Sequence[Path], say: Callable[[str], object]) -> ReportTests:
    """Read processed tests.

    Parameters
    ----------
    files : result.h5 files; those that are unreadable, repeated or rejected are left out, and the
        reason is given
    say : function that is called with the folder name of each test before it is read

    Raises
    ------
    LabpipeError
        If no file can be read, all tests were rejected, decisions cannot be read, or two tests
        have the same name.
    """
    tests, decisions_by_file = ReportTests(find_shared_folder(files)), read_decisions_by_file(files)
    recordings: list[tuple[Path, RecordingIdentity]] = []
    settings_by_protocol: dict[str, Settings] = {}
    for file in files:
        say(file.parent.name)
        try:
            result, shapes, law = read_report_parts(file, choose_frames)
            check_summary(result, file.parent / SUMMARY_FILE)
            protocol = parse_protocol(result.protocol_yaml, str(file))
        except LabpipeError as error:
            tests.left_out[str(file)] = str(error)
            continue
        sample = replace(
            make_sample(result),
            specimen=add_dimensions(result.specimen, protocol.specimen),
            shapes=shapes,
            law=law,
            source=str(file),
            label=find_decision_folder(file, tests.folder)[1],
        )
        decisions = decisions_by_file.get(file, ())
        tests.decisions.extend(decisions)
        if decision := find_decision_in_force(decisions, run=result.run):
            sample = replace(sample, decision=decision.describe())
            if decision.decision == REJECT:
                tests.rejected[str(file)] = sample.decision
                tests.rejected_samples.append(sample)
                continue
        tests.protocols[result.protocol] = protocol
        if result.protocol_yaml not in settings_by_protocol:
            settings_by_protocol[result.protocol_yaml] = list_settings(protocol)
        tests.settings[sample.test] = settings_by_protocol[result.protocol_yaml]
        recordings.append((file, identify_recording(result, protocol)))
        tests.samples.append(sample)
    if not tests.samples:
        rejections = [f"{file}: rejected: {reason}" for file, reason in tests.rejected.items()]
        raise UsageError("\n".join([*tests.left_out.values(), *rejections]))
    refuse_duplicates([(sample.test, Path(sample.source)) for sample in tests.samples], "name")
    copies = find_copies(recordings)
    tests.samples = [sample for sample in tests.samples if sample.source not in copies]
    tests.left_out |= copies
    return tests


def _make_groups(tests: ReportTests, grouping_fields: Sequence[str]) -> list[Group]:
    """Make the groups of a report, with notes on settings that differ within a group."""
    members, groups = divide_into_groups(tests.samples, grouping_fields), []
    for key, name in name_groups(list(members)).items():
        group = _make_group(name, members[key], tests.protocols[key.protocol], key.missing_fields)
        noted_results = [note.where for note in group.notes if note.code == PROTOCOLS_DIFFER]
        settings = {sample.test: tests.settings[sample.test] for sample in group.samples}
        notes = note_differing_settings(settings, noted_results)
        groups.append(replace(group, notes=(*notes, *group.notes)))
    return mark_outliers(groups)


def _make_group(
    name: str, members: Sequence[Sample], protocol: Protocol, missing_fields: Sequence[str]
) -> Group:
    """Make a group of samples, with the numbers of the results that describe the specimen.

    Parameters
    ----------
    name : name of the group
    members : samples of the group
    protocol : protocol of the samples
    missing_fields : names of grouping fields that the test sheets do not state
    """
    samples, renamed_spools = rename_shared_spools(members)
    grouped_samples = [
        replace(sample, results=tuple(result for result in sample.results if is_main(result.name)))
        for sample in samples
    ]
    settings, outputs = protocol.groups, list_outputs(protocol)
    has_stroke = protocol.rig.stroke is not None
    group = build_group(
        name,
        members[0].protocol,
        grouped_samples,
        limits=PoolingLimits(min_p=settings.min_p, max_spool_share=settings.max_spool_share),
        scaled=settings.scaled,
        signed_names={name for name, output in outputs.items() if output.can_be_negative},
        rig_names={
            name for name, output in outputs.items() if output.is_set_by_stroke and has_stroke
        },
    )
    numbers = {number.name: number for number in group.numbers}
    main_numbers = [numbers.pop(name) for name in settings.main if name in numbers]
    samples_by_source = {sample.source: sample for sample in samples}
    sorted_samples = [samples_by_source[sample.source] for sample in group.samples]
    return replace(
        group,
        samples=tuple(sorted_samples),
        numbers=(*main_numbers, *numbers.values()),
        notes=(*make_grouping_notes(missing_fields, renamed_spools), *group.notes),
        lot=judge_lot(sorted_samples, coverage=settings.coverage, confidence=settings.confidence),
    )


def make_sample(result: TestResult) -> Sample:
    """Make a sample of a report from a processed test.

    Parameters
    ----------
    result : processed test

    Returns
    -------
    The sample without shapes, law, source and label.
    """
    sample_fields, result_fields = (
        {field.name for field in fields(record_type)} for record_type in (Sample, TestResult)
    )
    curve = result.curve
    curves: dict[Direction, list[SampleCurve]] = {direction: [] for direction in Direction}
    if curve is not None:
        for branch in curve.branches:
            curves[branch.direction].append(_average_branch(result, curve, branch))
    return Sample(
        **{name: getattr(result, name) for name in sample_fields & result_fields},
        loading=tuple(curves[Direction.LOADING]),
        unloading=tuple(curves[Direction.UNLOADING]),
    )


def choose_frames(result: TestResult, time: Floats) -> tuple[Ints, Floats]:
    """Choose frames at equal, round steps of deflection in the first loading branch.

    Parameters
    ----------
    result : result of the test, with or without a curve
    time : shape (n_frames,), time of the frames on the clock of the curve, s

    Returns
    -------
    frames : shape (n,), index of the first frame at or beyond each step; empty without a loading
        branch
    deflection : shape (n,), displacement of the curve at these frames, m
    """
    deflection = interpolate_loading_deflection(result, time)
    if deflection is None:
        return np.empty(0, dtype=np.int64), np.empty(0)
    frames = np.unique(choose_frames_at_steps(deflection)[0])
    return frames, deflection[frames]


def _average_branch(result: TestResult, curve: Curve, branch: Branch) -> SampleCurve:
    """Average a branch over blocks of samples.

    A loading branch ends at the failure of the specimen. An unloading branch is reversed in time.
    """
    max_points = 2000  # a block of samples is then narrower than a line in a figure
    is_loading, stop = branch.direction is Direction.LOADING, branch.stop
    values_by_name = {entry.name: entry.value for entry in result.results}
    failure = values_by_name.get("failure_displacement")
    if is_loading and failure is not None:
        indices_beyond = np.flatnonzero(curve.displacement[branch.start : stop] > failure)
        stop = branch.start + int(indices_beyond[0]) if len(indices_beyond) else stop
    raw_force = curve.force if result.aligned is None else result.aligned.series["force"].values
    displacement, force, measured_force = (
        average_blocks(values[branch.start : stop][:: 1 if is_loading else -1], max_points)
        for values in (curve.displacement, curve.force, raw_force)
    )
    return SampleCurve(displacement, force, measured_force=measured_force, cycle=branch.cycle)


def list_outputs(protocol: Protocol) -> dict[str, Output]:
    """List the numbers that the results of a protocol give, keyed by name without cycle number.

    Parameters
    ----------
    protocol : resolved protocol
    """
    outputs: dict[str, Output] = {}
    for entry in protocol.results:
        settings = {field.name: getattr(entry, field.name) for field in fields(entry)}
        outputs |= {output.name.format_map(settings): output for output in entry.outputs}
    return outputs


def add_dimensions(specimen: Specimen, block: SpecimenBlock) -> Specimen:
    """Add the dimensions of the protocol to a specimen; those of its test sheet have priority.

    Parameters
    ----------
    specimen : specimen as described by its test sheet
    block : specimen in the resolved protocol, with the overrides of the test
    """
    section = {} if block.section is None else {**vars(block.section)}
    section.pop("area", None)  # an area is not a length
    sizes = {"length": block.length, "span": block.span, **section}
    dimensions = {name: size for name, size in sizes.items() if size is not None}
    return replace(specimen, dimensions={**dimensions, **specimen.dimensions})
