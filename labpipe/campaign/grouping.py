"""Group samples, compare their processing settings, and compare groups in pairs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
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

_ABSENT = "none"

Settings = Mapping[str, str]
Unlike = Mapping[str, list[str]]
"""Tests by the value of a setting."""


def settings_of(protocol: Protocol) -> Settings:
    """List the processing settings of a protocol.

    Parameters
    ----------
    protocol : resolved, with the overrides of the test

    Returns
    -------
    Value by dotted key, such as ``results.stiffness_first.from``. Items of a list have their
    name or kind as key; the list itself is included for their order.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return dict(_flat({key: data[key] for key in _SECTIONS if data.get(key) is not None}, ""))


def _flat(data: object, path: str) -> Iterator[tuple[str, str]]:
    inner: dict[str, Any] = {}
    if isinstance(data, dict):
        inner = data
    elif isinstance(data, list) and any(isinstance(item, dict) for item in data):
        times: Counter[str] = Counter()
        for item in data:
            label = next((str(item[key]) for key in ("name", "step", "result") if key in item), "")
            times[label] += 1
            inner[label if times[label] == 1 else f"{label} {times[label]}"] = item
        yield path, ", ".join(inner)
    else:
        yield path, str(data)
    for key, value in inner.items():
        yield from _flat(value, f"{path}.{key}" if path else key)


def setting_notes(settings: Mapping[str, Settings], noted: Sequence[str] = ()) -> list[QualityNote]:
    """Warn if tests that are averaged were processed with different settings.

    Parameters
    ----------
    settings : by test
    noted : results, or ``slips``, with a note on their difference already

    Returns
    -------
    One note ``protocols_differ`` per block of the protocol in which settings differ, at its key if
    it is only one.
    """
    done = tuple(part for name in noted for part in (f"results.{name}.", f"curve.{name}.decision"))
    blocks: dict[str, dict[str, Unlike]] = {}
    for key, tests in differing(settings).items():
        if not key.startswith(done):
            blocks.setdefault(key.partition(".")[0], {})[key] = tests
    notes = []
    for block, differences in blocks.items():
        key, text = next((key, describe_values(tests)) for key, tests in differences.items())
        if len(differences) > 1:
            key, text = block, f"{len(differences)} settings, the first {key}: {text}"
        those = dict.fromkeys(
            test for tests in differences.values() for test in list_minority_tests(tests)
        )
        note = QualityNote.of("campaign.settings_differ", key, text=text)
        notes.append(replace(note, tests=tuple(those)))
    return notes


def differing(settings: Mapping[str, Settings]) -> dict[str, Unlike]:
    """Find the settings that differ among tests.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    Tests by value, by key. If a test lacks an item of a list, the list is returned instead of all
    keys of the item.
    """
    keys = dict.fromkeys(key for values in settings.values() for key in values)
    unlike: dict[str, Unlike] = {}
    for key in keys:
        tests: dict[str, list[str]] = {}
        for test, values in settings.items():
            tests.setdefault(values.get(key, _ABSENT), []).append(test)
        is_listed = _ABSENT in tests and any(key.startswith(f"{parent}.") for parent in unlike)
        if len(tests) > 1 and not is_listed:
            unlike[key] = tests
    return unlike


def settings_by_test(
    samples: Sequence[Sample], settings: Mapping[str, Settings]
) -> dict[str, Settings]:
    """Return settings of samples by test; by file for tests with the same name.

    Parameters
    ----------
    samples : of a group, or of two groups that are compared
    settings : by file
    """
    times = Counter(sample.test for sample in samples)
    return {
        sample.test if times[sample.test] == 1 else sample.source: settings[sample.source]
        for sample in samples
    }


def differing_settings(settings: Mapping[str, Settings]) -> tuple[str, ...]:
    """Describe the settings that differ among the tests of a comparison.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    One text, or none. More than three settings are summarised by blocks of the protocol.
    """
    max_listed = 3
    keys = list(differing(settings))
    if len(keys) > max_listed:
        keys = list(dict.fromkeys(key.partition(".")[0] for key in keys))
    return (format_sentence("campaign.settings_of_pair", keys=", ".join(keys)),) if keys else ()


_WITHOUT = ""
_LENGTH = "length"


class Key(NamedTuple):
    """Fields that the samples of a group share.

    Parameters
    ----------
    field_values : one per grouping field; empty if the sheet does not state it
    protocol : name of the protocol
    more : further fields and values that divide samples with these values, such as a length;
        empty without any, or if the fields were chosen
    """

    field_values: tuple[str, ...]
    protocol: str
    more: tuple[tuple[str, str], ...] = ()


def key_of(sample: Sample, by: Sequence[str]) -> Key:
    """Return the group of a sample.

    Parameters
    ----------
    sample : with or without the fields
    by : grouping fields
    """
    fields = list_fields(sample.specimen)
    return Key(tuple(fields.get(name, _WITHOUT) for name in by), sample.protocol)


def division(samples: Sequence[Sample], by: Sequence[str] = ()) -> dict[Key, list[Sample]]:
    """Divide samples into the groups of a report.

    Parameters
    ----------
    samples : in any order
    by : grouping fields; if empty, the type and all fields of the specimen that differ within
        a type (`divide_samples`)

    Returns
    -------
    Samples by group, in the order of `sort_keys`. Tests of two protocols are in two groups.
    """
    members: dict[Key, list[Sample]] = {}
    for sample in samples:
        members.setdefault(key_of(sample, by or (TYPE,)), []).append(sample)
    if not by:
        members = {
            key._replace(more=tuple(part.fields.items())): list(part.samples)
            for key, group_samples in members.items()
            for part in divide_samples(group_samples)
        }
    return {key: members[key] for key in sort_keys(members, by or (TYPE,))}


def sort_keys(keys: Iterable[Key], by: Sequence[str]) -> list[Key]:
    """Sort groups: types alphabetically, other fields by `make_field_sort_key`.

    Parameters
    ----------
    keys : of the groups
    by : grouping fields
    """

    def turn(key: Key) -> tuple[object, ...]:
        sort_values: list[object] = [
            word if name == TYPE else make_field_sort_key(name, word or NOT_STATED)
            for name, word in zip(by, key.field_values, strict=True)
        ]
        return (
            *sort_values,
            key.protocol,
            *(make_field_sort_key(name, word) for name, word in key.more),
        )

    return sorted(keys, key=turn)


def group_names(keys: Sequence[Key], by: Sequence[str]) -> dict[Key, str]:
    """Name groups by their fields, and by their protocol if two share all fields.

    Parameters
    ----------
    keys : of the groups
    by : grouping fields; a type, or a length that divides a type, is named by its value alone

    Examples
    --------
    >>> list(group_names([Key(("B2", ""), "taped-bundle")], ["wire", "taping"]).values())
    ['wire B2, without taping']
    >>> list(group_names([Key(("A1",), "bend", (("length", "85 mm"),))], ["type"]).values())
    ['A1, 85 mm']
    """
    protocols = Counter(labels for labels, _ in {(key.field_values, key.protocol) for key in keys})
    names = {}
    for key in keys:
        labels = [_word(name, word) for name, word in zip(by, key.field_values, strict=True)]
        labels += [key.protocol] if protocols[key.field_values] > 1 else []
        labels += [word if name == _LENGTH else _word(name, word) for name, word in key.more]
        names[key] = ", ".join(labels)
    return names


def _word(name: str, word: str) -> str:
    label = name.replace("_", " ")
    if word == _WITHOUT:
        return f"without {label}"
    return word if name == TYPE else f"{label} {word}"


def missing_fields(key: Key, by: Sequence[str]) -> list[str]:
    """List the fields that the sheets of a group do not state."""
    return [name for name, word in zip(by, key.field_values, strict=True) if word == _WITHOUT]


def check_fields(wanted: Sequence[str], samples: Sequence[Sample], option: str) -> None:
    """Refuse fields that no test sheet has.

    Parameters
    ----------
    wanted : as typed
    samples : all of the report
    option : of the command line

    Raises
    ------
    UsageError
        If there is one; the message lists the fields, the nearest first.
    """
    fields = list_field_names(sample.specimen for sample in samples)
    unknown = [name for name in wanted if name not in fields]
    if not unknown:
        return
    raise UsageError.about(
        "campaign.unknown_field", option, fields=", ".join(fields),
        found=", ".join(map(repr, unknown)), near=sort_by_likeness(unknown[0], fields, limit=1)[0],
    )  # fmt: skip


def rename_shared_spools(samples: Sequence[Sample]) -> tuple[list[Sample], list[str]]:
    """Rename spools that have the same name in several types.

    Parameters
    ----------
    samples : of one group

    Returns
    -------
    The samples, with the type before the name of such spools; and the original names.
    """
    belong = {(sample.specimen.spool, sample.specimen.type) for sample in samples}
    times = Counter(spool for spool, _ in belong)
    shared = sorted(spool for spool, count in times.items() if count > 1)
    named = []
    for sample in samples:
        specimen = sample.specimen
        if specimen.spool in shared:
            named_spool = replace(specimen, spool=f"{specimen.type} {specimen.spool}")
            sample = replace(sample, specimen=named_spool)  # noqa: PLW2901
        named.append(sample)
    return named, shared


_ORDER = ("wire", "number", "composition", "arrangement", "taping", "tape", "conduit")
"""Fields in the order of a report; others follow."""


QUESTIONS = "answers to questions"
TYPES = "differences of types"
OTHERS = "other main numbers"


@dataclass(frozen=True, slots=True)
class Differences:
    """Differences that a report shows.

    Parameters
    ----------
    listed : by pair
    pairs_not_shown : number of pairs of groups that do not fit `alone`
    """

    listed: tuple[Difference, ...]
    pairs_not_shown: int = 0


def find_differences(
    groups: Sequence[Group],
    wishes: Mapping[str, Groups],
    settings: Mapping[str, Settings],
    *,
    by: Sequence[str],
    alone: str = "",
) -> Differences:
    """Compare groups of the same protocol in its main numbers.

    Parameters
    ----------
    groups : of the report
    wishes : group settings by protocol
    settings : processing settings by file
    by : grouping fields
    alone : list only pairs that differ in this field alone; empty for all

    Returns
    -------
    First the pairs that differ in one field, field by field, with the lower value first: none
    before half-lap, 7 before 12. Only these are judged, in three families: `QUESTIONS`, the first
    main number in pairs that differ in a field of the sheets; `TYPES`, the same in pairs of types;
    `OTHERS`, the other main numbers in all these pairs. Pairs excluded by `alone` are not counted.
    """
    pairs = [
        pair_differences
        for one, other in combinations(groups, 2)
        if one.protocol == other.protocol
        and (pair_differences := _compare(one, other, wishes[one.protocol], settings, by))
    ]
    shown_pairs = [pair for pair in pairs if not alone or list(pair[0].fields) == [alone]]
    flat = [difference for pair in sorted(shown_pairs, key=_question_rank) for difference in pair]
    return Differences(tuple(_judge(flat)), len(pairs) - len(shown_pairs))


def _judge(differences: Sequence[Difference]) -> Iterator[Difference]:
    """Yield differences in order, with verdicts for those of a family."""
    families: dict[str, list[Difference]] = {}
    for difference in differences:
        families.setdefault(difference.family, []).append(difference)
    judged_by_family = {
        family: iter(judge_family(family, members) if family else members)
        for family, members in families.items()
    }
    for difference in differences:
        yield next(judged_by_family[difference.family])


def _question_rank(pair: Sequence[Difference]) -> tuple[int, str]:
    """Return the place of a pair by its field: others follow, then the type, then several."""
    order = (*_ORDER, None, TYPE, "")
    question = pair[0].single_field
    return (order.index(question), "") if question in order else (len(_ORDER), question)


def _compare(
    one: Group, other: Group, options: Groups, settings: Mapping[str, Settings], by: Sequence[str]
) -> list[Difference]:
    """Return the differences of a pair, with their family and caveats."""
    fields = find_differing_fields(one, other, by)
    is_alone = len(fields) == 1
    ((name, (before, after)), *_) = (*fields.items(), ("", ("", "")))
    if (
        is_alone
        and name != TYPE
        and make_field_sort_key(name, after) < make_field_sort_key(name, before)
    ):
        one, other, fields = other, one, {name: (after, before)}
    unlike = differing_settings(settings_by_test((*one.samples, *other.samples), settings))
    names = options.main or tuple(number.name for number in one.numbers[:1])
    compared = compare_groups(one, other, names=names, margin=options.margin)
    family = "" if not is_alone else TYPES if name == TYPE else QUESTIONS
    return [
        replace(
            difference,
            caveats=(*difference.caveats, *unlike),
            fields=fields,
            family=family if number == 0 or not is_alone else OTHERS,
        )
        for number, difference in enumerate(compared)
    ]
