from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labpipe.wire.materials import (
    ANNEALED_COPPER,
    Elastic,
    ElasticPerfectlyPlastic,
    Material,
    RambergOsgood,
    StressTable,
)

TABLE = StressTable((0.001, 0.01, 0.05), (100e6, 150e6, 200e6), "made up")
ALL: list[Material] = [ANNEALED_COPPER, Elastic(1e9), ElasticPerfectlyPlastic(1e11, 5e7), TABLE]


@given(st.floats(1e-15, 0.5), st.floats(0.05, 0.95), st.floats(1e7, 1e10))
def test_stress_undoes_strain(strain: float, exponent: float, strength: float) -> None:
    curve = RambergOsgood(110e9, strength, exponent)
    back = curve.strain(curve.stress(np.array([strain, -strain])))
    assert back == pytest.approx([strain, -strain], rel=1e-10)


@pytest.mark.parametrize("material", ALL)
def test_odd_and_starting_with_the_modulus(material: Material) -> None:
    strain = np.array([1e-18, 1e-4, 3e-3, 0.04])
    stress = material.stress(strain)
    assert material.stress(-strain) == pytest.approx(-stress)
    assert material.stress(np.zeros(1))[0] == 0.0
    # The plastic strain falls below the elastic only slowly: strain^1.27 for copper.
    assert stress[0] == pytest.approx(material.modulus * 1e-18, rel=1e-8)
    assert np.all(np.diff(stress) >= 0.0)
    assert np.isnan(material.stress(np.array([np.nan]))[0])


def test_perfect_plasticity() -> None:
    curve = ElasticPerfectlyPlastic(100e9, 50e6)
    stress = curve.stress(np.array([-0.1, 1e-4, 0.1]))
    assert stress == pytest.approx([-50e6, 10e6, 50e6])
    assert curve.largest_strain == np.inf
    assert Elastic(1.0).largest_strain == np.inf


def test_table_is_followed_and_not_beyond() -> None:
    assert TABLE.modulus == pytest.approx(100e9)
    assert TABLE.stress(np.array([0.0005, 0.0055]))[1] == pytest.approx(125e6)
    assert np.isnan(TABLE.stress(np.array([0.051]))[0])


@pytest.mark.parametrize(
    ("strains", "stresses", "said"),
    [
        ((0.1, 0.2), (1.0,), "2 strains and 1 stresses: allowed are as many"),
        ((), (), "0 strains and 0 stresses"),
        ((0.2, 0.1), (1.0, 2.0), "the table turns back: allowed are strains that grow"),
        ((0.1, 0.2), (1.0, 0.5), "the table turns back"),
        ((0.1, 0.2), (1.0, 3.0), r"slope 20 Pa from strain=0.1 is above the first, 10 Pa"),
    ],
)
def test_bad_tables(strains: tuple[float, ...], stresses: tuple[float, ...], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        StressTable(strains, stresses)


def test_bad_numbers() -> None:
    with pytest.raises(ValueError, match=r"exponent=1.0: allowed are numbers between 0 and 1"):
        RambergOsgood(1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match=r"modulus=-1.0: allowed are finite numbers > 0"):
        Elastic(-1.0)


def test_a_table_ends_at_its_last_strain() -> None:
    table = StressTable((0.01, 0.05), (1e8, 2e8))
    assert table.largest_strain == 0.05
    assert table.stress(np.array([0.03, 0.05, 0.051])) == pytest.approx(
        [1.5e8, 2e8, np.nan], nan_ok=True
    )
