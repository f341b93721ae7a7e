"""Division of the samples of one type by all other differences: a length, a tape, a label.

A mean over wires of 85 mm and of 100 mm has no meaning. So the groups of a report are divided by
all differences in the test sheets; what is pooled nevertheless is named in notes of the group.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from labpipe.records.group import Sample
from labpipe.statistics.group_fields import BORE, NOT_SAID, fields_of, size_words

_OF_BUNDLES = ("composition", "arrangement", "taping", "tape", "conduit", BORE)
"""In order: a field that divides no further than those before it is not named."""


@dataclass(frozen=True, slots=True)
class Part:
    """Samples of a type that have the same fields.

    Parameters
    ----------
    fields : value by field, such as ``length: 85 mm``; empty if all samples are alike
    samples : at least one
    """

    fields: Mapping[str, str]
    samples: tuple[Sample, ...]


def divide(samples: Sequence[Sample]) -> list[Part]:
    """Divide samples by every dimension and every field of the specimen that differs.

    Parameters
    ----------
    samples : of one type and protocol

    Returns
    -------
    In their first order. A dimension divides between adjacent sizes that differ by more than
    5 %, so that individually measured specimens stay together. A field divides unless
    each test has its own value: such a label names specimens and is not a treatment. Spools do not
    divide; means are nested in them. A field that only repeats the division of others is not named.

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
    """Return the fields that may divide, with the value of each sample."""
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
    """Return whether each test has its own value, such as a serial number."""
    return max(Counter(texts).values(), default=0) == 1


def _sizes(sizes: Sequence[float | None]) -> list[str]:
    """Return the text of each size: the mean of its cluster, in mm."""
    # Smallest step between sizes, as a share. Nominal sizes differ by more (6 % in R 40 of ISO 3,
    # the finest series in use); measured sizes of single specimens by less.
    min_size_step = 0.05
    distinct = sorted({size for size in sizes if size is not None})
    together: list[list[float]] = []
    for size in distinct:
        if together and size <= (1.0 + min_size_step) * together[-1][-1]:
            together[-1].append(size)
        else:
            together.append([size])
    texts: dict[float | None, str] = {None: NOT_SAID}
    for cluster in together:
        every = [size for size in sizes if size is not None and size in cluster]
        texts |= dict.fromkeys(cluster, size_words(sum(every) / len(every)))
    return [texts[size] for size in sizes]
