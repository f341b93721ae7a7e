from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import LabpipeError
from labpipe.mechanics.studies.bundle_bounds import (
    Conduit,
    bound_stiffnesses,
    build_json,
    extract_loop,
    model_bundle,
)
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.bundle_model import compute_bundle_model
from labpipe.protocol.load import format_protocol, parse_protocol
from labpipe.records.harness_bundle import Bundle
from labpipe.records.quality import Reason, join_reasons
from labpipe.records.result import Result, Status, TestResult
from labpipe.store.result_files import write_result
from labpipe.units import GRAVITY
from tests.approved import Approve
from tests.builders.bent_bundles import LENGTH, bent_bundle
from tests.builders.bundle_campaigns import bundle_of, bundle_sample, grouped, three_of
from tests.builders.bundles import EXAMPLES, bundle, example_wires

WIRES = read_wire_sheet(EXAMPLES).specs


SEVEN = bundle_of("7 B1", conduit="corrugated-tube", conduit_bore=0.0107)


def test_samples_and_mean_between_the_bounds_of_the_model() -> None:
    model = compute_bundle_model(Bundle(SEVEN.wires), example_wires())
    *samples, mean = bound_stiffnesses(grouped(three_of(SEVEN)), WIRES)
    assert [place.test for place in (*samples, mean)] == [*(f"{mean.group}-{n}" for n in "123"), ""]
    for place in (*samples, mean):
        assert (place.low, place.free, place.high) == (model.low, model.free, model.high)
        assert place.principal == model.principal
        assert place.value is not None
        assert place.interval is not None
        assert place.degree_interval is not None
        span = model.high - model.low
        assert place.degree == pytest.approx((place.value - model.low) / span)
        upper = (place.interval.upper - model.low) / span
        assert place.degree_interval.upper == pytest.approx(upper)
        assert place.reasons == ()
    assert mean.value == pytest.approx(sum(place.value or 0.0 for place in samples) / 3)


def test_places_without_bounds_or_values(approved: Approve) -> None:
    """Of samples, then of their mean: a sheet without a wire, wires that overlap, and so on."""
    overlapping = bundle_of("2 B1", positions=((0.0, 0.0), (1e-4, 0.0)))
    thick = [replace(wire, insulation_thickness=1.0) for wire in WIRES if wire.name == "B1"]
    reasons = (Reason("not_reached", "the branch ends at 1 mm"),)
    failed = Result("bending_stiffness", None, "N*m^2", status=Status.FAILED, reasons=reasons)
    sample, none = bundle_sample(SEVEN, 1), bundle_sample(None, 1)
    two = [sample, bundle_sample(bundle_of("12 B1"), 2)]
    lines = []
    for name, samples, wires, by in (
        ("not in the sheet", [bundle_sample(bundle_of("4 B3 + 3 B1"), 1)], WIRES, ()),
        ("overlapping", [bundle_sample(overlapping, 1)], WIRES, ()),
        ("thick", [sample], thick, ()),
        ("two kinds", two, WIRES, ("wire",)),
        ("failed", [replace(sample, results=(failed,))], WIRES, ()),
        ("no result", [replace(sample, results=())], WIRES, ()),
        ("no bundle", [none], WIRES, ()),
        ("one bundle", [none, bundle_sample(SEVEN, 2)], WIRES, ("length",)),
    ):
        for place in bound_stiffnesses(grouped(samples, *by), wires):
            bounds, value = place.low > 0.0, place.value is not None
            lines.append(f"{name}: {place.test or 'mean'}, {bounds=}, {value=}")
            lines.append(f"    {join_reasons(place.reasons)}")
    approved(lines)


SHEET = """\
test: TWB-1
protocol: force-displacement
specimen:
  type: TWB
  spool: s1
  sample: 1
"""


def sheet(folder: Path, block: str) -> Path:
    path = folder / "test.yaml"
    path.write_text(f"{SHEET}{block}files: {{frame: a.csv}}\n", encoding="utf-8")
    return path


def test_words_to_numbers_and_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    modelled = model_bundle("4 B1 + 3 B2", wires=EXAMPLES, arrangement="asymmetric")
    stated = bundle(("B1", 4), ("B2", 3), arrangement="asymmetric")
    model = compute_bundle_model(stated, example_wires())
    assert (modelled.name, modelled.conduits) == ("4 B1 3 B2 asymmetric", ())
    assert modelled.model.high == model.high
    assert modelled.wanted_bore == pytest.approx(1e-3 * np.sqrt((4 * 1.1**2 + 3 * 1.25**2) / 0.7))
    folder = Path("processed/bundles/4-B1-3-B2-asymmetric")
    assert list(modelled.files) == [folder / "bundle.json", folder / "figures/bundle.svg"]
    content = json.loads((folder / "bundle.json").read_text(encoding="utf-8"))
    assert content == json.loads(json.dumps(build_json(modelled)))
    for key in ("doubtful_curvature", "doubtful_curvature_stick", "high", "packing_fraction"):
        assert content[key] == getattr(model, key)
    for key in ("is_doubtful", "is_doubtful_stick", "moment_stick"):
        assert content[key.removeprefix("is_")] == getattr(model, key).tolist()
    assert content["bundle"]["wires"][0] == {"type": "B1", "number": 4, "diameter": None}
    assert [note["code"] for note in content["notes"]] == [
        *("range_shortened", "copper_yields", "insulation_doubtful")
    ]


def test_the_best_filled_bore_is_chosen(tmp_path: Path) -> None:
    modelled = model_bundle(
        "7 B1", wires=EXAMPLES, bores=(3.2e-3, 3.5e-3, 10.7e-3), out=tmp_path, figures=False
    )
    assert modelled.model.bundle.conduit_bore == 3.5e-3
    assert modelled.model.packing_fraction == pytest.approx(7 * 1.1**2 / 3.5**2)
    assert [conduit.holds for conduit in modelled.conduits] == [False, True, True]
    assert modelled.conduits[1] == Conduit(3.5e-3, modelled.model.packing_fraction or 0.0, True)


def test_a_test_sheet(tmp_path: Path) -> None:
    block = "wires: {B1: 4, B2: 3}, arrangement: asymmetric, conduit: tube, conduit_bore: 6 mm"
    path = sheet(tmp_path, f"  bundle: {{{block}}}\n")
    other: dict[str, object] = {"arrangement": "symmetric", "bores": (5e-3,)}
    for what, options, arrangement, bore in (
        (path, {}, "asymmetric", 6e-3),
        (tmp_path, {}, "asymmetric", 6e-3),
        (path, other, "symmetric", 5e-3),
    ):
        out = tmp_path / "out"
        modelled = model_bundle(str(what), wires=EXAMPLES, out=out, figures=False, **options)  # type: ignore[arg-type]
        assert (modelled.name, modelled.model.layout.arrangement) == ("TWB-1", arrangement)
        assert modelled.model.bundle.conduit_bore == bore


def test_bundles_that_cannot_be(tmp_path: Path, approved: Approve) -> None:
    """Some cannot be read, some not be made; X1 is 10 um too large for its bore."""
    wires = tmp_path / "wires.csv"
    wires.write_text(
        "wire,wire_diameter_mm,strands,strand_diameter_mm,lay_angles_deg,insulation_thickness_mm,"
        "layout\nX1,1.78,19,0.24,12;-15,0.3,hexagonal\n",
        encoding="utf-8",
    )
    bent = bent_bundle()
    unspecified = replace(bent, specimen=replace(bent.specimen, bundle=None))
    none = written(unspecified, tmp_path / "A2-1")
    messages = []
    for what, changes in (
        ("7 B9", {}),
        ("B1 seven", {}),
        ("9" * 30 + " B1", {}),
        ("nowhere/test.yaml", {}),
        ("7 B1", {"arrangement": "round"}),
        ("7 B1", {"bores": (3e-3,)}),
        ("7 X1", {"wires": wires}),
        (str(sheet(tmp_path, "")), {}),
        (none, {}),
    ):
        options: dict[str, object] = {"wires": EXAMPLES, "out": tmp_path / "out", **changes}
        with pytest.raises(LabpipeError) as refused:
            model_bundle(what, **options)  # type: ignore[arg-type]
        messages.append(f"{type(refused.value).__name__}: {refused.value}")
        assert not (tmp_path / "out").exists()
    approved(message.replace(str(EXAMPLES), "EXAMPLES") for message in messages)


def written(result: TestResult, folder: Path) -> str:
    folder.mkdir()
    write_result(result, folder / "result.h5")
    return str(folder)


def test_the_second_cycle_is_predicted_from_the_first(tmp_path: Path) -> None:
    """Against cycles of the virtual lab's law, in which other things give way than in this one."""
    test = written(bent_bundle(), tmp_path / "TWB-1")
    modelled = model_bundle(test, wires=EXAMPLES, out=tmp_path / "out")
    fit = modelled.friction
    assert fit is not None
    stems = [path.stem for path in modelled.files]
    assert (modelled.name, modelled.no_friction, stems[-1]) == ("TWB-1", "", "bundle-loop")
    assert fit.is_held_out.tolist() == (fit.loop.branch > 1).tolist()
    assert fit.error_held_out < 0.08
    assert fit.predicted_loss == pytest.approx(fit.loss, rel=0.35)
    # the lab's own shares: 0.14 of friction and 0.018 of the six outer wires' glue
    assert 0.10 < fit.composite_share < 0.16
    assert 0.05 < fit.held < 0.25
    content = json.loads((tmp_path / "out" / "bundle.json").read_text())["friction"]
    assert content["held"] == fit.held
    assert content["held_lower"] < content["held"] < content["held_upper"]
    assert content["slide_curvature"] is None
    assert len(content["predicted"]) == len(content["force"]) == 120


def test_bounds_without_a_loop(tmp_path: Path) -> None:
    bent, figures = bent_bundle(), tmp_path / "out" / "figures"
    figures.mkdir(parents=True)
    (figures / "bundle-loop.svg").touch()  # of an earlier run
    no_kink = "the test has no kink (kink_displacement, kink_force), where its wires slip"
    for name, result, reason in (
        ("curve", replace(bent, curve=None), "the test has no curve with branches"),
        ("kink", replace(bent, results=()), no_kink),
    ):
        test = written(result, tmp_path / name)
        modelled = model_bundle(test, wires=EXAMPLES, out=tmp_path / "out")
        assert (modelled.friction, modelled.no_friction) == (None, reason)
        assert [path.name for path in figures.iterdir()] == ["bundle.svg"]
        content = json.loads((tmp_path / "out" / "bundle.json").read_text())
        assert content["no_friction"] == reason
    unmeasured = replace(bent, specimen=replace(bent.specimen, dimensions={}))
    with pytest.raises(ValueError, match=r"^the test sheet states neither length nor span$"):
        extract_loop(unmeasured)


def test_a_span_is_two_cantilevers_and_a_cantilever_weighs_what_its_sheet_says() -> None:
    bent = bent_bundle()
    assert bent.curve is not None
    spanned = replace(bent, specimen=replace(bent.specimen, dimensions={"span": 2.0 * LENGTH}))
    cantilever, span = extract_loop(bent), extract_loop(spanned)
    assert span.length == cantilever.length == LENGTH
    assert span.force == pytest.approx(0.5 * cantilever.force)
    assert span.kink == (cantilever.kink[0], 0.5 * cantilever.kink[1])
    force = bent.curve.force.copy()
    force[10] = np.nan
    gap = extract_loop(replace(bent, curve=replace(bent.curve, force=force)))
    assert np.all(np.isfinite(gap.force))
    assert gap.deflection.min() > 1e-3 * LENGTH
    protocol = parse_protocol(bent.protocol_yaml, "p.yaml")
    specimen = protocol.specimen.model_copy(update={"mass_per_length": 0.0758})
    text = format_protocol(protocol.model_copy(update={"specimen": specimen}))
    assert cantilever.self_weight == 0.0
    assert extract_loop(replace(bent, protocol_yaml=text)).self_weight == pytest.approx(
        0.0758 * GRAVITY
    )
    assert extract_loop(replace(spanned, protocol_yaml=text)).self_weight == 0.0
