"""Run ``labpipe bundle``: compute the bounds of the bending stiffness, and fit the friction."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from labpipe import __version__
from labpipe.errors import ProcessingError, UsageError
from labpipe.mechanics.studies.study_files import FIGURES_FOLDER, write_study
from labpipe.mechanics.studies.wire_sheets import build_wire_error, read_wire_sheet
from labpipe.mechanics.wire.bundle_layout import (
    TARGET_PACKING_FRACTION,
    choose_bore,
    compute_bore,
    compute_packing_fraction,
    fits_bore,
)
from labpipe.mechanics.wire.bundle_model import (
    compute_bundle_model,
    compute_composite_degree,
    fit_friction,
)
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.messages import format_sentence
from labpipe.process.output_paths import RESULT_FILE
from labpipe.protocol.load import load_test_sheet, parse_protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, parse_bundle
from labpipe.records.arrays import Ints
from labpipe.records.curve import Curve, Interval
from labpipe.records.group import BoundedStiffness, Group, Sample
from labpipe.records.harness_bundle import (
    ARRANGEMENTS,
    PACKED,
    Bundle,
    BundleLoop,
    BundleModel,
    FrictionFit,
)
from labpipe.records.quality import Reason
from labpipe.records.result import TestResult, find_result
from labpipe.records.wire import WireSpec, WireTable
from labpipe.report.harness_figures import (
    LOOP_FIGURE,
    make_bundle_page,
    make_loop_page,
)
from labpipe.store.result_files import read_outcome
from labpipe.store.summaries import select_json
from labpipe.units import GRAVITY

STIFFNESS_NAME = "bending_stiffness"
"""Name of the result that is compared with the bounds."""
_BundleOutcome = BundleModel | tuple[Reason, ...]
"""Model of a bundle, or the reasons why there is none."""


def bound_stiffnesses(
    groups: Sequence[Group], wires: Sequence[WireSpec]
) -> Iterator[BoundedStiffness]:
    """Compute bounds of the bending stiffness for all samples and means of bundles.

    Parameters
    ----------
    groups : groups of the report; those without a bundle are ignored
    wires : wires of the wire sheet

    Yields
    ------
    For each group, the stiffnesses of the samples, then the mean stiffness. The mean has bounds
    only if all samples have the same bundle. A record without bounds or without a value states the
    reason.

    Notes
    -----
    The composite degree is the position of a stiffness between its bounds. It is 0 if all wires and
    all strands slip, and 1 if nothing slips; see `compute_composite_degree`.
    """
    tabulate = cache(partial(_tabulate_wire, {wire.name: wire for wire in wires}))
    model_bare_bundle = cache(partial(_model_bare_bundle, tabulate))
    for group in groups:
        # Conduit and tape do not affect the bounds.
        bundles = [
            bundle and Bundle(bundle.wires, bundle.arrangement, bundle.positions)
            for bundle in (sample.specimen.bundle for sample in group.samples)
        ]
        if not any(bundles):
            continue
        for sample, bundle in zip(group.samples, bundles, strict=True):
            yield _add_bounds(_get_stiffness(group, sample), model_bare_bundle(bundle))
        outcome = model_bare_bundle(bundles[0])
        if len(set(bundles)) > 1:
            outcome = (Reason.of("mechanics.studies.bundles_differ"),)
        yield _add_bounds(_get_mean_stiffness(group), outcome)


def _tabulate_wire(specs: Mapping[str, WireSpec], name: str) -> WireTable | Reason:
    """Tabulate the law of a wire, or return the reason why there is no law."""
    if name not in specs:
        return Reason.of("mechanics.studies.not_in_sheet", wire=name)
    try:
        return tabulate_wire(specs[name])
    except ValueError as error:
        return Reason.of("mechanics.studies.no_law", wire=name, error=error)


def _model_bare_bundle(
    tabulate: Callable[[str], WireTable | Reason], bundle: Bundle | None
) -> _BundleOutcome:
    """Compute the model of a bundle, or return the reasons why there is no model."""
    if bundle is None:
        return (Reason.of("mechanics.studies.no_bundle"),)
    outcomes = [tabulate(wire.type) for wire in bundle.wires]
    if reasons := tuple(outcome for outcome in outcomes if isinstance(outcome, Reason)):
        return reasons
    tables = {table.name: table for table in outcomes if isinstance(table, WireTable)}
    try:
        return compute_bundle_model(bundle, tables)
    except ValueError as error:
        return (Reason.of("mechanics.studies.no_model", error=error),)


def _get_stiffness(group: Group, sample: Sample) -> BoundedStiffness:
    """Return the stiffness of a sample, without bounds, or the reasons of a missing value."""
    result = find_result(sample.results, STIFFNESS_NAME)
    if result is None:
        reasons: tuple[Reason, ...] = (Reason.of("mechanics.studies.no_stiffness"),)
        return BoundedStiffness(group.name, sample.test, None, None, reasons=reasons)
    reasons = result.reasons if result.value is None else ()
    return BoundedStiffness(group.name, sample.test, result.value, result.interval, reasons=reasons)


def _get_mean_stiffness(group: Group) -> BoundedStiffness:
    """Return the mean stiffness of a group, without bounds, or the reason of a missing value."""
    group_result = group.find_number(STIFFNESS_NAME)
    if group_result is None or not group_result.values:
        reasons = (Reason.of("mechanics.studies.no_mean_stiffness"),)
        return BoundedStiffness(group.name, "", None, None, reasons=reasons)
    mean = group_result.mean.chosen
    return BoundedStiffness(group.name, "", mean.mean, mean.interval)


def _add_bounds(stiffness: BoundedStiffness, model: _BundleOutcome) -> BoundedStiffness:
    """Add bounds and composite degree to a stiffness, or the reasons why there is no model."""
    if isinstance(model, tuple):
        return replace(stiffness, reasons=model)
    bounds = {name: getattr(model, name) for name in ("low", "free", "high", "principal")}
    stiffness = replace(stiffness, **bounds)
    if stiffness.value is None:
        return stiffness
    if not model.high > model.low:
        return replace(stiffness, reasons=(Reason.of("mechanics.studies.one_bound"),))
    get_degree = partial(compute_composite_degree, low=model.low, high=model.high)
    interval = stiffness.interval
    if interval is not None:
        interval = Interval(get_degree(interval.lower), get_degree(interval.upper), interval.level)
    return replace(stiffness, degree=get_degree(stiffness.value), degree_interval=interval)


BUNDLE_FILE = "bundle.json"
BUNDLE_SCHEMA = 1
"""Version of the format of ``bundle.json``."""

_UNSAFE_CHARACTERS = re.compile(r"[^\w.-]+")
"""Characters that are replaced in the name of the folder of a bundle."""


@dataclass(frozen=True, slots=True)
class Conduit:
    """Conduit that may be chosen for a bundle.

    Parameters
    ----------
    bore : inner diameter, m
    packing_fraction : packing fraction of the wires in the conduit
    holds : whether the wires fit into the conduit in their layout
    """

    bore: float
    packing_fraction: float
    holds: bool


@dataclass(frozen=True, slots=True, eq=False)
class ModelledBundle:
    """Bundle with its model and the files that were written.

    Parameters
    ----------
    name : composition of the bundle, or name of its test
    model : model of the bundle, with the bounds of its bending stiffness
    conduits : conduits that may be chosen, in the order given
    wanted_bore : inner diameter of a conduit with the packing fraction `TARGET_PACKING_FRACTION`, m
    folder : folder of the results
    files : paths of the files that were written
    friction : friction fitted to the cycles of a processed test; None without such a test
    no_friction : reason why no friction was fitted to a processed test; empty if it was fitted, or
        without such a test
    """

    name: str
    model: BundleModel
    conduits: tuple[Conduit, ...]
    wanted_bore: float
    folder: Path
    files: tuple[Path, ...] = ()
    friction: FrictionFit | None = None
    no_friction: str = ""


def model_bundle(
    target: str,
    *,
    wires: Path,
    arrangement: str | None = None,
    bores: Sequence[float] = (),
    out: Path | None = None,
    figures: bool = True,
    png: bool = False,
) -> ModelledBundle:
    """Model a bundle and write the results.

    Parameters
    ----------
    target : path of a processed test (its folder or ``result.h5``), of a test sheet or of its
        folder, or a text such as ``10 B1 + 9 B2``
    wires : path of the wire sheet, which names its wires by the types in the bundle
    arrangement : arrangement to use instead of that in the test sheet; None to use that one
    bores : inner diameters, m, of the conduits that may be chosen; empty to use that in the test
        sheet
    out : folder of the results; None for ``processed/bundles/<name>`` in the working folder
    figures : whether figures are drawn
    png : whether figures are also written as PNG; otherwise PNG files of an earlier run are removed

    Returns
    -------
    The model in the best conduit. For a processed test, it includes the friction fitted to the
    first cycle and the prediction of the other cycles.

    Raises
    ------
    LabpipeError
        If the text, the test sheet or the wire sheet has faults, a wire is not in the sheet, or
        the bundle fits into no conduit. Earlier results are then kept.
    """
    if arrangement not in (None, *ARRANGEMENTS):
        values = {"choices": ", ".join(ARRANGEMENTS), "name": arrangement}
        raise UsageError.about("mechanics.studies.no_such_arrangement", "--arrangement", **values)
    name, bundle, test = _read_bundle(target, arrangement)
    tables = _tabulate_wires(target, bundle, wires)
    stated_bores = [] if bundle.conduit_bore is None else [bundle.conduit_bore]
    offered_bores = list(bores) or stated_bores
    try:
        bare_model = compute_bundle_model(replace(bundle, conduit_bore=None), tables)
        model = _choose_conduit(bare_model, offered_bores)
    except ValueError as error:
        raise ProcessingError.about(
            "mechanics.studies.wires_do_not_fit", target, error=error
        ) from error
    folder = Path("processed/bundles") / _UNSAFE_CHARACTERS.sub("-", name) if out is None else out
    diameters, min_bore = model.layout.diameter, model.smallest_bore
    conduits = tuple(
        Conduit(bore, compute_packing_fraction(diameters, bore), fits_bore(min_bore, bore))
        for bore in offered_bores
    )
    wanted_bore = compute_bore(diameters)
    modelled = ModelledBundle(name, model, conduits, wanted_bore, folder)
    if test is not None:
        laws = [tables[wire.type] for wire in bundle.wires]
        try:
            modelled = replace(modelled, friction=fit_friction(model, laws, extract_loop(test)))
        except ValueError as error:
            modelled = replace(modelled, no_friction=str(error))
    earlier_files, pages = [], []
    if figures:
        earlier_files = [f"{FIGURES_FOLDER}/{LOOP_FIGURE}.{ending}" for ending in ("svg", "png")]
        pages = [make_bundle_page(model)]
    if figures and modelled.friction is not None:
        pages.append(make_loop_page(name, modelled.friction))
    texts = {BUNDLE_FILE: json.dumps(build_json(modelled))}
    files = write_study(folder, texts, pages, earlier_files=earlier_files, png=png)
    return replace(modelled, files=files)


def _read_bundle(target: str, arrangement: str | None) -> tuple[str, Bundle, TestResult | None]:
    """Read the name and the bundle of a test, a test sheet or a text, and the test if it is one."""
    path, test = Path(target), None
    with suppress(OSError):  # a text may be too long for a file name
        if path.is_dir():
            path /= RESULT_FILE if (path / RESULT_FILE).exists() else SHEET_NAME
    if path.suffix == ".h5":
        test = read_outcome(path)
        name, bundle = test.test, test.specimen.bundle
    elif path.suffix in (".yaml", ".yml"):
        sheet = load_test_sheet(path)
        name, bundle = sheet.test, sheet.specimen.record.bundle
    else:
        bundle = parse_bundle(target, arrangement=arrangement or PACKED)
        name = bundle.composition.replace(" + ", " ")
        return f"{name} {bundle.arrangement}" if len(bundle.wires) > 1 else name, bundle, None
    if bundle is None:
        file = path if test is None else target
        raise UsageError.about("mechanics.studies.sheet_without_bundle", file, "specimen")
    return name, replace(bundle, arrangement=arrangement or bundle.arrangement), test


def _tabulate_wires(target: str, bundle: Bundle, wires: Path) -> dict[str, WireTable]:
    """Tabulate the laws of the wires of a bundle, keyed by type of wire."""
    sheet, tables = read_wire_sheet(wires), {}
    names = dict.fromkeys(wire.type for wire in bundle.wires)
    for spec in [sheet.find_wire(name, target) for name in names]:
        try:
            tables[spec.name] = tabulate_wire(spec)
        except ValueError as error:
            raise build_wire_error(wires, spec, "a wire that can be modelled", error) from error
    return tables


def _choose_conduit(model: BundleModel, bores: Sequence[float]) -> BundleModel:
    """Choose the best conduit among those with given bores, m, and add it to the model."""
    if not bores:
        return model
    diameters = model.layout.diameter
    bore = choose_bore(diameters, bores, min_bore=model.smallest_bore)
    bundle = replace(model.bundle, conduit_bore=bore)
    return replace(model, bundle=bundle, packing_fraction=compute_packing_fraction(diameters, bore))


_MODEL_FIELDS = (
    *("low", "free", "high", "principal", "principal_angle", "neutral", "tensor"),
    *("axial_stiffness", "smallest_bore", "middle", "packing_fraction"),
    *("curvature", "moment_slip", "moment_stick", "layout", "notes"),
)
"""Fields of `BundleModel` in ``bundle.json``."""
_FRICTION_FIELDS = (
    *("composite_share", "slip_curvature", "slide_curvature", "held", "held_lower", "held_upper"),
    *("error_fitted", "error_held_out", "loss", "predicted_loss", "predicted", "is_held_out"),
)
"""Fields of `FrictionFit` in ``bundle.json``."""


def build_json(modelled: ModelledBundle) -> dict[str, object]:
    """Build the content of ``labpipe bundle --json``: lists and numbers in SI units.

    Parameters
    ----------
    modelled : bundle with its model
    """
    model, friction = modelled.model, modelled.friction
    slip_flags, stick_flags = model.is_doubtful, model.is_doubtful_stick
    return {
        "schema": BUNDLE_SCHEMA,
        "labpipe": __version__,
        **select_json(modelled, "name", "wanted_bore", "conduits", "no_friction"),
        "bundle": asdict(model.bundle),
        "wanted_packing_fraction": TARGET_PACKING_FRACTION,
        **select_json(
            model, *_MODEL_FIELDS, doubtful="is_doubtful", doubtful_stick="is_doubtful_stick"
        ),
        "doubtful_curvature": model.doubtful_curvature if slip_flags.any() else None,
        "doubtful_curvature_stick": model.doubtful_curvature_stick if stick_flags.any() else None,
        "friction": friction
        and {
            **select_json(friction, *_FRICTION_FIELDS),
            **select_json(friction.loop, "length", "deflection", "force", "branch"),
        },
    }


def extract_loop(test: TestResult) -> BundleLoop:
    """Extract the cycles of a processed test, and convert them to those of a cantilever.

    Parameters
    ----------
    test : test of a bundle whose specimen has a `length` (cantilever) or a `span` (three-point
        bending)

    Returns
    -------
    The cycles. A span is treated as two cantilevers of half its length without weight.

    Raises
    ------
    ValueError
        If the test has no branches, no kink, or neither length nor span.
    """
    min_relative_deflection = 1e-3  # smaller deflections are within the error of the zero
    curve, dimensions = test.curve, test.specimen.dimensions
    values = {result.name: result.value for result in test.results}
    kink = values.get("kink_displacement"), values.get("kink_force")
    if curve is None or not curve.branches:
        raise ValueError(format_sentence("mechanics.studies.no_branches"))
    if kink[0] is None or kink[1] is None:
        raise ValueError(format_sentence("mechanics.studies.no_kink"))
    if "length" not in dimensions and "span" not in dimensions:
        raise ValueError(format_sentence("mechanics.studies.no_length_or_span"))
    length = dimensions.get("length", dimensions.get("span", 0.0) / 2.0)
    force_ratio = 1.0 if "length" in dimensions else 0.5  # half of a span carries half the force
    rows, branch = _select_points(curve, min_relative_deflection * length)
    slide_deflection = values.get("plateau_displacement")
    self_weight = 0.0
    if "length" in dimensions:
        specimen = parse_protocol(test.protocol_yaml, test.test).specimen
        self_weight = GRAVITY * (specimen.mass_per_length or 0.0)
    return BundleLoop(
        length=length,
        deflection=curve.displacement[rows],
        force=force_ratio * curve.force[rows],
        branch=branch,
        kink=(kink[0], force_ratio * kink[1]),
        slide=np.inf if slide_deflection is None else slide_deflection,
        self_weight=self_weight,
    )


def _select_points(curve: Curve, min_deflection: float) -> tuple[Ints, Ints]:
    """Select evenly spaced points of all branches, and return their rows and branch numbers."""
    max_points = 30  # points of each branch
    is_used = (curve.displacement > min_deflection) & np.isfinite(curve.force)
    rows, branch_numbers = [], []
    for branch_number, branch in enumerate(curve.branches):
        branch_rows = branch.start + np.flatnonzero(is_used[branch.start : branch.stop])
        n_points = min(max_points, len(branch_rows))
        indices = np.round(np.linspace(0.0, len(branch_rows) - 1.0, n_points))
        rows.append(branch_rows[indices.astype(np.int64)])
        branch_numbers.append(np.full(n_points, branch_number, dtype=np.int64))
    return np.concatenate(rows), np.concatenate(branch_numbers)
