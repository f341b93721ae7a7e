"""Friction of a processed bundle."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import UsageError
from labpipe.protocol.load import dump_protocol, parse_protocol
from labpipe.records.result import TestResult
from labpipe.store.write import write_result
from labpipe.studies.bundle_bounds import model_bundle
from labpipe.studies.bundle_loops import loop_of, processed_test
from labpipe.units import GRAVITY
from tests.builders.bent_bundles import LENGTH, bent_bundle
from tests.builders.bundles import EXAMPLES


def written(result: TestResult, folder: Path) -> str:
    folder.mkdir()
    write_result(result, folder / "result.h5")
    return str(folder)


def test_the_second_cycle_is_predicted_from_the_first(tmp_path: Path) -> None:
    """Against cycles of the virtual lab's law, in which other things give way than in this one."""
    what = written(bent_bundle(), tmp_path / "TWB-1")
    made = model_bundle(what, wires=EXAMPLES, out=tmp_path / "out")
    fit = made.friction
    assert fit is not None
    assert (made.name, made.no_friction) == ("TWB-1", "")
    assert fit.is_held_out.tolist() == (fit.loop.branch > 1).tolist()
    assert fit.error_held_out < 0.08
    assert fit.predicted_loss == pytest.approx(fit.loss, rel=0.35)
    # the lab's own shares: 0.14 of friction and 0.018 of the six outer wires' glue
    assert 0.10 < fit.composite_share < 0.16
    assert 0.05 < fit.held < 0.25
    told = json.loads((tmp_path / "out" / "bundle.json").read_text())["friction"]
    assert told["held"] == fit.held
    assert told["held_lower"] < told["held"] < told["held_upper"]
    assert told["slide_curvature"] is None
    assert len(told["predicted"]) == len(told["force"]) == 120
    assert (tmp_path / "out" / "figures" / "bundle-loop.svg").is_file()


def test_a_span_is_two_cantilevers() -> None:
    whole = bent_bundle()
    half = replace(whole, specimen=replace(whole.specimen, dimensions={"span": 2.0 * LENGTH}))
    one, other = loop_of(whole), loop_of(half)
    assert other.length == one.length == LENGTH
    assert other.force == pytest.approx(0.5 * one.force)
    assert other.kink == (one.kink[0], 0.5 * one.kink[1])


def test_a_cantilever_weighs_what_its_sheet_says() -> None:
    """A bundle on two supports is none that lies level, its tip held."""
    whole = bent_bundle()
    protocol = parse_protocol(whole.protocol_yaml, "p.yaml")
    specimen = protocol.specimen.model_copy(update={"mass_per_length": 0.0758})
    said = dump_protocol(protocol.model_copy(update={"specimen": specimen}))
    heavy = replace(whole, protocol_yaml=said)
    assert loop_of(whole).self_weight == 0.0
    assert loop_of(heavy).self_weight == pytest.approx(0.0758 * GRAVITY)
    span = replace(heavy, specimen=replace(whole.specimen, dimensions={"span": 0.15}))
    assert loop_of(span).self_weight == 0.0


def test_the_zero_and_gaps_are_left_out() -> None:
    result = bent_bundle()
    assert result.curve is not None
    force = result.curve.force.copy()
    force[10] = np.nan
    found = loop_of(replace(result, curve=replace(result.curve, force=force)))
    assert np.all(np.isfinite(found.force))
    assert found.deflection.min() > 1e-3 * LENGTH


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"curve": None}, "the test has no curve with branches"),
        (
            {"results": ()},
            "the test has no kink (kink_displacement, kink_force): where its wires slip",
        ),
    ],
)
def test_bounds_without_a_loop(changes: dict[str, object], said: str, tmp_path: Path) -> None:
    result = replace(bent_bundle(), **changes)  # type: ignore[arg-type]
    what = written(result, tmp_path / "TWB-1")
    made = model_bundle(what, wires=EXAMPLES, out=tmp_path / "out", figures=False)
    assert made.friction is None
    assert made.no_friction == said
    assert json.loads((tmp_path / "out" / "bundle.json").read_text())["no_friction"] == said


def test_neither_length_nor_span() -> None:
    result = bent_bundle()
    bare = replace(result, specimen=replace(result.specimen, dimensions={}))
    with pytest.raises(ValueError, match=r"^the test sheet has neither length nor span$"):
        loop_of(bare)


def test_a_processed_test_without_a_bundle(tmp_path: Path) -> None:
    result = bent_bundle()
    bare = replace(result, specimen=replace(result.specimen, bundle=None))
    what = written(bare, tmp_path / "A2-1")
    with pytest.raises(UsageError, match=r"A2-1, specimen: expected a bundle, found none\. Write"):
        model_bundle(what, wires=EXAMPLES, out=tmp_path / "out")


def test_what_is_no_processed_test(tmp_path: Path) -> None:
    assert processed_test("10 B1 + 9 B2") is None
    assert processed_test(str(tmp_path)) is None
    assert processed_test("B1 " * 3000) is None
