from __future__ import annotations

import numpy as np
import pytest

from labpipe.records.wire_calibration import PARAMETERS
from labpipe.report.calibration_shown import (
    SHOWN,
    length_looks,
    length_words,
    percent,
    typeset,
)
from labpipe.report.wording import count_of


def test_every_parameter_has_words_and_a_unit() -> None:
    assert tuple(SHOWN) == PARAMETERS
    assert [SHOWN[name].label for name in PARAMETERS] == [
        "Friction \u03c6 (mN)",
        "Insulation modulus (MPa)",
        "Factor on copper's strength",
    ]
    assert SHOWN["insulation_modulus"].scale.factor * 1e9 == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("the modulus was held at 1e-05 Pa", "The modulus was held at 1 \u00d7 10\u207b\u2075 Pa."),
        ("phi = F_rad (mu_s + mu_p) is 1", "\u03c6 = F_rad (\u03bc_s + \u03bc_p) is 1."),
        (
            "so strand_friction and radial_friction cannot be told apart.",
            "So \u03bc_s and \u03c6 cannot be told apart.",
        ),
        ("copper_scale does not act", "The strength of the copper does not act."),
        ("multiple philtres", "Multiple philtres."),
    ],
)
def test_sentences_fit_for_print(sentence: str, expected: str) -> None:
    assert typeset(sentence) == expected


def test_shares_lengths_and_counts() -> None:
    assert [percent(share) for share in (0.0193, 0.2345, 1.0, np.nan)] == [
        "1.9 %",
        "23.4 %",
        "100 %",
        "",
    ]
    assert length_words(0.085) == "85 mm"
    assert [count_of(number, "curve") for number in (0, 1, 2)] == [
        "0 curves",
        "1 curve",
        "2 curves",
    ]


def test_lengths_have_looks_of_their_own() -> None:
    looks = length_looks([0.12, 0.085, 0.12])
    assert list(looks) == [0.085, 0.12]
    assert len({look.colour for look in looks.values()}) == 2
    assert len({str(look.dash) for look in looks.values()}) == 2
