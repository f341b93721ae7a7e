"""Whether labpipe gives the same numbers on other processors.

``python -m benchmarks.machines`` runs the demo, the model of wires, bundles and a harness under
several settings of numpy and OpenBLAS, each as on a processor of its own, and compares every number
of their JSON with those of the first setting. It ends with 1 where one differs by more than
`RELATIVE` of itself, or of the half width of its interval.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import REPOSITORY, labpipe

SETTINGS = (
    {"OPENBLAS_NUM_THREADS": "1"},
    {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "Haswell"},
    {"OPENBLAS_NUM_THREADS": "1", "OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": ""},
)
"""As it is here, with two threads, and without the instructions that numpy chooses by processor."""
RELATIVE = 1e-6
"""Iterations end at tolerances of 1e-8 and less; a printed number has five digits at most."""
WIRES = str(REPOSITORY / "examples" / "wires.xlsx")
COMMANDS: dict[str, list[str | Path]] = {
    "model.json": ["model", WIRES],
    "packed.json": ["bundle", "5 A1 + 3 A2 + 11 A3", "--wire", WIRES],
    "asymmetric.json": ["bundle", "10 A1 + 9 A2", "--wire", WIRES, "--arrangement", "asymmetric"],
    "harness.json": ["harness", REPOSITORY / "examples" / "harness-chain.yaml"],
}
"""What is run beside the demo, by the name of what it prints."""
CHANCE = ("sha256", "run", "labpipe")


def main() -> int:
    numbers = [dict(_numbers(setting)) for setting in SETTINGS]
    worst = [_differences(numbers[0], other) for other in numbers[1:]]
    for setting, differences in zip(SETTINGS[1:], worst, strict=True):
        largest = max(differences.values(), default=0.0)
        print(f"{len(numbers[0])} numbers, largest difference {largest:.1e}: {setting}")
        for name, difference in sorted(differences.items(), key=lambda item: -item[1])[:10]:
            if difference > RELATIVE:
                print(f"  {name}: {difference:.1e}")
    return int(any(value > RELATIVE for found in worst for value in found.values()))


def _numbers(setting: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Names and numbers of all that the commands print or write under a setting."""
    chosen = {**setting}
    if "NPY_DISABLE_CPU_FEATURES" in chosen:
        chosen["NPY_DISABLE_CPU_FEATURES"] = " ".join(_chosen_by_processor())
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        for name, command in COMMANDS.items():
            text = _run([*command, "--json", "--no-figures", "--out", here / "out"], here, chosen)
            yield from _leaves(name, json.loads(text))
        _run(["demo", here, "--no-figures"], here, chosen)
        for file in sorted(here.rglob("summary.json")):
            for result in json.loads(file.read_text(encoding="utf-8"))["results"]:
                yield f"{file.parent.name} {result['name']}", result


def _chosen_by_processor() -> list[str]:
    loops = importlib.import_module("numpy._core._multiarray_umath")
    features: dict[str, bool] = loops.__cpu_features__
    return [name for name in loops.__cpu_dispatch__ if features.get(name)]


def _run(command: list[str | Path], folder: Path, setting: dict[str, str]) -> str:
    done = subprocess.run(
        labpipe(*command),
        cwd=folder,
        env=os.environ | setting,
        check=True,
        capture_output=True,
        text=True,
    )
    return done.stdout


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers and lists of numbers of a document, with their paths."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in CHANCE:
                yield from _leaves(f"{name} {key}", inner)
    elif isinstance(value, list) and any(isinstance(inner, dict | list | str) for inner in value):
        for number, inner in enumerate(value):
            yield from _leaves(f"{name} {number}", inner)
    elif isinstance(value, int | float | list):
        yield name, value


def _differences(one: dict[str, Any], other: dict[str, Any]) -> dict[str, float]:
    """Largest relative difference by name; infinite where a name or a status differs."""
    return {
        name: _difference(one[name], other[name]) if name in one and name in other else np.inf
        for name in {**one, **other}
    }


def _difference(one: Any, other: Any) -> float:
    if isinstance(one, dict):  # a result: value and ends to its half width
        if (one["status"], one["code"]) != (other["status"], other["code"]):
            return np.inf
        one, other = (
            [result[key] for key in ("value", "lower", "upper") if result[key] is not None]
            for result in (one, other)
        )
    first, second = (np.asarray(values, dtype=np.float64) for values in (one, other))
    if first.shape != second.shape:
        return np.inf
    scale = np.max(np.abs(first), initial=np.finfo(float).tiny)
    return float(np.max(np.abs(np.nan_to_num(first - second)), initial=0.0) / scale)


if __name__ == "__main__":
    sys.exit(main())
