"""Compare the fields of samples, divide samples into groups, and make quality notes on groups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from re import split

from labpipe.messages import format_sentence
from labpipe.records.group import Group, GroupNumber, Sample
from labpipe.records.harness_bundle import NONE, TAPINGS
from labpipe.records.quality import QualityNote, Reason
from labpipe.records.result import Specimen, Status

TYPE, SPOOL, BORE = "type", "spool", "conduit_bore"
"""Names of fields of a specimen."""
SECTION_SIZES = ("outer_diameter", "inner_diameter", "wall", "width", "thickness")
"""Names of the sizes of the cross-section, which follow from the type or from the conduit."""
NOT_STATED = "not stated"
"""Value of a field that the test sheets do not state."""


def list_fields(specimen: Specimen) -> dict[str, str]:
    """List the fields of a specimen, by which samples can be grouped, with their values as text.

    Parameters
    ----------
    specimen : specimen with its dimensions, labels and bundle

    Returns
    -------
    Text of each field, keyed by field. Type and spool are first; dimensions and the bore of the
    conduit are last.

    Examples
    --------
    >>> list_fields(Specimen("A2", "A2-s1", "1", {"length": 0.085}))
    {'type': 'A2', 'spool': 'A2-s1', 'length': '85 mm'}
    """
    sizes = {name: format_size(size) for name, size in specimen.dimensions.items()}
    bore = specimen.bundle.conduit_bore if specimen.bundle is not None else None
    return dict(specimen.fields) | sizes | ({} if bore is None else {BORE: format_size(bore)})


def format_size(size: float) -> str:
    """Format a size, m, in mm, such as ``85 mm``."""
    return f"{1e3 * size:.4g} mm"


def list_field_names(specimens: Iterable[Specimen]) -> list[str]:
    """List the names of the fields of all specimens, each name once."""
    return list(dict.fromkeys(name for specimen in specimens for name in list_fields(specimen)))


def find_shared_fields(samples: Sequence[Sample]) -> dict[str, str]:
    """Find the fields that have the same value in all samples of a group.

    Parameters
    ----------
    samples : samples of one group

    Returns
    -------
    Text of each field, keyed by field. A dimension that varies by at most 1 % counts as equal. Its
    text is that of the mean.
    """
    shared_fields: dict[str, str] = {}
    all_fields = [list_fields(sample.specimen) for sample in samples]
    for name in list_field_names(sample.specimen for sample in samples):
        values = {fields.get(name) for fields in all_fields}
        sizes = _list_sizes(samples, name)
        if len(values) == 1:
            shared_fields[name] = all_fields[0][name]
        elif len(sizes) == len(samples) and _are_similar(sizes):
            shared_fields[name] = format_size(sum(sizes) / len(sizes))
    return shared_fields


def _list_sizes(samples: Iterable[Sample], name: str) -> list[float]:
    """List the values of a dimension, m, in the samples that have it."""
    sizes = (sample.specimen.dimensions.get(name) for sample in samples)
    return [size for size in sizes if size is not None]


def _are_similar(sizes: Sequence[float]) -> bool:
    """Return whether sizes differ by at most 1 %, as specimens of one nominal size do."""
    max_difference = 0.01  # relative to the largest size
    return max(sizes) - min(sizes) <= max_difference * max(map(abs, sizes))


def find_varying_fields(group: Group) -> tuple[str, ...]:
    """Find the fields that vary within a group, except for the spool.

    Parameters
    ----------
    group : group of samples; a varying composition replaces the fields ``wire`` and ``number``
    """
    all_names = list_field_names(sample.specimen for sample in group.samples)
    names = [name for name in all_names if name not in group.fields and name != SPOOL]
    if "composition" in names:
        names = [name for name in names if name not in {"wire", "number"}]
    return tuple(names)


def find_differing_fields(
    first: Group, second: Group, grouping_fields: Sequence[str] = (TYPE,)
) -> dict[str, tuple[str, str]]:
    """Find the fields in which two groups differ.

    Parameters
    ----------
    first, second : groups; fields that vary within one of them are ignored
    grouping_fields : names of the fields by which samples are grouped; the spool is ignored if it
        is not one of them

    Returns
    -------
    Text of the first and of the second group, keyed by field. Dimensions differ if their means
    differ by more than 1 %.

    Notes
    -----
    Dependent fields are excluded: the type of bundles; the section of other specimens if the type
    differs; the composition if wire or number differ; the tape if one of the groups has no taping;
    the bore and the section of a conduit if the conduits differ; the arrangement if a bundle has
    wires of one kind only.
    """
    varying_fields = {*find_varying_fields(first), *find_varying_fields(second)}
    if "composition" in varying_fields:
        varying_fields |= {"wire", "number"} - (first.fields.keys() & second.fields.keys())
    names = dict.fromkeys((*first.fields, *second.fields))
    all_texts = {
        name: (first.fields.get(name, NOT_STATED), second.fields.get(name, NOT_STATED))
        for name in names
        if name not in varying_fields and (name != SPOOL or SPOOL in grouping_fields)
    }
    differences = {
        name: texts
        for name, texts in all_texts.items()
        if texts[0] != texts[1] and not _have_similar_sizes(first, second, name)
    }
    dependent_fields = _find_dependent_fields(differences, all_texts, first, second)
    return {name: texts for name, texts in differences.items() if name not in dependent_fields}


def _have_similar_sizes(first: Group, second: Group, name: str) -> bool:
    """Return whether both groups have a dimension, and its means differ by at most 1 %."""
    size_lists = [_list_sizes(group.samples, name) for group in (first, second)]
    return all(size_lists) and _are_similar([sum(sizes) / len(sizes) for sizes in size_lists])


def _find_dependent_fields(
    differences: Mapping[str, tuple[str, str]],
    all_texts: Mapping[str, tuple[str, str]],
    first: Group,
    second: Group,
) -> set[str]:
    """Find the fields whose difference follows from another field.

    Parameters
    ----------
    differences : texts of both groups, keyed by the fields that differ
    all_texts : texts of both groups, keyed by the fields that are compared
    first, second : groups that are compared
    """
    dependent_fields: set[str] = set()
    samples = (*first.samples, *second.samples)
    if first.samples and second.samples and all(sample.specimen.bundle for sample in samples):
        dependent_fields.add(TYPE)
    elif TYPE in differences:
        dependent_fields |= set(SECTION_SIZES)
    if {"wire", "number"} & differences.keys():
        dependent_fields.add("composition")
    if NONE in all_texts.get("taping", ()):
        dependent_fields.add("tape")
    if "conduit" in differences:
        dependent_fields |= {BORE, *SECTION_SIZES}
    if any(sample.specimen.bundle and len(sample.specimen.bundle.wires) == 1 for sample in samples):
        dependent_fields.add("arrangement")
    return dependent_fields


def make_field_sort_key(name: str, text: str) -> tuple[object, ...]:
    """Make the sort key of the value of a field.

    Parameters
    ----------
    name : name of the field
    text : value of the field in a group

    Returns
    -------
    The key. It puts ``none`` and ``not stated`` first, tapings in the order of coverage, and 7
    before 12.

    Examples
    --------
    >>> sorted(["half-lap", "none", "coarse"], key=lambda word: make_field_sort_key("taping", word))
    ['none', 'coarse', 'half-lap']
    """
    if name == "taping" and text in TAPINGS:
        return 0, TAPINGS.index(text)
    if text in {NONE, NOT_STATED}:
        return (0,)
    return 1, make_natural_sort_key(text)


def make_natural_sort_key(text: str) -> tuple[tuple[int, str], ...]:
    """Make the sort key of a text that sorts numbers by value, such as 7 before 12."""
    segments = split(r"(\d+)", text)
    return tuple((int(x), "") if x.isdecimal() else (0, x) for x in segments)


_BUNDLE_FIELDS = ("composition", "arrangement", "taping", "tape", "conduit", BORE)
"""Fields of a bundle in order of precedence.

A field that does not divide the samples further than the fields before it is not named.
"""


@dataclass(frozen=True, slots=True)
class Subset:
    """Samples of one type with equal values of the fields that divide the type.

    Parameters
    ----------
    fields : values of the dividing fields, such as ``85 mm``, keyed by field; empty if no field
        divides the samples
    samples : samples with these values, at least one
    """

    fields: Mapping[str, str]
    samples: tuple[Sample, ...]


def divide_samples(samples: Sequence[Sample]) -> list[Subset]:
    """Divide samples by every dimension and every field of the specimen that differs.

    Parameters
    ----------
    samples : samples of one type and protocol

    Returns
    -------
    The subsets in order of their first sample. A dimension divides between adjacent sizes that
    differ by more than 5 %, so that individually measured specimens stay together. A label divides
    unless each test has a different value, which is then the name of a specimen and not a
    treatment. Spools do not divide, since means are nested in them. `Subset.fields` omits a field
    that does not divide further than the fields before it.

    Examples
    --------
    Three wires of 85 mm and three of 100 mm are two subsets, ``{"length": "85 mm"}`` and
    ``{"length": "100 mm"}``; tapes with widths of 12.4, 12.7 and 12.9 mm are one subset.
    """
    keys: list[tuple[str, ...]] = [()] * len(samples)
    field_names: list[str] = []
    for name, labels in _list_candidates(samples).items():
        finer_keys = [(*coarse_key, value) for coarse_key, value in zip(keys, labels, strict=True)]
        if len(set(finer_keys)) > len(set(keys)):
            keys, field_names = finer_keys, [*field_names, name]
    return [
        Subset(
            dict(zip(field_names, subset_key, strict=True)),
            tuple(sample for sample, key in zip(samples, keys, strict=True) if key == subset_key),
        )
        for subset_key in dict.fromkeys(keys)
    ]


def _list_candidates(samples: Sequence[Sample]) -> dict[str, list[str]]:
    """Return the texts of all samples for each field that may divide them, keyed by field."""
    all_fields = [list_fields(sample.specimen) for sample in samples]
    specimens = [sample.specimen for sample in samples]
    sizes = dict.fromkeys(name for specimen in specimens for name in specimen.dimensions)
    labels = dict.fromkeys(name for specimen in specimens for name in specimen.labels)
    bundle_names = _BUNDLE_FIELDS if any(specimen.bundle for specimen in specimens) else ()
    candidates = {
        name: [fields.get(name, NOT_STATED) for fields in all_fields] for name in bundle_names
    }
    if all(specimen.bundle is None or len(specimen.bundle.wires) == 1 for specimen in specimens):
        candidates.pop("arrangement", None)  # all wires are of one kind
    for name in sizes:
        candidates[name] = _format_clustered_sizes([x.dimensions.get(name) for x in specimens])
    for name in labels:
        texts = [fields.get(name, NOT_STATED) for fields in all_fields]
        if len(set(texts)) < len(texts):  # labels that all differ are names of specimens
            candidates[name] = texts
    return candidates


def _format_clustered_sizes(sizes: Sequence[float | None]) -> list[str]:
    """Format each size as the mean of its cluster, in mm."""
    # Adjacent nominal sizes differ by more (6 % in R 40 of ISO 3, the finest series in use).
    # Measured sizes of specimens with one nominal size differ by less.
    min_size_step = 0.05
    clusters: list[list[float]] = []
    for size in sorted({size for size in sizes if size is not None}):
        if clusters and size <= (1.0 + min_size_step) * clusters[-1][-1]:
            clusters[-1].append(size)
        else:
            clusters.append([size])
    texts: dict[float | None, str] = {None: NOT_STATED}
    for cluster in clusters:
        members = [size for size in sizes if size is not None and size in cluster]
        texts |= dict.fromkeys(cluster, format_size(sum(members) / len(members)))
    return [texts[size] for size in sizes]


_COMPOSITION_FIELDS = ("wire", "number")
"""Fields that follow from the composition of a bundle."""
PROTOCOLS_DIFFER = "protocols_differ"
"""Code of notes on results or slips for which the tests of a group used different methods."""


def name_samples(samples: Sequence[Sample]) -> list[str]:
    """Make a unique name for each sample: its test, with the file if several tests have this name.

    Parameters
    ----------
    samples : samples of one group

    Returns
    -------
    The names, in the order of the samples.
    """
    counts = Counter(sample.test for sample in samples)
    return [
        sample.test if counts[sample.test] == 1 else f"{sample.test} ({sample.source or index})"
        for index, sample in enumerate(samples, start=1)
    ]


def make_sample_notes(samples: Sequence[Sample]) -> Iterator[QualityNote]:
    """Make notes on a group that is empty, has one sample, or has repeated or unlike samples.

    Parameters
    ----------
    samples : samples of one group
    """
    if not samples:
        yield QualityNote.of("statistics.empty_group", "group")
    if len(samples) == 1:
        yield QualityNote.of("statistics.one_sample", "group", test=samples[0].test)
    counts = Counter((sample.specimen.spool, sample.specimen.sample) for sample in samples)
    for (spool, sample), count in counts.items():
        if count > 1:
            yield QualityNote.of(
                "statistics.sample_repeated", "group", sample=sample, spool=spool, count=count
            )
    yield from _make_difference_notes(samples)


def _make_difference_notes(samples: Sequence[Sample]) -> Iterator[QualityNote]:
    """Make notes on dimensions, fields of bundles, and labels that differ within a group."""
    specimens = [sample.specimen for sample in samples]
    for name in dict.fromkeys(name for specimen in specimens for name in specimen.dimensions):
        sizes = _list_sizes(samples, name)
        if not _are_similar(sizes):
            span = f"{format_size(min(sizes))} to {format_size(max(sizes))}"
            yield QualityNote.of("statistics.dimensions_differ", "group", name=name, span=span)
    labels = dict.fromkeys(name for specimen in specimens for name in specimen.labels)
    bundles = [specimen.bundle for specimen in specimens if specimen.bundle]
    bundle_fields = dict.fromkeys(name for bundle in bundles for name in bundle.fields)
    for name in bundle_fields | labels:
        tests_by_value: dict[str, list[str]] = {}
        for test, specimen in zip(name_samples(samples), specimens, strict=True):
            tests_by_value.setdefault(specimen.fields.get(name, ""), []).append(test)
        # Fields that follow from the composition have no note of their own.
        is_noted = name in labels or name not in _COMPOSITION_FIELDS
        if is_noted and len(tests_by_value) > 1:
            yield QualityNote.of(
                "statistics.labels_differ" if name in labels else "statistics.bundles_differ",
                "group",
                values=f"{name}: {describe_values(tests_by_value)}",
            )


def make_grouping_notes(
    missing_fields: Sequence[str], renamed_spools: Sequence[str]
) -> Iterator[QualityNote]:
    """Make notes on the grouping of samples.

    Parameters
    ----------
    missing_fields : grouping fields that the sheets of this group do not state
    renamed_spools : names of spools that occur in several types
    """
    for name in missing_fields:
        yield QualityNote.of("statistics.field_not_said", "group", name=name)
    if renamed_spools:
        yield QualityNote.of("statistics.spools_renamed", "group", names=", ".join(renamed_spools))


def make_number_notes(numbers: Sequence[GroupNumber]) -> Iterator[QualityNote]:
    """Make notes on means with doubtful values, and on results that are not tested for outliers.

    Parameters
    ----------
    numbers : results of one group
    """
    texts = []
    for number in numbers:
        values = number.values.items()
        if tests := [test for test, result in values if result.status is Status.DOUBTFUL]:
            texts.append(f"{number.name} ({', '.join(tests)})")
    if names := "; ".join(texts):
        yield QualityNote.of("statistics.doubtful_in_mean", "group", names=names)
    if names := "; ".join(number.name for number in numbers if not _is_outlier_tested(number)):
        yield QualityNote.of("statistics.outliers_not_tested", "group", names=names)


def _is_outlier_tested(number: GroupNumber) -> bool:
    """Return whether a result has at least two more values than spools, or no value at all."""
    spool_means = number.mean.spool_means
    return sum(mean.n for mean in spool_means.values()) >= len(spool_means) + 2 or not number.values


def find_other_methods(samples: Sequence[Sample]) -> dict[str, dict[str, Reason]]:
    """Find the results that were computed by another method, and are therefore not averaged.

    Parameters
    ----------
    samples : samples of a group

    Returns
    -------
    Reasons (``made_otherwise``), keyed by result and then by name of the sample. For example,
    slopes from 0 to 10 mm and from 0 to 8 mm are two quantities without a common mean. The values
    of the most frequent method are averaged; of equally frequent methods, those of the method of
    the first sample. A result that depends on another result has the methods of that result.
    """
    tests_by_method: dict[str, dict[str, list[str]]] = {}
    sources: dict[str, set[str]] = {}
    for test, sample in zip(name_samples(samples), samples, strict=True):
        for result in sample.results:
            if result.value is not None:
                methods = tests_by_method.setdefault(result.name, {})
                methods.setdefault(result.method, []).append(test)
                sources.setdefault(result.name, set()).add(result.made_of)
    mixed_methods = {name: methods for name, methods in tests_by_method.items() if len(methods) > 1}
    dependent_methods = {
        name: mixed_methods[source]
        for name, source_names in sources.items()
        for source in mixed_methods
        if source in source_names and name not in mixed_methods
    }
    reasons_by_name: dict[str, dict[str, Reason]] = {}
    for name, methods in (mixed_methods | dependent_methods).items():
        usual_method, _ = max(methods.items(), key=lambda entry: len(entry[1]))
        reasons_by_name[name] = {
            test: Reason.of(
                "statistics.made_otherwise", way=method or "no stated method", usual=usual_method
            )
            for method, tests in methods.items()
            if method != usual_method
            for test in tests
        }
    return reasons_by_name


def make_method_notes(
    exclusions: Mapping[str, Mapping[str, Reason]], samples: Sequence[Sample]
) -> Iterator[QualityNote]:
    """Make notes on results and slips for which the samples of a group used different methods.

    Parameters
    ----------
    exclusions : reasons from `find_other_methods`, keyed by result and then by name of the sample
    samples : samples of the group, with their decisions on slips

    Yields
    ------
    Notes ``protocols_differ``, one for each result, and one for slips.
    """
    for name, reasons in exclusions.items():
        tests, message = ", ".join(reasons), next(iter(reasons.values())).message
        note = QualityNote.of("statistics.protocols_differ", name, tests=tests, why=message)
        yield replace(note, tests=tuple(reasons))
    tests_by_decision: dict[str, list[str]] = {}
    for sample in samples:
        for decision in dict.fromkeys(slip.decision for slip in sample.slips):
            tests_by_decision.setdefault(decision, []).append(sample.test)
    if len(tests_by_decision) > 1:
        decisions = describe_values(tests_by_decision)
        note = QualityNote.of("statistics.slips_differ", "slips", decisions=decisions)
        yield replace(note, tests=list_minority_tests(tests_by_decision))


def list_minority_tests(tests_by_value: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """List the tests that do not have the most frequent value.

    Parameters
    ----------
    tests_by_value : names of the tests with each value, keyed by value

    Examples
    --------
    >>> list_minority_tests({"2 mm": ["a", "b"], "1 mm": ["f"]})
    ('f',)
    """
    *minorities, _ = sorted(tests_by_value.values(), key=len)
    return tuple(dict.fromkeys(test for tests in minorities for test in tests))


def describe_values(tests_by_value: Mapping[str, Sequence[str]]) -> str:
    """Describe which tests have which value, with the most frequent value last.

    Parameters
    ----------
    tests_by_value : names of the tests with each value, keyed by value; two values or more

    Examples
    --------
    >>> describe_values({"2 mm": ["a", "b", "c", "d", "e"], "1 mm": ["f"]})
    '1 mm (f) and 2 mm (the other 5)'
    """
    max_named_tests = 4
    entries = sorted(tests_by_value.items(), key=lambda entry: len(entry[1]))
    clauses = [f"{value or 'not stated'} ({', '.join(tests)})" for value, tests in entries]
    last_value, last_tests = entries[-1]
    if len(last_tests) > max_named_tests:
        clauses[-1] = f"{last_value or 'not stated'} (the other {len(last_tests)})"
    return f"{'; '.join(clauses[:-1])} and {clauses[-1]}"


def make_method_caveats(first_number: GroupNumber, second_number: GroupNumber) -> tuple[str, ...]:
    """Return a caveat if a result of two groups was computed by more than one method."""
    first_methods, second_methods = (
        dict.fromkeys(result.method for result in number.values.values())
        for number in (first_number, second_number)
    )
    if len(first_methods | second_methods) == 1:
        return ()
    facts = {"first": " or ".join(first_methods), "second": " or ".join(second_methods)}
    return (format_sentence("statistics.methods_differ", **facts),)
