"""Cycles of a processed test of a bundle, for the fit of its friction."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from labpipe.process.output_paths import RESULT_FILE
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Ints
from labpipe.records.curve import Curve
from labpipe.records.harness_bundle import BundleLoop, FrictionFit
from labpipe.records.result import TestResult
from labpipe.store.read import read_outcome
from labpipe.units import GRAVITY


def processed_test(what: str) -> TestResult | None:
    """Read a processed test; return None for anything else.

    Parameters
    ----------
    what : a folder with a ``result.h5``, that file, or anything else

    Raises
    ------
    StoreError
        If the file cannot be read.
    """
    path = Path(what)
    with suppress(OSError):  # text that is too long for a file name
        path = path / RESULT_FILE if path.is_dir() and (path / RESULT_FILE).exists() else path
    return read_outcome(path) if path.suffix == ".h5" else None


def bundle_loop(test: TestResult) -> BundleLoop:
    """Return the cycles of a processed test as those of a cantilever.

    Parameters
    ----------
    test : of a bundle, with the specimen's `length` (a cantilever) or `span` (bent between two
        supports)

    Returns
    -------
    The loop; of a cantilever with the weight of its test sheet. A span rests on both supports.

    Raises
    ------
    ValueError
        If the test has no curve, neither length nor span, or no kink.
    """
    # of the length; smaller deflections are within the error of the zero.
    min_deflection_share = 1e-3
    curve, dimensions = test.curve, test.specimen.dimensions
    values = {result.name: result.value for result in test.results}
    kink = values.get("kink_displacement"), values.get("kink_force")
    if curve is None or not curve.branches:
        message = "the test has no curve with branches"
        raise ValueError(message)
    if kink[0] is None or kink[1] is None:
        message = "the test has no kink (kink_displacement, kink_force), where its wires slip"
        raise ValueError(message)
    if "length" not in dimensions and "span" not in dimensions:
        message = "the test sheet has neither length nor span"
        raise ValueError(message)
    length = dimensions.get("length", dimensions.get("span", 0.0) / 2.0)
    share = 1.0 if "length" in dimensions else 0.5  # two halves carry the force between supports
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
        inside = np.arange(branch.start, branch.stop)
        inside = inside[
            (curve.displacement[inside] > min_deflection) & np.isfinite(curve.force[inside])
        ]
        evenly = np.linspace(0.0, len(inside) - 1.0, min(points_per_branch, len(inside)))
        rows.append(inside[np.round(evenly).astype(np.int64)])
        branches.append(np.full(len(evenly), number, dtype=np.int64))
    return np.concatenate(rows), np.concatenate(branches)


_FRICTION = (
    *("composite_share", "slip_curvature", "held", "held_lower", "held_upper"),
    *("error_fitted", "error_held_out", "loss", "predicted_loss"),
)


def friction_as_json(fit: FrictionFit) -> dict[str, object]:
    """Return the friction of a bundle as lists and numbers, SI units.

    Parameters
    ----------
    fit : of a processed test; a `slide_curvature` that is infinite becomes None
    """
    slide = fit.slide_curvature
    return {
        **{name: getattr(fit, name) for name in _FRICTION},
        "slide_curvature": slide if np.isfinite(slide) else None,
        "length": fit.loop.length,
        "deflection": fit.loop.deflection.tolist(),
        "force": fit.loop.force.tolist(),
        "branch": fit.loop.branch.tolist(),
        "predicted": fit.predicted.tolist(),
        "is_held_out": fit.is_held_out.tolist(),
    }
