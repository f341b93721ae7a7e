"""Which samples stand together: groups by fields of their test sheets, with names and order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

from labpipe.errors import UsageError, complaint, nearest
from labpipe.records.group import Sample
from labpipe.statistics.group_fields import NOT_SAID, TYPE, fields_of, in_order, known_fields

_WITHOUT = ""


class Key(NamedTuple):
    """What the samples of a group have alike.

    Parameters
    ----------
    words : one per field that groups are made by; empty for a sample whose sheet does not say it
    protocol : name of the protocol
    """

    words: tuple[str, ...]
    protocol: str


def key_of(sample: Sample, by: Sequence[str]) -> Key:
    """Tell the group of a sample.

    Parameters
    ----------
    sample : with or without the fields
    by : fields that groups are made by
    """
    own = fields_of(sample.specimen)
    return Key(tuple(own.get(name, _WITHOUT) for name in by), sample.protocol)


def in_turn(keys: Iterable[Key], by: Sequence[str]) -> list[Key]:
    """Put groups in order: types by the alphabet, other fields as `in_order` says.

    Parameters
    ----------
    keys : of the groups
    by : fields that they were made by
    """

    def turn(key: Key) -> tuple[object, ...]:
        words = zip(by, key.words, strict=True)
        return *(_turn(name, word) for name, word in words), key.protocol

    return sorted(keys, key=turn)


def _turn(name: str, word: str) -> object:
    return word if name == TYPE else in_order(name, word or NOT_SAID)


def group_names(keys: Sequence[Key], by: Sequence[str]) -> dict[Key, str]:
    """Name groups after their fields, and their protocol where two share all else.

    Parameters
    ----------
    keys : of the groups
    by : fields that they were made by; of a type, the name is the word alone

    Examples
    --------
    >>> list(group_names([Key(("B2", ""), "taped-bundle")], ["wire", "taping"]).values())
    ['wire B2, without taping']
    """
    times = Counter(key.words for key in keys)
    return {
        key: ", ".join([*_words(key, by), *([key.protocol] if times[key.words] > 1 else [])])
        for key in keys
    }


def _words(key: Key, by: Sequence[str]) -> list[str]:
    return [_word(name, word) for name, word in zip(by, key.words, strict=True)]


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
    message = complaint(
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
    return [_with_own_spool(sample, shared) for sample in samples], shared


def _with_own_spool(sample: Sample, shared: Sequence[str]) -> Sample:
    own = sample.specimen
    if own.spool not in shared:
        return sample
    return replace(sample, specimen=replace(own, spool=f"{own.type} {own.spool}"))
