"""Samples of one type are divided by what else of the specimen differs: a length, a tape, a label.

A mean over wires of 85 mm and of 100 mm is the mean of no wire. So the groups of a report are made
by all that the test sheets tell apart; what is pooled all the same is said in notes of the group.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labpipe.records.group import Sample
from labpipe.statistics.group_fields import BORE, NOT_SAID, fields_of, size_words

NEXT_SIZE = 0.05
"""Share by which the next size is larger at least. Nominal sizes are further apart (6 % in R 40 of
ISO 3, the finest series in use); sizes of specimens that were measured one by one are closer."""

_OF_BUNDLES = ("composition", "arrangement", "taping", "tape", "conduit", BORE)
"""In this order: a field that divides no further than those before it is not named."""


@dataclass(frozen=True, slots=True)
class Part:
    """Samples that have alike what others of their type have otherwise.

    Parameters
    ----------
    fields : word by field, such as ``length: 85 mm``; empty where all samples are alike
    samples : at least one
    """

    fields: Mapping[str, str]
    samples: tuple[Sample, ...]


def divide(samples: Sequence[Sample]) -> list[Part]:
    """Divide samples by every dimension and every word of the specimen that differs.

    Parameters
    ----------
    samples : of one type and protocol

    Returns
    -------
    In the order in which they come. A dimension divides where two sizes that are next to each other
    are further apart than `NEXT_SIZE`: specimens that were measured one by one stay together. A
    word divides unless each test has its own: such a label names specimens and is no treatment.
    Spools do not divide; means are nested in them. A field that only repeats the division of others
    is not named.

    Examples
    --------
    Three wires of 85 mm and three of 100 mm are two parts, ``{"length": "85 mm"}`` and
    ``{"length": "100 mm"}``; tapes of 12.4, 12.7 and 12.9 mm width are one.
    """
    keys: list[tuple[str, ...]] = [()] * len(samples)
    named: list[str] = []
    for name, labels in _candidates(samples).items():
        finer = [(*before, word) for before, word in zip(keys, labels, strict=True)]
        if len(set(finer)) > len(set(keys)):
            keys, named = finer, [*named, name]
    return [
        Part(
            dict(zip(named, word, strict=True)),
            tuple(sample for sample, key in zip(samples, keys, strict=True) if key == word),
        )
        for word in dict.fromkeys(keys)
    ]


def _candidates(samples: Sequence[Sample]) -> dict[str, list[str]]:
    """Fields that may divide, with the word of each sample."""
    all_fields = [fields_of(sample.specimen) for sample in samples]
    specimens = [sample.specimen for sample in samples]
    sizes = dict.fromkeys(name for specimen in specimens for name in specimen.dimensions)
    labels = dict.fromkeys(name for specimen in specimens for name in specimen.labels)
    of_bundles = _OF_BUNDLES if any(specimen.bundle for specimen in specimens) else ()
    candidates = {
        name: [fields.get(name, NOT_SAID) for fields in all_fields] for name in of_bundles
    }
    if all(specimen.bundle is None or len(specimen.bundle.wires) == 1 for specimen in specimens):
        candidates.pop("arrangement", None)  # of wires that are all of one kind
    candidates |= {
        name: _sizes([specimen.dimensions.get(name) for specimen in specimens]) for name in sizes
    }
    texts = {name: [fields.get(name, NOT_SAID) for fields in all_fields] for name in labels}
    return candidates | {name: word for name, word in texts.items() if not _names_tests(word)}


def _names_tests(texts: Sequence[str]) -> bool:
    """Tell whether each test has a word of its own, such as a serial number."""
    return max(Counter(texts).values(), default=0) == 1


def _sizes(sizes: Sequence[float | None]) -> list[str]:
    """Word of each size: the mean of those that are not apart, in mm."""
    distinct = sorted({size for size in sizes if size is not None})
    together: list[list[float]] = []
    for size in distinct:
        if together and size <= (1.0 + NEXT_SIZE) * together[-1][-1]:
            together[-1].append(size)
        else:
            together.append([size])
    texts: dict[float | None, str] = {None: NOT_SAID}
    for cluster in together:
        every = [size for size in sizes if size is not None and size in cluster]
        texts |= dict.fromkeys(cluster, size_words(sum(every) / len(every)))
    return [texts[size] for size in sizes]
