"""The model of a bundle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labpipe.records.harness_bundle import Bundle, BundleModel, BundleWire
from labpipe.records.quality import Severity
from labpipe.wire.bundle_model import bundle_model
from tests.builders.bundles import bundle, example_wires, solid_wire


def codes(model: BundleModel) -> list[str]:
    return [note.code for note in model.notes]


def test_bounds_and_laws_of_a_mixed_bundle() -> None:
    wires = example_wires()
    model = bundle_model(bundle(("B1", 10), ("B2", 9), arrangement="asymmetric"), wires)
    b1, b2 = wires["B1"], wires["B2"]
    assert model.low == pytest.approx(10 * b1.slip_stiffness + 9 * b2.slip_stiffness)
    assert model.free == pytest.approx(10 * b1.stick_stiffness + 9 * b2.stick_stiffness)
    assert model.axial_stiffness == pytest.approx(10 * b1.axial_stiffness + 9 * b2.axial_stiffness)
    assert model.low < model.free < model.principal[0] < model.high <= model.principal[1]
    assert model.high == model.tensor[1, 1]
    assert abs(model.principal_angle) == pytest.approx(np.pi / 2.0, abs=0.1)  # across the border
    assert np.all(model.moment_stick[1:] > model.moment_slip[1:])
    first = model.moment_stick[1] / model.curvature[1]
    assert model.free < first < model.high
    assert model.packing_fraction is None
    assert codes(model) == ["range_shortened", "copper_yields", "insulation_doubtful"]


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(number=st.integers(1, 5), core=st.floats(0.3e-3, 2e-3), arrangement=st.integers(0, 2))
def test_bounds_are_in_order(number: int, core: float, arrangement: int) -> None:
    wires = {"S": solid_wire(), "T": solid_wire("T", core=core)}
    word = ("packed", "symmetric", "asymmetric")[arrangement]
    model = bundle_model(bundle(("S", number), ("T", 3), arrangement=word), wires)
    assert 0.0 < model.low <= model.free * (1.0 + 1e-12)
    assert model.free <= model.principal[0] * (1.0 + 1e-12)
    least, largest = model.principal
    assert least * (1.0 - 1e-9) <= model.high <= largest * (1.0 + 1e-9)
    assert np.all(model.moment_stick >= model.moment_slip)
    elastic = model.high * model.curvature
    assert model.moment_stick == pytest.approx(elastic, rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_all_lengths_times_c(factor: float) -> None:
    small, large = (
        bundle_model(
            bundle(("S", 12)),
            {"S": solid_wire(core=factor_ * 0.8e-3, wall=factor_ * 0.1e-3)},
        )
        for factor_ in (1.0, factor)
    )
    assert large.low == pytest.approx(factor**4 * small.low)
    assert large.high == pytest.approx(factor**4 * small.high)
    assert large.smallest_bore == pytest.approx(factor * small.smallest_bore)


@pytest.mark.parametrize("number", [7, 12, 19, 27])
def test_regular_bundles_are_alike_in_all_directions(number: int) -> None:
    model = bundle_model(bundle(("S", number)), {"S": solid_wire()})
    assert model.principal[0] == pytest.approx(model.principal[1])
    assert model.principal_angle == 0.0
    assert model.neutral == pytest.approx((0.0, 0.0), abs=1e-12)


def test_a_single_wire_is_itself() -> None:
    table = example_wires()["B1"]
    model = bundle_model(bundle(("B1", 1)), {"B1": table})
    assert model.high == model.free == table.stick_stiffness
    assert model.low == table.slip_stiffness
    assert model.moment_stick == pytest.approx(model.moment_slip)
    assert model.moment_slip == pytest.approx(table.moment)
    assert codes(model) == ["insulation_doubtful"]


def test_wires_of_one_kind_under_two_names() -> None:
    """A mixture of wires that are alike is a bundle of one kind, however it is arranged."""
    wires = {name: solid_wire(name) for name in ("S", "T")}
    whole = bundle_model(bundle(("S", 19)), wires)
    for arrangement in ("packed", "symmetric", "asymmetric"):
        mixed = bundle_model(bundle(("S", 10), ("T", 9), arrangement=arrangement), wires)
        assert mixed.tensor == pytest.approx(whole.tensor, abs=1e-9)


def test_order_of_stated_wires_does_not_matter() -> None:
    places = ((0.0, 0.0), (2e-3, 0.0), (0.0, 3e-3), (4e-3, 4e-3))
    wires = example_wires()
    once = bundle_model(bundle(("B1", 2), ("B2", 2), positions=places), wires)
    turned = bundle_model(bundle(("B2", 2), ("B1", 2), positions=places[2:] + places[:2]), wires)
    assert turned.tensor == pytest.approx(once.tensor)
    assert turned.moment_stick == pytest.approx(once.moment_stick)


def test_packing_fraction_and_bore() -> None:
    model = bundle_model(bundle(("S", 7), conduit_bore=3.3e-3), {"S": solid_wire()})
    assert model.packing_fraction == pytest.approx(7.0 / 3.3**2)
    assert model.smallest_bore == pytest.approx(3e-3)
    assert model.middle == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_bundle_that_does_not_fit() -> None:
    with pytest.raises(
        ValueError,
        match=r"^the 7 wires as they lie need a bore of 3 mm, the conduit has 2\.9 mm "
        r"\(packing fraction 0\.832\)$",
    ):
        bundle_model(bundle(("S", 7), conduit_bore=2.9e-3), {"S": solid_wire()})


def test_a_type_without_a_law() -> None:
    with pytest.raises(
        ValueError, match=r"^the wire type 'B9' has no law: there are those of B1, B2$"
    ):
        bundle_model(bundle(("B9", 3)), example_wires())
    with pytest.raises(ValueError, match=r"there are those of none$"):
        bundle_model(bundle(("B9", 3)), {})


def test_a_diameter_other_than_that_of_the_law() -> None:
    wide = Bundle((BundleWire("S", 7, 1.2e-3),))
    model = bundle_model(wide, {"S": solid_wire()})
    assert model.smallest_bore == pytest.approx(3.6e-3)
    (note,) = model.notes
    assert (note.code, note.severity) == ("diameter_differs", Severity.WARNING)
    assert note.message == (
        "S: the bundle says 1.2 mm over the insulation, which places the wires; the law is that of "
        "a wire of 1 mm"
    )
    near = Bundle((BundleWire("S", 7, 1.04e-3),))
    assert bundle_model(near, {"S": solid_wire()}).notes == ()


@pytest.mark.parametrize(("diameter", "said"), [(10e-3, "10 mm"), (0.1e-3, "0.1 mm")])
def test_a_diameter_in_a_wrong_unit(diameter: float, said: str) -> None:
    wrong = Bundle((BundleWire("S", 7, diameter),))
    with pytest.raises(
        ValueError,
        match=rf"^S: the bundle says {said} over the insulation, the wire sheet 1 mm; allowed is "
        r"up to a factor of 2 between them, so check the unit",
    ):
        bundle_model(wrong, {"S": solid_wire()})
    far = Bundle((BundleWire("S", 7, 1.9e-3),))
    assert "diameter_differs" in codes(bundle_model(far, {"S": solid_wire()}))


def test_oblique_axes_are_told() -> None:
    places = ((0.0, 0.0), (1e-3, 1e-3), (2e-3, 2e-3))
    model = bundle_model(bundle(("S", 3), positions=places), {"S": solid_wire()})
    assert np.degrees(model.principal_angle) == pytest.approx(45.0)
    (note,) = model.notes
    assert note.code == "oblique_axes"
    assert note.message.startswith("the principal axes are oblique (45 deg from x to the stiffest")
    lost = 1.0 - 1.0 / (np.linalg.inv(model.tensor)[1, 1] * model.high)
    assert f"is {100.0 * lost:.2g} % less stiff" in note.message


def test_copper_yields_where_it_says() -> None:
    model = bundle_model(bundle(("B1", 19)), example_wires())
    note = model.notes[0]
    assert note.code == "copper_yields"
    secant = model.moment_stick[1:] / model.curvature[1:]
    at = model.curvature[1:][secant < 0.5 * model.high][0]
    assert note.message == (
        f"copper that is stretched yields: a sticking bundle, bent along y, has less than half of "
        f"its {float(f'{1e6 * model.high:.4g}'):.10g} N mm^2 beyond {at:.3g} 1/m"
    )


def test_no_copper_is_stretched_in_wires_beside_each_other() -> None:
    """What two wires in a row lose, bent out of it, is their strands' friction."""
    model = bundle_model(bundle(("B1", 2)), example_wires())
    assert model.high == pytest.approx(model.free)
    assert codes(model) == ["insulation_doubtful"]


def test_moments_end_with_the_stress_table() -> None:
    """Wires 200 mm apart reach a strain of 0.5 long before the end of their own law."""
    places = ((0.0, 0.0), (0.0, 0.2))
    model = bundle_model(bundle(("S", 2), positions=places), {"S": solid_wire()})
    assert model.curvature[-1] == pytest.approx(2.5)
    assert np.isfinite(model.moment_stick).all()
    (note,) = model.notes
    assert note.message == (
        "moments are given up to 2.5 1/m, where sticking wires 200 mm apart reach the last strain "
        "of a stress table; the law of S goes to 50 1/m"
    )


def test_the_insulation_beyond_its_straight_line_is_doubtful() -> None:
    """Rims at 3 %: of a wire alone at its radius, of one that sticks at its height above y0."""
    table = example_wires()["B1"]
    model = bundle_model(bundle(("B1", 7)), {"B1": table})
    radius = table.layout.wire_radius
    assert model.doubtful_curvature == pytest.approx(0.03 / radius)
    highest = float(np.abs(model.layout.y).max()) + radius
    assert model.doubtful_curvature_stick == pytest.approx(0.03 / highest)
    assert np.array_equal(model.is_doubtful, model.curvature > 0.03 / radius)
    assert model.is_doubtful_stick.sum() > model.is_doubtful.sum() > 0
    note = model.notes[-1]
    assert (note.code, note.severity) == ("insulation_doubtful", Severity.WARNING)
    assert (
        f"doubtful beyond {0.03 / highest:.4g} 1/m if wires stick, and beyond {0.03 / radius:.4g}"
        in note.message
    )


def test_a_wire_alone_has_one_range() -> None:
    model = bundle_model(bundle(("B1", 1)), example_wires())
    assert f"doubtful beyond {model.doubtful_curvature:.4g} 1/m (lighter" in model.notes[-1].message


def test_an_insulation_that_holds_is_not_doubted() -> None:
    model = bundle_model(bundle(("S", 7)), {"S": solid_wire()})
    assert not model.is_doubtful.any()
    assert not model.is_doubtful_stick.any()
    assert "insulation_doubtful" not in codes(model)
