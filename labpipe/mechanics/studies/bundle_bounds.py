"""Study ``labpipe bundle``: bounds of a bundle's bending stiffness, and tests between them."""

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
    WANTED_FRACTION,
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
    BUNDLE_FIGURE,
    LOOP_FIGURE,
    make_bundle_page,
    make_loop_page,
)
from labpipe.store.result_files import read_outcome
from labpipe.store.summaries import select_json
from labpipe.units import GRAVITY

STIFFNESS_NAME = "bending_stiffness"
_Bounds = BundleModel | tuple[Reason, ...]
"""Model of a bundle, or the reasons why there is none."""


def bound_stiffnesses(
    groups: Sequence[Group], wires: Sequence[WireSpec]
) -> Iterator[BoundedStiffness]:
    """Compute the bounds of the bending stiffnesses of all samples and means of bundles.

    Parameters
    ----------
    groups : groups of the report; those without a bundle are ignored
    wires : of the wire sheet

    Yields
    ------
    For each group the stiffnesses of its samples, then that of its mean. The mean has bounds only
    if all its samples have the same bundle. A record without bounds or value states the reason.

    Notes
    -----
    The share is 0 where all wires and all strands slip, and 1 where nothing slips; see
    `compute_composite_degree`.
    """
    make_table = cache(partial(_make_table, {wire.name: wire for wire in wires}))
    bound = cache(partial(_bound, make_table))
    for group in groups:
        bundles = [_strip_covers(sample) for sample in group.samples]
        if not any(bundles):
            continue
        for sample, bundle in zip(group.samples, bundles, strict=True):
            bounds = bound(bundle) if bundle else (Reason.of("mechanics.studies.no_bundle"),)
            yield _add_share(_find_stiffness(group, sample), bounds)
        common_bundle, *other_bundles = dict.fromkeys(bundles)
        reasons = (Reason.of("mechanics.studies.bundles_differ"),)
        yield _add_share(
            _find_mean(group),
            reasons if other_bundles or not common_bundle else bound(common_bundle),
        )


def _make_table(specs: Mapping[str, WireSpec], name: str) -> WireTable | Reason:
    if name not in specs:
        return Reason.of("mechanics.studies.not_in_sheet", wire=name)
    try:
        return tabulate_wire(specs[name])
    except ValueError as error:
        return Reason.of("mechanics.studies.no_law", wire=name, error=error)


def _bound(make_table: Callable[[str], WireTable | Reason], bundle: Bundle) -> _Bounds:
    tables = [make_table(wire.type) for wire in bundle.wires]
    if table_errors := tuple(table for table in tables if isinstance(table, Reason)):
        return table_errors
    laws = {table.name: table for table in tables if isinstance(table, WireTable)}
    try:
        return compute_bundle_model(bundle, laws)
    except ValueError as error:
        return (Reason.of("mechanics.studies.no_model", error=error),)


def _strip_covers(sample: Sample) -> Bundle | None:
    """Return the bundle without conduit and tape, on which bounds do not depend."""
    bundle = sample.specimen.bundle
    return None if bundle is None else Bundle(bundle.wires, bundle.arrangement, bundle.positions)


def _find_stiffness(group: Group, sample: Sample) -> BoundedStiffness:
    result = find_result(sample.results, STIFFNESS_NAME)
    reasons: tuple[Reason, ...]
    if result is None:
        reasons = (Reason.of("mechanics.studies.no_stiffness"),)
        return BoundedStiffness(group.name, sample.test, None, None, reasons=reasons)
    reasons = result.reasons if result.value is None else ()
    return BoundedStiffness(group.name, sample.test, result.value, result.interval, reasons=reasons)


def _find_mean(group: Group) -> BoundedStiffness:
    number = group.find_number(STIFFNESS_NAME)
    if number is None or not number.values:
        reasons = (Reason.of("mechanics.studies.no_mean_stiffness"),)
        return BoundedStiffness(group.name, "", None, None, reasons=reasons)
    mean = number.mean.chosen
    return BoundedStiffness(group.name, "", mean.mean, mean.interval)


def _add_share(stiffness: BoundedStiffness, model: _Bounds) -> BoundedStiffness:
    if isinstance(model, tuple):
        return replace(stiffness, reasons=model)
    numbers = {name: getattr(model, name) for name in ("low", "free", "high", "principal")}
    stiffness = replace(stiffness, **numbers)
    if stiffness.value is None:
        return stiffness
    if not model.high > model.low:
        return replace(stiffness, reasons=(Reason.of("mechanics.studies.one_bound"),))
    degree = partial(compute_composite_degree, low=model.low, high=model.high)
    interval = stiffness.interval
    if interval is not None:
        interval = Interval(degree(interval.lower), degree(interval.upper), interval.level)
    return replace(stiffness, share=degree(stiffness.value), share_interval=interval)


BUNDLE_FILE = "bundle.json"
SCHEMA = 1

_UNSAFE_CHARACTERS = re.compile(r"[^\w.-]+")


@dataclass(frozen=True, slots=True)
class Conduit:
    """A conduit to choose from.

    Parameters
    ----------
    bore : inner diameter, m
    packing_fraction : of the wires in it
    holds : whether the wires in their layout fit in it
    """

    bore: float
    packing_fraction: float
    holds: bool


@dataclass(frozen=True, slots=True, eq=False)
class ModelledBundle:
    """A bundle with its model and files.

    Parameters
    ----------
    name : composition of the bundle, or name of its test
    model : bounds of its bending
    conduits : to choose from, in that order
    wanted_bore : m, of a conduit with the packing fraction `WANTED_FRACTION`
    folder : of the results
    files : that were written
    friction : fitted to the cycles of a processed test; None for anything else
    no_friction : reason why a processed test has none
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
    target : a processed test (its folder or ``result.h5``), a test sheet, the folder of a test
        sheet, or text such as ``10 B1 + 9 B2``
    wires : wire sheet that has the types of the bundle as its wires
    arrangement : overrides that of the test sheet
    bores : m, inner diameters of conduits to choose from; override that of the test sheet
    out : folder of the results; None for ``processed/bundles/<name>`` in the working folder
    figures : whether to draw
    png : figures as PNG, too; without it those of an earlier run are removed

    Returns
    -------
    The model in the best of the conduits. For a processed test it has the friction fitted to the
    first cycle, and the prediction of the other cycles.

    Raises
    ------
    LabpipeError
        If the text, the test sheet or the wire sheet has faults, a wire is not in the sheet, or
        the bundle fits no conduit; earlier results are then unchanged.
    """
    if arrangement not in (None, *ARRANGEMENTS):
        raise UsageError.about(
            "mechanics.studies.no_such_arrangement",
            "--arrangement",
            choices=", ".join(ARRANGEMENTS),
            name=arrangement,
        )
    test = read_processed_test(target)
    name, bundle = _read_bundle(target, test, arrangement)
    tables = _read_tables(target, bundle, wires)
    offered = list(bores) or [bore for bore in (bundle.conduit_bore,) if bore is not None]
    try:
        bare_model = compute_bundle_model(replace(bundle, conduit_bore=None), tables)
        model = _choose_conduit(bare_model, offered)
    except ValueError as error:
        raise ProcessingError.about(
            "mechanics.studies.wires_do_not_fit", target, error=error
        ) from error
    folder = Path("processed/bundles") / _UNSAFE_CHARACTERS.sub("-", name) if out is None else out
    diameters, smallest = model.layout.diameter, model.smallest_bore
    conduits = tuple(
        Conduit(bore, compute_packing_fraction(diameters, bore), fits_bore(smallest, bore))
        for bore in offered
    )
    modelled = ModelledBundle(name, model, conduits, compute_bore(diameters), folder)
    if test is not None:
        laws = [tables[wire.type] for wire in bundle.wires]
        try:
            modelled = replace(modelled, friction=fit_friction(model, laws, extract_loop(test)))
        except ValueError as error:
            modelled = replace(modelled, no_friction=str(error))
    earlier_files, pages = [], []
    if figures:
        earlier_files = [f"{FIGURES_FOLDER}/{name}.png" for name in (BUNDLE_FIGURE, LOOP_FIGURE)]
        pages = [make_bundle_page(model)]
        if modelled.friction is not None:
            pages.append(make_loop_page(name, modelled.friction))
    texts = {BUNDLE_FILE: json.dumps(build_json(modelled))}
    files = write_study(folder, texts, pages, earlier_files=earlier_files, png=png)
    return replace(modelled, files=files)


def _read_bundle(
    target: str, test: TestResult | None, arrangement: str | None
) -> tuple[str, Bundle]:
    """Return name and composition, of a processed test, a test sheet or text."""
    path = Path(target)
    with suppress(OSError):  # text that is too long for a file name
        path = path / SHEET_NAME if path.is_dir() else path
    if test is not None:
        name, bundle = test.test, test.specimen.bundle
    elif path.suffix in (".yaml", ".yml"):
        sheet = load_test_sheet(path)
        name, bundle = sheet.test, sheet.specimen.record.bundle
    else:
        bundle = parse_bundle(target, arrangement=arrangement or PACKED)
        name = bundle.composition.replace(" + ", " ")
        return (f"{name} {bundle.arrangement}" if len(bundle.wires) > 1 else name), bundle
    if bundle is None:
        file = path if test is None else target
        raise UsageError.about("mechanics.studies.sheet_without_bundle", file, "specimen")
    return name, replace(bundle, arrangement=arrangement or bundle.arrangement)


def _read_tables(target: str, bundle: Bundle, wires: Path) -> dict[str, WireTable]:
    """Compute the laws of the wires of a bundle."""
    sheet, tables = read_wire_sheet(wires), {}
    for spec in [
        sheet.find_wire(name, target) for name in dict.fromkeys(wire.type for wire in bundle.wires)
    ]:
        try:
            tables[spec.name] = tabulate_wire(spec)
        except ValueError as error:
            raise build_wire_error(wires, spec, "a wire that can be modelled", error) from error
    return tables


def _choose_conduit(model: BundleModel, offered: Sequence[float]) -> BundleModel:
    """Return the model inside the best of the conduits to choose from."""
    if not offered:
        return model
    diameters = model.layout.diameter
    bore = choose_bore(diameters, offered, smallest=model.smallest_bore)
    bundle = replace(model.bundle, conduit_bore=bore)
    return replace(model, bundle=bundle, packing_fraction=compute_packing_fraction(diameters, bore))


_BOUNDS = (
    *("low", "free", "high", "principal", "principal_angle", "neutral", "tensor"),
    *("axial_stiffness", "smallest_bore", "middle", "packing_fraction"),
    *("curvature", "moment_slip", "moment_stick", "layout", "notes"),
)


_FRICTION_NUMBERS = (
    *("composite_share", "slip_curvature", "slide_curvature", "held", "held_lower", "held_upper"),
    *("error_fitted", "error_held_out", "loss", "predicted_loss", "predicted", "is_held_out"),
)


def build_json(modelled: ModelledBundle) -> dict[str, object]:
    """Return the content of ``labpipe bundle --json``: lists and numbers in SI units.

    Parameters
    ----------
    modelled : a bundle
    """
    model, friction = modelled.model, modelled.friction
    slip, stick = model.is_doubtful, model.is_doubtful_stick
    return {
        "schema": SCHEMA,
        "labpipe": __version__,
        **select_json(modelled, "name", "wanted_bore", "conduits", "no_friction"),
        "bundle": asdict(model.bundle),
        "wanted_packing_fraction": WANTED_FRACTION,
        **select_json(model, *_BOUNDS, doubtful="is_doubtful", doubtful_stick="is_doubtful_stick"),
        "doubtful_curvature": model.doubtful_curvature if slip.any() else None,
        "doubtful_curvature_stick": model.doubtful_curvature_stick if stick.any() else None,
        "friction": friction
        and {
            **select_json(friction, *_FRICTION_NUMBERS),
            **select_json(friction.loop, "length", "deflection", "force", "branch"),
        },
    }


def read_processed_test(target: str) -> TestResult | None:
    """Read a processed test; return None for anything else.

    Parameters
    ----------
    target : a folder with a ``result.h5``, that file, or anything else

    Raises
    ------
    StoreError
        If the file cannot be read.
    """
    path = Path(target)
    with suppress(OSError):  # text that is too long for a file name
        path = path / RESULT_FILE if path.is_dir() and (path / RESULT_FILE).exists() else path
    return read_outcome(path) if path.suffix == ".h5" else None


def extract_loop(test: TestResult) -> BundleLoop:
    """Extract the cycles of a processed test as those of a cantilever.

    Parameters
    ----------
    test : of a bundle, with the specimen's `length` (cantilever) or `span` (three-point bending)

    Returns
    -------
    The loop. A span counts as two cantilevers of half its length, without weight.

    Raises
    ------
    ValueError
        If the test has no curve, no kink, or neither length nor span.
    """
    # of the length; smaller deflections are within the error of the zero
    min_deflection_share = 1e-3
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
    share = 1.0 if "length" in dimensions else 0.5  # each half of a span carries half the force
    rows, branch = _thin_branches(curve, min_deflection_share * length)
    slide = values.get("plateau_displacement")
    self_weight = 0.0
    if "length" in dimensions:
        specimen = parse_protocol(test.protocol_yaml, test.test).specimen
        self_weight = GRAVITY * (specimen.mass_per_length or 0.0)
    return BundleLoop(
        length=length,
        deflection=curve.displacement[rows],
        force=share * curve.force[rows],
        branch=branch,
        kink=(kink[0], share * kink[1]),
        slide=np.inf if slide is None else slide,
        self_weight=self_weight,
    )


def _thin_branches(curve: Curve, min_deflection: float) -> tuple[Ints, Ints]:
    """Return the rows of evenly spaced points of all branches, and the number of their branch."""
    points_per_branch = 30
    rows, branches = [], []
    for number, branch in enumerate(curve.branches):
        branch_rows = np.arange(branch.start, branch.stop)
        branch_rows = branch_rows[
            (curve.displacement[branch_rows] > min_deflection)
            & np.isfinite(curve.force[branch_rows])
        ]
        picks = np.linspace(0.0, len(branch_rows) - 1.0, min(points_per_branch, len(branch_rows)))
        rows.append(branch_rows[np.round(picks).astype(np.int64)])
        branches.append(np.full(len(picks), number, dtype=np.int64))
    return np.concatenate(rows), np.concatenate(branches)
