"""Make quality notes on the samples, numbers and methods of a group."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from labpipe.messages import format_sentence
from labpipe.records.group import GroupNumber, Sample
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.result import Status

_IN_COMPOSITION = ("wire", "number")
"""Fields that are part of a composition."""
PROTOCOLS_DIFFER = "protocols_differ"


def name_samples(samples: Sequence[Sample]) -> list[str]:
    """Return a unique name of each sample: its test, with the file if several tests have one name.

    Parameters
    ----------
    samples : of one group

    Returns
    -------
    In the order of the samples.
    """
    counts = Counter(sample.test for sample in samples)
    return [
        sample.test if counts[sample.test] == 1 else f"{sample.test} ({sample.source or number})"
        for number, sample in enumerate(samples, start=1)
    ]


def make_sample_notes(samples: Sequence[Sample]) -> list[QualityNote]:
    """Make notes on missing, single, repeated and differing samples.

    Parameters
    ----------
    samples : of one group
    """
    if not samples:
        return [QualityNote.of("statistics.empty_group", "group")]
    notes = []
    if len(samples) == 1:
        notes.append(QualityNote.of("statistics.one_sample", "group", test=samples[0].test))
    counts = Counter((sample.specimen.spool, sample.specimen.sample) for sample in samples)
    notes += [
        QualityNote.of(
            "statistics.sample_repeated", "group", sample=sample, spool=spool, count=count
        )
        for (spool, sample), count in counts.items()
        if count > 1
    ]
    return [*notes, *_make_dimension_notes(samples), *_make_field_notes(samples)]


def _make_dimension_notes(samples: Sequence[Sample]) -> list[QualityNote]:
    names = dict.fromkeys(name for sample in samples for name in sample.specimen.dimensions)
    notes = []
    for name in names:
        sizes = [sample.specimen.dimensions.get(name, float("nan")) for sample in samples]
        low, high = float(np.nanmin(sizes)), float(np.nanmax(sizes))
        if high - low > 0.01 * abs(high):
            span = f"{1e3 * low:.4g} mm to {1e3 * high:.4g} mm"
            notes.append(
                QualityNote.of("statistics.dimensions_differ", "group", name=name, span=span)
            )
    return notes


def _make_field_notes(samples: Sequence[Sample]) -> list[QualityNote]:
    """Make warnings on differing bundles of a group, and notes on differing labels."""
    bundles = [sample.specimen.bundle for sample in samples if sample.specimen.bundle]
    bundle_fields = dict.fromkeys(name for bundle in bundles for name in bundle.fields)
    labels = dict.fromkeys(name for sample in samples for name in sample.specimen.labels)
    return [
        QualityNote.of(
            "statistics.labels_differ" if name in labels else "statistics.bundles_differ",
            "group",
            values=values,
        )
        for name in bundle_fields | labels
        if (name in labels or name not in _IN_COMPOSITION)
        and (values := _describe_differing(samples, name))
    ]


def _describe_differing(samples: Sequence[Sample], name: str) -> str:
    """Describe which samples have which value of a field; empty if all have the same."""
    tests_by_value: dict[str, list[str]] = {}
    for test, sample in zip(name_samples(samples), samples, strict=True):
        tests_by_value.setdefault(sample.specimen.fields.get(name, ""), []).append(test)
    return f"{name}: {describe_values(tests_by_value)}" if len(tests_by_value) > 1 else ""


def make_grouping_notes(missing_fields: Sequence[str], renamed: Sequence[str]) -> list[QualityNote]:
    """Make notes on the grouping of samples.

    Parameters
    ----------
    missing_fields : grouping fields that the sheets of this group do not state
    renamed : names of spools of several types
    """
    notes = [
        QualityNote.of("statistics.field_not_said", "group", name=name) for name in missing_fields
    ]
    if renamed:
        names = ", ".join(renamed)
        notes.append(QualityNote.of("statistics.spools_renamed", "group", names=names))
    return notes


def make_number_notes(numbers: Sequence[GroupNumber]) -> list[QualityNote]:
    """Make notes on means with doubtful values, and on numbers not tested for outliers.

    Parameters
    ----------
    numbers : of one group
    """
    notes = []
    doubtful_tests = {
        number.name: [
            test for test, result in number.values.items() if result.status is Status.DOUBTFUL
        ]
        for number in numbers
    }
    if names := "; ".join(
        f"{name} ({', '.join(tests)})" for name, tests in doubtful_tests.items() if tests
    ):
        notes.append(QualityNote.of("statistics.doubtful_in_mean", "group", names=names))
    if names := "; ".join(number.name for number in numbers if _describe_too_few(number)):
        notes.append(QualityNote.of("statistics.outliers_not_tested", "group", names=names))
    return notes


def describe_missing_samples(spools: Sequence[str]) -> str:
    """Describe why no sample can be marked as an outlier; empty if one can.

    Parameters
    ----------
    spools : spool of each sample with a value
    """
    counted, needed = len(spools), len(set(spools)) + 2
    if counted >= needed:
        return ""
    return format_sentence(
        "statistics.outliers_need_samples", count=counted, spools=len(set(spools)), needed=needed
    )


def _describe_too_few(number: GroupNumber) -> str:
    if not number.values:
        return ""
    spools = [name for name, mean in number.mean.spool_means.items() for _ in range(mean.n)]
    return describe_missing_samples(spools)


def group_by_method(number: GroupNumber) -> dict[str, list[str]]:
    """Group the tests by the method of their number.

    Parameters
    ----------
    number : of a group; excluded tests are ignored

    Returns
    -------
    Tests by method, in order of their first test. Remarks are ignored: they concern one test each.
    """
    tests_by_method: dict[str, list[str]] = {}
    for test, result in number.values.items():
        tests_by_method.setdefault(result.method, []).append(test)
    return tests_by_method


def find_mixed_methods(samples: Sequence[Sample]) -> dict[str, dict[str, list[str]]]:
    """Find numbers that were computed by several methods, and those that depend on them.

    Parameters
    ----------
    samples : of a group

    Returns
    -------
    Tests by method, by result. A number that depends on another one has the methods of the latter.
    """
    methods_by_name: dict[str, dict[str, list[str]]] = {}
    sources: dict[str, set[str]] = {}
    for test, sample in zip(name_samples(samples), samples, strict=True):
        for result in sample.results:
            if result.value is not None:
                tests_by_method = methods_by_name.setdefault(result.name, {})
                tests_by_method.setdefault(result.method, []).append(test)
                sources.setdefault(result.name, set()).add(result.made_of)
    mixed_methods = {
        name: tests_by_method
        for name, tests_by_method in methods_by_name.items()
        if len(tests_by_method) > 1
    }
    dependent = {
        name: mixed_methods[source]
        for name, results in sources.items()
        if name not in mixed_methods
        and (source := next((s for s in mixed_methods if s in results), ""))
    }
    return mixed_methods | dependent


def find_other_methods(samples: Sequence[Sample]) -> dict[str, dict[str, Reason]]:
    """Find the tests whose number has another method, so that it is not averaged.

    Parameters
    ----------
    samples : of a group

    Returns
    -------
    Reason (``made_otherwise``) by result and test. A slope from 0 to 10 mm and one from 0 to 8 mm,
    for example, are two quantities without a common mean. The most frequent method is averaged; of
    equally frequent ones, that of the first test.
    """
    left_out: dict[str, dict[str, Reason]] = {}
    for name, tests_by_method in find_mixed_methods(samples).items():
        usual_method = max(tests_by_method, key=lambda method: len(tests_by_method[method]))
        reasons_of_tests = {
            test: Reason.of(
                "statistics.made_otherwise", way=method or "no stated method", usual=usual_method
            )
            for method, tests in tests_by_method.items()
            if method != usual_method
            for test in tests
        }
        left_out[name] = reasons_of_tests
    return left_out


def make_method_notes(
    made_otherwise: Mapping[str, Mapping[str, Reason]], samples: Sequence[Sample]
) -> list[QualityNote]:
    """Make warnings on numbers with different methods.

    Parameters
    ----------
    made_otherwise : of `find_other_methods`
    samples : of the group, with their decisions on slips

    Returns
    -------
    Notes ``protocols_differ``: one per number, and one for slips.
    """
    notes = []
    for name, left_out in made_otherwise.items():
        tests, reason = ", ".join(left_out), next(iter(left_out.values())).message
        note = QualityNote.of("statistics.protocols_differ", name, tests=tests, why=reason)
        notes.append(replace(note, tests=tuple(left_out)))
    decisions: dict[str, list[str]] = {}
    for sample in samples:
        for decision in dict.fromkeys(slip.decision for slip in sample.slips):
            decisions.setdefault(decision, []).append(sample.test)
    if len(decisions) > 1:
        note = QualityNote.of(
            "statistics.slips_differ", "slips", decisions=describe_values(decisions)
        )
        notes.append(replace(note, tests=list_minority_tests(decisions)))
    return notes


def list_minority_tests(tests: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """List the tests without the most frequent value, by tests of each value.

    Examples
    --------
    >>> list_minority_tests({"2 mm": ["a", "b"], "1 mm": ["f"]})
    ('f',)
    """
    *minorities, _ = sorted(tests.values(), key=len)
    return tuple(dict.fromkeys(test for entries in minorities for test in entries))


def describe_values(tests: Mapping[str, Sequence[str]]) -> str:
    """Describe which tests have which value, with the most frequent value last.

    Examples
    --------
    >>> describe_values({"2 mm": ["a", "b", "c", "d", "e"], "1 mm": ["f"]})
    '1 mm (f) and 2 mm (the other 5)'
    """
    max_named_tests = 4
    rarest_first = sorted(tests.items(), key=lambda entry: len(entry[1]))
    parts = [f"{text or 'not stated'} ({', '.join(names)})" for text, names in rarest_first]
    last_text, last_names = rarest_first[-1]
    if len(last_names) > max_named_tests:
        parts[-1] = f"{last_text or 'not stated'} (the other {len(last_names)})"
    return f"{'; '.join(parts[:-1])} and {parts[-1]}"


def make_method_caveats(first_number: GroupNumber, second_number: GroupNumber) -> tuple[str, ...]:
    """Make a caveat if a number of two groups was computed by more than one method."""
    first, second = list(group_by_method(first_number)), list(group_by_method(second_number))
    if sorted(first) == sorted(second) and len(first) == 1:
        return ()
    texts = {"first": " or ".join(first), "second": " or ".join(second)}
    return (
        format_sentence("statistics.methods_differ", first=texts["first"], second=texts["second"]),
    )
