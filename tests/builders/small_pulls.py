"""Tensile tests of fifty rows, by the hundred; synthetic."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.builders.tensile_tests import TensileLab, write_pull

ROWS, REST = 50, 8


def small_pulls(home: Path, number: int) -> list[TensileLab]:
    """Tests ``S-0000`` ... of 5 s, each a little stiffer than the one before."""
    labs = []
    for seed in range(number):
        travel = np.concatenate([np.zeros(REST), np.linspace(0.0, 0.02, ROWS - REST)])
        force = (1e4 + 10.0 * seed) * travel * (1.0 - 10.0 * travel)
        noise = np.random.default_rng(seed).normal(0.0, 0.1, ROWS)
        lab = TensileLab(home, f"S-{seed:04d}")
        write_pull(lab, "tensile", force + noise, travel, rate=10.0)
        labs.append(lab)
    return labs
