"""What wires, bundles and cantilevers refuse, and the words of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from labpipe.mechanics.law.plays import make_elastic_law
from labpipe.mechanics.wire.bending_law import (
    Contacts,
    compute_axial_strain,
    compute_moment_curve,
    compute_sines,
    fit_play_law,
)
from labpipe.mechanics.wire.bending_law import make_ring_model as rings_of
from labpipe.mechanics.wire.bundle_layout import (
    arrange_wires,
    choose_bore,
    compute_bore,
    compute_packing_fraction,
    find_densest_heap,
    find_sites,
    require_dense,
)
from labpipe.mechanics.wire.bundle_model import (
    Friction,
    compute_bundle_model,
    compute_composite_degree,
    compute_friction_moment,
    fit_friction,
)
from labpipe.mechanics.wire.calibration.calibrate_wire import find_tested_curvature as curvature_of
from labpipe.mechanics.wire.cantilever import (
    StringRig,
    bend_to_deflection,
    bend_to_travel,
    bend_under_force,
    make_interpolation_matrix,
    make_stations,
    make_straight,
)
from labpipe.mechanics.wire.cross_section import (
    Layer,
    compute_strand_diameter,
    compute_tube_moment,
    lay_up,
    pack_strands,
    place_hexagon,
    place_rings,
    place_sectors,
)
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.materials import (
    ANNEALED_COPPER,
    RambergOsgood,
    StressTable,
    compute_strand_moment,
)
from labpipe.mechanics.wire.wire_table import build_wire, tabulate_wire
from labpipe.records.harness_bundle import Bundle, BundleLoop, BundleWire
from labpipe.records.wire import WireSpec
from tests.approved import Approve
from tests.builders.bundles import bundle, example_wires, solid_wire
from tests.builders.loading_tests import TRUTH, wire_of
from tests.builders.stranded_wires import contacts_of, layers_of, tube, wire

A2 = WireSpec(
    "A2", 1.6e-3, (1, 6), (0.32e-3,) * 2, (float(np.radians(12.0)),), 0.3e-3, place="line 2"
)

WIRE = wire("A2")

PRESSED = lay_up(7, compute_strand_diameter(0.35e-6, 7), [np.radians(12.0)], ANNEALED_COPPER)

TABLE = StressTable((5e-4, 2e-3, 0.02), (55e6, 80e6, 150e6))

SHORT = tabulate_wire(replace(solid_wire().spec, largest_curvature=0.5))

ABOVE = bundle(("S", 2), positions=((0.0, -0.5e-3), (0.0, 0.5e-3)))

ROW = np.column_stack([np.arange(4.0), np.zeros(4)])

LINEAR, RIG = make_elastic_law(3e-3), StringRig(0.76, 0.0265, 0.085, 0.76)


def table(*points: tuple[float, float]) -> StressTable:
    return StressTable(tuple(p for p, _ in points), tuple(s for _, s in points))


def placed(*places: tuple[float, float], wires: int) -> object:
    return arrange_wires(bundle(("B1", wires), positions=places), (1.10e-3,), (37e3,))


def model(name: str, *diameter: float, **more: float) -> object:
    wires = {"S": solid_wire()} if name == "S" else example_wires()
    return compute_bundle_model(Bundle((BundleWire(name, 7, *diameter),), **more), wires)  # type: ignore[arg-type]


def friction(branch: list[int], kink: tuple[float, float], *, is_short: bool = False) -> object:
    deflection = np.array([1e-3, 5e-3, 3e-3, 1e-3])[: len(branch)]
    loop = BundleLoop(0.1143, deflection, 50.0 * deflection, np.array(branch), kink, np.inf)
    if is_short:
        return fit_friction(compute_bundle_model(ABOVE, {"S": SHORT}), [SHORT], loop)
    seven = compute_bundle_model(bundle(("B1", 7)), example_wires())
    return fit_friction(seven, [example_wires()["B1"]], loop)


def lonely() -> object:
    single = compute_bundle_model(bundle(("B1", 1)), example_wires())
    return compute_friction_moment(
        np.ones(1), single, [example_wires()["B1"]], Friction(0.1, 1.0, 1.0, 0.0)
    )


def spec(**changes: object) -> object:
    return tabulate_wire(replace(A2, **changes))  # type: ignore[arg-type]


def bent(length: float, number: float, way: str) -> object:
    rest = make_straight(LINEAR)
    if way == "force":
        return bend_under_force(LINEAR, rest, length, np.array([0.0, number]))
    if way == "travel":
        return bend_to_travel(LINEAR, rest, length, RIG, number)
    if way == "path":
        return compute_end_load_path(LINEAR, length, np.array([0.0, number]))
    return bend_to_deflection(LINEAR, rest, length, number)


CASES: dict[str, list[Callable[[], object]]] = {
    "materials": [
        lambda: StressTable((0.1, 0.2), (1.0,)),
        lambda: StressTable((), ()),
        lambda: table((0.2, 1.0), (0.1, 2.0)),
        lambda: table((0.1, 1.0), (0.2, 0.5)),
        lambda: table((0.1, 1.0), (0.2, 3.0)),
        lambda: RambergOsgood(1.0, 1.0, 1.0),
    ],
    "sections": [
        lambda: Layer(6, 1e-3, np.pi / 2.0),
        lambda: Layer(0, 1e-3),
        lambda: Layer(1, 1e-3, poisson=0.6),
        lambda: Layer(1, 1e-3, poisson=-1.0),
        lambda: Layer(1, np.nan),
        lambda: lay_up(20, 1e-3, [0.2, -0.2], ANNEALED_COPPER),
        lambda: place_hexagon((Layer(1, 1e-3), Layer(5, 1e-3, 0.2))),
        lambda: place_hexagon((Layer(1, 1e-3), Layer(6, 2e-3, 0.2))),
        lambda: place_hexagon(layers_of("A2"), tube(1.4e-3)),
        lambda: place_rings((Layer(1, 1e-3), Layer(7, 1e-3, 0.2))),
        lambda: pack_strands((Layer(1, 0.35e-3), Layer(6, 0.3e-3, 0.2)), tube(1.6e-3)),
        lambda: place_sectors(PRESSED, tube(1.1e-3)),
        lambda: place_sectors(PRESSED, radii=[0.1]),
    ],
    "friction and laws": [
        lambda: Contacts((0.1,), (0.1, 0.2)),
        lambda: Contacts((-0.1,), (0.1,)),
        lambda: rings_of(WIRE, Contacts((0.1, 0.1), (0.1, 0.1)), compute_sines(WIRE, 0.0)),
        lambda: compute_axial_strain(WIRE, -1.0),
        lambda: compute_moment_curve(WIRE, contacts_of(WIRE), np.array([1.0, -np.inf])),
        lambda: fit_play_law(WIRE, contacts_of(WIRE), largest_curvature=0.0),
        lambda: compute_strand_moment(TABLE, 0.32e-3, np.array([1.0, 250.0])),
        lambda: compute_tube_moment(replace(tube(1.6e-3), curve=TABLE), np.array([26.0])),
        lambda: curvature_of(wire_of("A2"), TRUTH, []),
    ],
    "tables": [
        lambda: spec(strand_diameters=(0.36e-3, 0.36e-3), layout="hexagonal"),
        lambda: spec(lay_angles=(np.radians(45.0),)),
        lambda: spec(lay_angles=(np.radians(70.0),)),
        lambda: spec(lay_angles=(0.2, -0.2)),
        lambda: build_wire(replace(A2, stress_table=((0.01, 0.001), (1e6, 2e6)))),
        lambda: spec(stress_table=((0.001, 0.01), (110e6, 150e6)), tension=5000.0),
        lambda: spec(orientation=np.nan),
        lambda: spec(length=0.0),
        lambda: spec(largest_curvature=-1.0),
    ],
    "bundles": [
        lambda: placed((0.0, 0.0), (2e-3, 0.0), (1e-3, 0.0), wires=3),
        lambda: find_sites(0),
        lambda: choose_bore(np.full(7, 1e-3), (2.5e-3, 2.9e-3), min_bore=3e-3),
        lambda: compute_packing_fraction(np.full(7, 1e-3), 0.0),
        lambda: compute_bore(np.full(7, 1e-3), 0),
        lambda: find_densest_heap([np.array([[0.0, 0.0], [np.nan, 1.0]])], np.ones(2)),
        lambda: require_dense(ROW, np.ones(4)),
        lambda: require_dense(np.array([[0.0, 0.0], [np.inf, 1.0]]), np.ones(2)),
        lambda: model("S", conduit_bore=2.9e-3),
        lambda: model("B9"),
        lambda: model("S", 10e-3),
        lambda: model("S", 0.1e-3),
        lambda: compute_composite_degree(1.0, 2.0, 2.0),
        lambda: compute_composite_degree(1.0, 0.0, 2.0),
        lambda: placed((0.0, 0.0), wires=3),
        lambda: friction([0, 0, 1, 1], (1e-3, 0.01)),
        lambda: friction([0, 0], (1e-3, 0.1)),
        lonely,
        lambda: Friction(0.1, 0.0, 1.0, 0.0),
        lambda: Friction(0.1, 1.0, 0.0, 0.0),
    ],
    "cantilevers": [
        *(lambda way=way: bent(0.085, np.nan, way) for way in ("force", "travel", "path", "tip")),
        *(lambda way=way: bent(0.0, 0.1, way) for way in ("force", "travel", "path", "tip")),
        lambda: bent(np.inf, 0.1, "tip"),
        lambda: make_straight(LINEAR, self_weight=-0.1),
        lambda: make_interpolation_matrix(8, np.array([1.01])),
        lambda: make_stations(3),
    ],
}


@pytest.mark.parametrize("subject", CASES)
def test_refusals(subject: str, approved: Approve) -> None:
    messages = []
    for call in CASES[subject]:
        with pytest.raises(ValueError) as refusal:  # noqa: PT011
            call()
        messages.append(f"{type(refusal.value).__name__}: {refusal.value}")
    approved(messages)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: bent(0.085, 0.09, "tip"), r"deflection=0\.09: no equilibrium beyond 0\.08"),
        (
            lambda: pack_strands(layers_of("A2"), tube(1.4e-3)),
            "the packed layout does not fit: strands",
        ),
        (
            lambda: friction([0, 0, 1, 1], (1e-3, 0.02), is_short=True),
            "beyond the laws of its wires",
        ),
    ],
)
def test_refusals_with_numbers_of_a_search(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
