"""Rosner, Technometrics 25 (1983) 165: 54 values with three outliers that hide each other.

Ratios and critical values as the NIST/SEMATECH handbook prints them (section 1.3.5.17.3).
"""

from __future__ import annotations

import numpy as np

from labpipe.statistics.outliers import find_suspects

VALUES = """
-0.25 0.68 0.94 1.15 1.20 1.26 1.26 1.34 1.38 1.43 1.49 1.49 1.55 1.56 1.58 1.65 1.69 1.70 1.76
1.77 1.81 1.91 1.94 1.96 1.99 2.06 2.09 2.10 2.14 2.15 2.23 2.24 2.26 2.35 2.37 2.40 2.47 2.54
2.62 2.64 2.90 2.92 2.92 2.93 3.21 3.26 3.30 3.59 3.68 4.30 4.64 5.34 5.42 6.01
"""


def test_three_are_marked() -> None:
    values = dict(enumerate(np.array(VALUES.split(), dtype=np.float64)))
    named = {str(name): float(value) for name, value in values.items()}
    found = find_suspects(named, dict.fromkeys(named, "one"), most=10).below(0.05)
    assert [each.value for each in found] == [6.01, 5.42, 5.34]
    assert {each.method for each in found} == {"generalised ESD test"}


def test_one_alone_is_not() -> None:
    # 3.118 where 3.158 is needed: the other two make the scatter large.
    values = {str(at): float(value) for at, value in enumerate(VALUES.split())}
    (found,) = find_suspects(values, dict.fromkeys(values, "one"), most=1).below(0.1)
    assert found.value == 6.01
    assert 0.05 < found.p < 0.1
