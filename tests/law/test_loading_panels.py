from __future__ import annotations

import numpy as np
import pytest

from labpipe.law.loading_panels import panel_rule
from labpipe.law.plays import LinearLaw, PlayLaw, respond, virgin_plays
from tests.builders.bilinear_laws import complementary_energy, law_of_plays

PLAYS = PlayLaw(5e-3, np.array([1e-3, 4e-3]), np.array([100.0, 300.0]))


def test_panels_meet_the_law_and_its_corners() -> None:
    law = law_of_plays(PLAYS, 0.02, n_points=12)
    assert set(PLAYS.half_widths) <= set(law.moment)
    expected = respond(PLAYS, law.moment, virgin_plays(PLAYS, len(law.moment))).curvature
    assert law.curvature == pytest.approx(expected)
    assert law.energy == pytest.approx(complementary_energy(PLAYS, law.moment))
    assert law.moment[law.points][-1] == 0.02
    assert len(law.points) == 12
    assert law.energy_change.shape == (0, len(law.moment)), "no parameter changes it"
    assert law.node_energy_change.shape == (0, *law.node_energy.shape)


def test_weights_sum_to_the_moment() -> None:
    law = law_of_plays(LinearLaw(2.0), 3.0)
    assert law.node_weight.sum() == pytest.approx(3.0, rel=1e-14)
    # The energy over the moment is that of a linear law: M^3 / (6 EI).
    assert (law.node_weight * law.node_energy).sum() == pytest.approx(27.0 / 12.0, rel=1e-13)


def test_gauss_rule_is_exact_for_its_degree() -> None:
    places, weights = panel_rule(3)
    assert weights @ places**5 == pytest.approx(1.0 / 6.0, rel=1e-14)
