"""Which samples stand together, with which settings, and how groups differ pair by pair."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

from labpipe.errors import UsageError, error_text, nearest
from labpipe.protocol.schema import Groups, Protocol
from labpipe.records.group import Difference, Group, Sample
from labpipe.records.quality import QualityNote, Severity
from labpipe.statistics.group_division import divide
from labpipe.statistics.group_fields import (
    NOT_SAID,
    TYPE,
    differing_fields,
    fields_of,
    in_order,
    known_fields,
)
from labpipe.statistics.group_notes import PROTOCOLS_DIFFER, parted, tests_with_fewer_facts
from labpipe.statistics.groups import compare_groups
from labpipe.statistics.two_groups import judged

_SECTIONS = ("align", "steps", "curve", "branches", "results")
"""What makes numbers of a recording; the rest of a protocol speaks of the sample and its files."""

_ABSENT = "none"
_MOST_KEYS = 3
"""Settings that a verdict names one by one."""

Settings = Mapping[str, str]
Unlike = Mapping[str, list[str]]
"""Tests by the value that a setting has in them."""


def settings_of(protocol: Protocol) -> Settings:
    """List what a protocol says about processing.

    Parameters
    ----------
    protocol : resolved: the overrides of the test are in it

    Returns
    -------
    Value by dotted key, such as ``results.stiffness_first.from``. Items of a list go by their name
    or kind, and the list itself is there too, for their order.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return dict(_flat({key: data[key] for key in _SECTIONS if data.get(key) is not None}, ""))


def _flat(data: object, at: str) -> Iterator[tuple[str, str]]:
    inner: dict[str, Any] = {}
    if isinstance(data, dict):
        inner = {str(key): value for key, value in data.items()}
    elif isinstance(data, list) and any(isinstance(item, dict) for item in data):
        inner = _by_label(data)
        yield at, ", ".join(inner)
    else:
        yield at, str(data)
    for key, value in inner.items():
        yield from _flat(value, f"{at}.{key}" if at else key)


def _by_label(items: Sequence[Any]) -> dict[str, Any]:
    """Items by name, or by kind, with a number where that is taken."""
    found: dict[str, Any] = {}
    times: Counter[str] = Counter()
    for item in items:
        label = next((str(item[key]) for key in ("name", "step", "result") if key in item), "item")
        times[label] += 1
        found[label if times[label] == 1 else f"{label} {times[label]}"] = item
    return found


def setting_notes(settings: Mapping[str, Settings], noted: Sequence[str] = ()) -> list[QualityNote]:
    """Warn where tests that are averaged were processed otherwise.

    Parameters
    ----------
    settings : by test
    noted : results, or ``slips``, whose difference is noted already

    Returns
    -------
    One note ``protocols_differ`` per setting, at its key; of a block of the protocol in which more
    than `_MOST_KEYS` settings differ, as where a test lacks an optional export, one for the block.
    """
    blocks: dict[str, dict[str, Unlike]] = {}
    for key, tests in differing(settings).items():
        if not _is_noted(key, noted):
            blocks.setdefault(key.partition(".")[0], {})[key] = tests
    notes = []
    for block, own in blocks.items():
        named = {key: parted(tests) for key, tests in own.items()}
        shown = named if len(own) <= _MOST_KEYS else {block: _of_block(named)}
        those = tuple(
            dict.fromkeys(test for tests in own.values() for test in tests_with_fewer_facts(tests))
        )
        notes += [
            QualityNote(
                PROTOCOLS_DIFFER,
                Severity.WARNING,
                key,
                f"set otherwise from test to test: {said}",
                tests=those,
            )
            for key, said in shown.items()
        ]
    return notes


def _of_block(own: Mapping[str, str]) -> str:
    """How a block differs, by the first of its settings."""
    key, said = next(iter(own.items()))
    return f"{len(own)} settings, the first {key}: {said}"


def differing(settings: Mapping[str, Settings]) -> dict[str, Unlike]:
    """Find the settings that are not the same in all tests.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    By key, the tests by value. Where a list lacks an item in some test, the list is named and not
    all that the item says.
    """
    keys = dict.fromkeys(key for own in settings.values() for key in own)
    found: dict[str, Unlike] = {}
    for key in keys:
        tests: dict[str, list[str]] = {}
        for test, own in settings.items():
            tests.setdefault(own.get(key, _ABSENT), []).append(test)
        is_told = _ABSENT in tests and any(key.startswith(f"{known}.") for known in found)
        if len(tests) > 1 and not is_told:
            found[key] = tests
    return found


def settings_by_test(
    samples: Sequence[Sample], settings: Mapping[str, Settings]
) -> dict[str, Settings]:
    """Settings of samples by test; of tests of one name, by file.

    Parameters
    ----------
    samples : of one group, or of two that are compared
    settings : by file
    """
    times = Counter(sample.test for sample in samples)
    return {
        sample.test if times[sample.test] == 1 else sample.source: settings[sample.source]
        for sample in samples
    }


def differing_settings(settings: Mapping[str, Settings]) -> tuple[str, ...]:
    """Name the settings that differ among the tests of a comparison; empty where none does.

    Parameters
    ----------
    settings : by test

    Returns
    -------
    Of more than `_MOST_KEYS` settings, the blocks of the protocol that they stand in: the notes of
    the groups have them all.
    """
    keys = list(differing(settings))
    if len(keys) > _MOST_KEYS:
        keys = list(dict.fromkeys(key.partition(".")[0] for key in keys))
    return (f"the tests were processed otherwise: {', '.join(keys)} differ",) if keys else ()


def _is_noted(key: str, noted: Sequence[str]) -> bool:
    return any(key.startswith((f"results.{name}.", f"curve.{name}.decision")) for name in noted)


_WITHOUT = ""
_LENGTH = "length"


class Key(NamedTuple):
    """What the samples of a group have alike.

    Parameters
    ----------
    words : one per field that groups are made by; empty for a sample whose sheet does not say it
    protocol : name of the protocol
    more : field and word of what else they have alike and other samples with these words have
        otherwise, such as a length; empty where nothing differs, or fields were asked for
    """

    words: tuple[str, ...]
    protocol: str
    more: tuple[tuple[str, str], ...] = ()


def key_of(sample: Sample, by: Sequence[str]) -> Key:
    """Tell the group of a sample.

    Parameters
    ----------
    sample : with or without the fields
    by : fields that groups are made by
    """
    own = fields_of(sample.specimen)
    return Key(tuple(own.get(name, _WITHOUT) for name in by), sample.protocol)


def division(samples: Sequence[Sample], by: Sequence[str] = ()) -> dict[Key, list[Sample]]:
    """Put samples into the groups of a report.

    Parameters
    ----------
    samples : in any order
    by : fields that groups are made by, and by no other; if empty, the type and all else of the
        specimen that differs within a type (`divide`)

    Returns
    -------
    Samples by what they have alike, in the order of `in_turn`. Tests of two protocols are in two
    groups.
    """
    members: dict[Key, list[Sample]] = {}
    for sample in samples:
        members.setdefault(key_of(sample, by or (TYPE,)), []).append(sample)
    if not by:
        members = {
            key._replace(more=tuple(part.fields.items())): list(part.samples)
            for key, own in members.items()
            for part in divide(own)
        }
    return {key: members[key] for key in in_turn(members, by or (TYPE,))}


def in_turn(keys: Iterable[Key], by: Sequence[str]) -> list[Key]:
    """Put groups in order: types by the alphabet, other fields as `in_order` says.

    Parameters
    ----------
    keys : of the groups
    by : fields that they were made by
    """

    def turn(key: Key) -> tuple[object, ...]:
        words: list[object] = [
            word if name == TYPE else in_order(name, word or NOT_SAID)
            for name, word in zip(by, key.words, strict=True)
        ]
        return (*words, key.protocol, *(in_order(name, word) for name, word in key.more))

    return sorted(keys, key=turn)


def group_names(keys: Sequence[Key], by: Sequence[str]) -> dict[Key, str]:
    """Name groups after their fields, and their protocol where two share all else.

    Parameters
    ----------
    keys : of the groups
    by : fields that they were made by; of a type, the name is the word alone, and so it is of a
        length that divides a type

    Examples
    --------
    >>> list(group_names([Key(("B2", ""), "taped-bundle")], ["wire", "taping"]).values())
    ['wire B2, without taping']
    >>> list(group_names([Key(("A1",), "bend", (("length", "85 mm"),))], ["type"]).values())
    ['A1, 85 mm']
    """
    protocols = Counter(words for words, _ in {(key.words, key.protocol) for key in keys})
    names = {}
    for key in keys:
        words = [_word(name, word) for name, word in zip(by, key.words, strict=True)]
        words += [key.protocol] if protocols[key.words] > 1 else []
        words += [word if name == _LENGTH else _word(name, word) for name, word in key.more]
        names[key] = ", ".join(words)
    return names


def _word(name: str, word: str) -> str:
    said = name.replace("_", " ")
    if word == _WITHOUT:
        return f"without {said}"
    return word if name == TYPE else f"{said} {word}"


def without(key: Key, by: Sequence[str]) -> list[str]:
    """List the fields that the sheets of a group do not say."""
    return [name for name, word in zip(by, key.words, strict=True) if word == _WITHOUT]


def check_fields(wanted: Sequence[str], samples: Sequence[Sample], option: str) -> None:
    """Refuse fields that no test sheet has.

    Parameters
    ----------
    wanted : as typed
    samples : all of the report
    option : that they were typed behind

    Raises
    ------
    UsageError
        If there is one, with those there are, the nearest first.
    """
    known = known_fields(sample.specimen for sample in samples)
    unknown = [name for name in wanted if name not in known]
    if not unknown:
        return
    best = nearest(unknown[0], known, most=1)[0]
    message = error_text(
        option,
        "",
        expected=f"fields of these test sheets, which are {', '.join(known)}",
        found=", ".join(map(repr, unknown)),
        remedy=f"Write {best}, or another of them.",
    )
    raise UsageError(message)


def with_own_spools(samples: Sequence[Sample]) -> tuple[list[Sample], list[str]]:
    """Tell apart spools of one name that belong to several types.

    Parameters
    ----------
    samples : of one group

    Returns
    -------
    The samples, with the type before the name of such spools; and the names they had.
    """
    belong = {(sample.specimen.spool, sample.specimen.type) for sample in samples}
    times = Counter(spool for spool, _ in belong)
    shared = sorted(spool for spool, count in times.items() if count > 1)
    named = [
        replace(sample, specimen=replace(own, spool=f"{own.type} {own.spool}"))
        if (own := sample.specimen).spool in shared
        else sample
        for sample in samples
    ]
    return named, shared


_ORDER = ("wire", "number", "composition", "arrangement", "taping", "tape", "conduit")
"""Questions in the order of a report; any others follow."""


QUESTIONS = "answers to questions"
TYPES = "differences of types"
OTHERS = "other main numbers"


@dataclass(frozen=True, slots=True)
class Differences:
    """Differences that a report shows.

    Parameters
    ----------
    shown : pair by pair
    pairs_not_shown : of groups, that differ otherwise than was asked for
    """

    shown: tuple[Difference, ...]
    pairs_not_shown: int = 0


def find_differences(
    groups: Sequence[Group],
    wishes: Mapping[str, Groups],
    settings: Mapping[str, Settings],
    *,
    by: Sequence[str],
    alone: str = "",
) -> Differences:
    """Compare groups of one protocol in the numbers that the protocol calls main.

    Parameters
    ----------
    groups : of the report
    wishes : what each protocol says of groups
    settings : by file, what its test was processed with
    by : fields that the groups were made by
    alone : show only pairs that differ in this field and no other; empty for all

    Returns
    -------
    First the pairs that differ in one field, question by question. In those the group that has
    less of it is the first: none before half-lap, 7 before 12. They alone are judged, in three
    families: `QUESTIONS`, the first main number in pairs that differ in a field of the sheets;
    `TYPES`, the same in pairs of types; `OTHERS`, the other main numbers in all these pairs. What
    is left out by `alone` does not count.
    """
    pairs = [
        found
        for one, other in combinations(groups, 2)
        if one.protocol == other.protocol
        and (found := _compared(one, other, wishes[one.protocol], settings, by))
    ]
    shown = [pair for pair in pairs if not alone or list(pair[0].fields) == [alone]]
    flat = [each for pair in sorted(shown, key=_question_first) for each in pair]
    return Differences(tuple(_judged(flat)), len(pairs) - len(shown))


def _judged(differences: Sequence[Difference]) -> Iterator[Difference]:
    """Differences in their order, those that were asked for with verdicts."""
    families: dict[str, list[Difference]] = {}
    for each in differences:
        families.setdefault(each.family, []).append(each)
    found = {
        family: iter(judged(family, own) if family else own) for family, own in families.items()
    }
    for difference in differences:
        yield next(found[difference.family])


def _question_first(pair: Sequence[Difference]) -> tuple[int, str]:
    question = pair[0].question
    if not question:
        return len(_ORDER) + 2, ""
    if question == TYPE:
        return len(_ORDER) + 1, ""
    return (_ORDER.index(question), "") if question in _ORDER else (len(_ORDER), question)


def _compared(
    one: Group,
    other: Group,
    said: Groups,
    settings: Mapping[str, Settings],
    by: Sequence[str],
) -> list[Difference]:
    """Differences of a pair, with what they answer and what speaks against comparing it."""
    fields = differing_fields(one, other, by)
    if len(fields) == 1 and _is_backwards(fields):
        one, other = other, one
        fields = {name: (after, before) for name, (before, after) in fields.items()}
    unlike = differing_settings(settings_by_test((*one.samples, *other.samples), settings))
    names = said.main or tuple(number.name for number in one.numbers[:1])
    compared = compare_groups(one, other, names=names, margin=said.margin)
    return [
        replace(
            each,
            caveats=(*each.caveats, *unlike),
            fields=fields,
            family=_family(list(fields), is_first=each is compared[0]),
        )
        for each in compared
    ]


def _family(fields: Sequence[str], *, is_first: bool) -> str:
    """Which comparisons one is judged with; none where the groups differ in several fields."""
    if len(fields) != 1:
        return ""
    if not is_first:
        return OTHERS
    return TYPES if fields[0] == TYPE else QUESTIONS


def _is_backwards(fields: Mapping[str, tuple[str, str]]) -> bool:
    ((name, (before, after)),) = fields.items()
    return name != "type" and in_order(name, after) < in_order(name, before)
