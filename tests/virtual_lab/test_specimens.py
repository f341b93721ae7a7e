"""Wires of strands: the model's first loading, its loops, and what scales."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from labpipe.law.plays import respond, virgin_plays
from labpipe.records.wire_calibration import PARAMETERS
from labpipe.virtual_lab.specimens import WIRES, StrandedWire
from labpipe.wire.bending_law import moment_curvature, stick_stiffness
from labpipe.wire.materials import ANNEALED_COPPER
from tests.judges.bending_history import bend_along

EVERY = pytest.mark.parametrize("wire", WIRES.values(), ids=WIRES)


def test_the_wires_of_the_table() -> None:
    assert list(WIRES) == ["A1", "A2", "A3", "B1", "B2"]
    areas = [wire.section().layers[0].area * wire.n_strands for wire in WIRES.values()]
    assert areas == pytest.approx([0.37e-6, 0.56e-6, 0.86e-6, 0.35e-6, 0.49e-6], rel=0.01)
    assert WIRES["B1"].section().kind == "compressed"
    assert WIRES["A3"].section().kind == "hexagonal"


def test_what_a_calibration_looks_for() -> None:
    parameters = replace(WIRES["A2"], copper_scale=1.1).parameters
    assert tuple(parameters) == PARAMETERS
    assert list(parameters.values()) == pytest.approx([0.0465, 1e9, 1.1])


@EVERY
def test_first_loading_is_that_of_the_wire_model(wire: StrandedWire) -> None:
    law = wire.law()
    curvature = np.geomspace(1e-3, 70.0, 200)
    moment = moment_curvature(wire.section(), wire.contacts(), curvature).moment
    found = respond(law, moment, virgin_plays(law, len(moment))).curvature
    assert found == pytest.approx(curvature, rel=2e-3)  # a polygon between its corners
    assert law.stiffness == pytest.approx(stick_stiffness(wire.section()), rel=1e-3)


@EVERY
def test_unloading_is_that_of_sliders_and_kinematic_plasticity(wire: StrandedWire) -> None:
    law, peak = wire.law(), 29.0
    there, back = np.linspace(0.3, peak, 97), np.linspace(peak, -5.0, 140)[1:]
    path = bend_along(wire.section(), wire.contacts(), np.concatenate([there, back]))
    top, down = path[len(there) - 1], path[len(there) :]
    history = respond(law, np.array([top]), virgin_plays(law, 1)).plays
    found = respond(law, down, np.repeat(history, len(down), axis=0)).curvature
    moment = np.interp(back[::-1], found[::-1], down[::-1])[::-1]
    assert np.max(np.abs(moment - down)) < 1e-3 * top


def test_a_sample_multiplies_moments() -> None:
    plain, sample = WIRES["A3"].law(), WIRES["A3"].scaled(1.1).law()
    moment = np.geomspace(1e-5, 2e-2, 40)
    found = respond(sample, 1.1 * moment, virgin_plays(sample, 40)).curvature
    wanted = respond(plain, moment, virgin_plays(plain, 40)).curvature
    assert found == pytest.approx(wanted, rel=1e-12)
    assert WIRES["A3"].scaled(1.1).scaled(2.0).factor == pytest.approx(2.2)


def test_copper_scale_and_insulation_act_on_their_parts() -> None:
    wire = replace(WIRES["A2"], copper_scale=1.2, insulation_modulus=2e9)
    section, usual = wire.section(), WIRES["A2"].section()
    assert section.layers[0].material == replace(ANNEALED_COPPER, strength=1.2 * 530e6)
    assert section.insulation is not None
    assert usual.insulation is not None
    assert section.insulation.bending_stiffness == 2.0 * usual.insulation.bending_stiffness


def test_strands_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match=r"does not fit: strands overlap the bore"):
        replace(WIRES["A2"], wall=0.4e-3).section()
    with pytest.raises(ValueError, match=r"less than the .* m that the strands need"):
        replace(WIRES["B1"], wall=0.3e-3).section()
