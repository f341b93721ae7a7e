"""Divide the samples of a report into groups, check their settings, and compare the groups."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

from labpipe.errors import UsageError, sort_by_likeness
from labpipe.messages import format_sentence
from labpipe.protocol.schema import Groups, Protocol
from labpipe.records.group import Difference, Group, Sample
from labpipe.records.quality import QualityNote
from labpipe.statistics.group_fields import (
    NOT_STATED,
    TYPE,
    divide_samples,
    find_differing_fields,
    list_field_names,
    list_fields,
    make_field_sort_key,
)
from labpipe.statistics.group_notes import describe_values, list_minority_tests
from labpipe.statistics.groups import compare_groups
from labpipe.statistics.two_groups import judge_family

_SECTIONS = ("align", "steps", "curve", "branches", "results")
"""Sections of a protocol that control processing; the rest describes the sample and files."""

_NO_VALUE = "none"
"""Value of a setting that a protocol does not have."""
Settings = Mapping[str, str]
"""Value by dotted key."""
TestsByValue = Mapping[str, list[str]]
"""Tests by the value of a setting."""


def list_settings(protocol: Protocol) -> Settings:
    """List the processing settings of a protocol.

    Parameters
    ----------
    protocol : resolved, with the overrides of the test

    Returns
    -------
    Values by dotted keys such as ``results.stiffness_first.from``. Items of a list have their name
    or kind as key. A list also has an entry of its own, which states the order of the items.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return dict(_flatten({key: data[key] for key in _SECTIONS if data.get(key) is not None}, ""))


def _flatten(data: object, path: str) -> Iterator[tuple[str, str]]:
    """Yield dotted keys and values of nested data below a path."""
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
        yield from _flatten(value, f"{path}.{key}" if path else key)


def note_differing_settings(
    settings: Mapping[str, Settings], noted_results: Sequence[str] = ()
) -> list[QualityNote]:
    """Make quality notes on settings of processing that differ among the tests of a group.

    Parameters
    ----------
    settings : by test
    noted_results : results, or ``slips``, whose differing settings already have a note

    Returns
    -------
    One note ``protocols_differ`` for each block of the protocol in which settings differ. It is
    placed at the key of the setting, or at the block if several settings differ.
    """
    noted_keys = tuple(
        key for name in noted_results for key in (f"results.{name}.", f"curve.{name}.decision")
    )
    blocks = defaultdict[str, dict[str, TestsByValue]](dict)
    for key, tests in find_differing_settings(settings).items():
        if not key.startswith(noted_keys):
            blocks[key.partition(".")[0]][key] = tests
    notes = []
    for block, differences in blocks.items():
        key, text = next((key, describe_values(tests)) for key, tests in differences.items())
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
    settings : by test

    Returns
    -------
    Tests by value, by key. If a test lacks an item of a list, the list is returned instead of the
    keys of the item.
    """
    differing: dict[str, TestsByValue] = {}
    for key in dict.fromkeys(key for values in settings.values() for key in values):
        tests = defaultdict[str, list[str]](list)
        for test, values in settings.items():
            tests[values.get(key, _NO_VALUE)].append(test)
        is_in_list = _NO_VALUE in tests and any(key.startswith(f"{path}.") for path in differing)
        if len(tests) > 1 and not is_in_list:
            differing[key] = tests
    return differing


def describe_differing_settings(settings: Mapping[str, Settings]) -> tuple[str, ...]:
    """Describe the settings that differ among the tests of two groups.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    A single text; none if no settings differ. More than three are summarised by block.
    """
    max_listed = 3
    keys = list(find_differing_settings(settings))
    if len(keys) > max_listed:
        keys = list(dict.fromkeys(key.partition(".")[0] for key in keys))
    return (format_sentence("campaign.settings_of_pair", keys=", ".join(keys)),) if keys else ()


class GroupKey(NamedTuple):
    """Fields that the samples of a group share.

    Parameters
    ----------
    fields : name and value of each grouping field; an empty value if the sheet does not state it
    protocol : name of the protocol
    subdivision : name and value of each field that divides the samples of one type, such as a
        length; empty if the grouping fields were chosen
    """

    fields: tuple[tuple[str, str], ...]
    protocol: str
    subdivision: tuple[tuple[str, str], ...] = ()

    @property
    def missing_fields(self) -> list[str]:
        """Return the grouping fields that the sheets do not state."""
        return [name for name, value in self.fields if not value]

    @property
    def rank(self) -> tuple[object, ...]:
        """Return the sort key: types alphabetically, other fields by size or alphabetically."""
        ranks = [
            value if name == TYPE else make_field_sort_key(name, value or NOT_STATED)
            for name, value in self.fields
        ]
        return (*ranks, self.protocol, *(make_field_sort_key(*field) for field in self.subdivision))


def divide_into_groups(
    samples: Sequence[Sample], by: Sequence[str] = ()
) -> dict[GroupKey, list[Sample]]:
    """Divide samples into the groups of a report.

    Parameters
    ----------
    samples : in any order
    by : grouping fields; if empty, the type and all fields of the specimen that differ within
        a type (`divide_samples`)

    Returns
    -------
    Samples by group, sorted. Tests of different protocols are in different groups.
    """
    members = defaultdict[GroupKey, list[Sample]](list)
    for sample in samples:
        stated = list_fields(sample.specimen)
        fields = tuple((name, stated.get(name, "")) for name in by or (TYPE,))
        members[GroupKey(fields, sample.protocol)].append(sample)
    if by:
        return {key: members[key] for key in sorted(members, key=lambda key: key.rank)}
    parts = {
        key._replace(subdivision=tuple(part.fields.items())): list(part.samples)
        for key, group_samples in members.items()
        for part in divide_samples(group_samples)
    }
    return {key: parts[key] for key in sorted(parts, key=lambda key: key.rank)}


def name_groups(keys: Sequence[GroupKey]) -> dict[GroupKey, str]:
    """Name groups by their fields, and by their protocol if groups of two share all fields.

    Parameters
    ----------
    keys : of the groups; a type, and a length within a type, are written without the field name

    Examples
    --------
    >>> keys = [GroupKey((("wire", "B2"), ("taping", "")), "taped-bundle"),
    ...         GroupKey((("type", "A1"),), "bend", (("length", "85 mm"),))]
    >>> list(name_groups(keys).values())
    ['wire B2, without taping', 'A1, 85 mm']
    """
    n_protocols = Counter(fields for fields, _ in {key[:2] for key in keys})
    names = {}
    for key in keys:
        labels = [_name_field(*field, unlabelled=TYPE) for field in key.fields]
        labels += [key.protocol] if n_protocols[key.fields] > 1 else []
        names[key] = ", ".join(
            [*labels, *(_name_field(*field, unlabelled="length") for field in key.subdivision)]
        )
    return names


def _name_field(name: str, value: str, *, unlabelled: str) -> str:
    label = name.replace("_", " ")
    if not value:
        return f"without {label}"
    return value if name == unlabelled else f"{label} {value}"


def check_fields(requested: Sequence[str], samples: Sequence[Sample], option: str) -> None:
    """Refuse fields that no test sheet has.

    Parameters
    ----------
    requested : as typed
    samples : all of the report
    option : of the command line

    Raises
    ------
    UsageError
        If there is such a field; the message lists the existing fields.
    """
    fields = list_field_names(sample.specimen for sample in samples)
    unknown = [name for name in requested if name not in fields]
    if not unknown:
        return
    raise UsageError.about(
        "campaign.unknown_field", option, fields=", ".join(fields),
        found=", ".join(map(repr, unknown)), near=sort_by_likeness(unknown[0], fields, limit=1)[0],
    )  # fmt: skip


def rename_shared_spools(samples: Sequence[Sample]) -> tuple[list[Sample], list[str]]:
    """Rename spools of different types that have the same name.

    Parameters
    ----------
    samples : of one group

    Returns
    -------
    The samples, with the type before the name of such spools; and the original names of these
    spools.
    """
    specimens = [sample.specimen for sample in samples]
    n_types = Counter(
        spool for spool, _ in {(specimen.spool, specimen.type) for specimen in specimens}
    )
    renamed = [
        replace(specimen, spool=f"{specimen.type} {specimen.spool}")
        if n_types[specimen.spool] > 1
        else specimen
        for specimen in specimens
    ]
    pairs = zip(samples, renamed, strict=True)
    shared = sorted(spool for spool, count in n_types.items() if count > 1)
    return [replace(sample, specimen=specimen) for sample, specimen in pairs], shared


_FIELD_ORDER = ("wire", "number", "composition", "arrangement", "taping", "tape", "conduit")
"""Fields in the order of a report; others follow."""
QUESTIONS = "answers to questions"
TYPES = "differences of types"
OTHERS = "other main numbers"
"""Families of differences: verdicts are corrected for the number of differences in their family."""


def find_differences(
    groups: Sequence[Group],
    group_settings: Mapping[str, Groups],
    settings: Mapping[str, Settings],
    *,
    by: Sequence[str],
    alone: str = "",
) -> tuple[tuple[Difference, ...], int]:
    """Compare the main numbers of groups that have the same protocol.

    Parameters
    ----------
    groups : of the report
    group_settings : settings of groups, by protocol
    settings : processing settings, by test
    by : grouping fields
    alone : list only pairs that differ in no other field; empty for all

    Returns
    -------
    differences : see the notes
    n_hidden : number of pairs that `alone` excludes

    Notes
    -----
    Pairs that differ in one field come first, sorted by field; in each pair the lower value comes
    first: none before half-lap, 7 before 12. Only these pairs are judged, in three families:
    `QUESTIONS`, the first main number in pairs that differ in a field of the sheets; `TYPES`, the
    same in pairs of types; `OTHERS`, the other main numbers in all these pairs. Pairs that `alone`
    excludes are not judged.
    """
    pairs = [
        _compare(first, second, group_settings[first.protocol], settings, by)
        for first, second in combinations(groups, 2)
        if first.protocol == second.protocol
    ]
    pairs = [pair for pair in pairs if pair]
    shown = [pair for pair in pairs if not alone or list(pair[0].fields) == [alone]]
    differences = [difference for pair in sorted(shown, key=_rank_pair) for difference in pair]
    for family in (QUESTIONS, TYPES, OTHERS):
        indices = [n for n, difference in enumerate(differences) if difference.family == family]
        judged = judge_family(family, [differences[n] for n in indices]) if indices else []
        for index, difference in zip(indices, judged, strict=True):
            differences[index] = difference
    return tuple(differences), len(pairs) - len(shown)


def _rank_pair(pair: Sequence[Difference]) -> tuple[int, str]:
    """Return the sort key of a pair: known fields, other fields, the type, then several fields."""
    order = (*_FIELD_ORDER, None, TYPE, "")
    field = pair[0].single_field
    return (order.index(field), "") if field in order else (len(_FIELD_ORDER), field)


def _compare(
    first: Group,
    second: Group,
    group_settings: Groups,
    settings: Mapping[str, Settings],
    by: Sequence[str],
) -> list[Difference]:
    """Compare a pair of groups; add the family and the caveats to each difference."""
    fields, family = find_differing_fields(first, second, by), ""
    if len(fields) == 1:
        ((name, (low, high)),) = fields.items()
        family = TYPES if name == TYPE else QUESTIONS
        if name != TYPE and make_field_sort_key(name, high) < make_field_sort_key(name, low):
            first, second, fields = second, first, {name: (high, low)}
    tests = [sample.test for sample in (*first.samples, *second.samples)]
    caveats = describe_differing_settings({test: settings[test] for test in tests})
    names = group_settings.main or tuple(number.name for number in first.numbers[:1])
    compared = compare_groups(first, second, names=names, margin=group_settings.margin)
    return [
        replace(
            difference,
            caveats=(*difference.caveats, *caveats),
            fields=fields,
            family=OTHERS if family and number else family,
        )
        for number, difference in enumerate(compared)
    ]
