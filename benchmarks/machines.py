"""Whether labpipe gives the same numbers on other processors.

``python -m benchmarks.machines`` runs the demo, a calibration by its wire, and the model of wires,
bundles and a harness under several settings of numpy, OpenBLAS and the C library, each as on a
processor of its own, and compares every number of their JSON with those of the first setting. It
ends with 1 where one differs by more than `RELATIVE` of the half width of its interval, or of
itself where it has none.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import REPOSITORY, labpipe

SETTINGS = (
    {"OPENBLAS_NUM_THREADS": "1"},
    {"OPENBLAS_NUM_THREADS": "2", "OPENBLAS_CORETYPE": "Haswell"},
    {
        "OPENBLAS_NUM_THREADS": "1",
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA",
    },
)
"""As it is here, with two threads, and without the instructions that numpy, OpenBLAS and the C
library choose by processor."""
RELATIVE = 1e-6
"""Iterations end at 1e-8 of their scale and less; of an interval two digits are printed."""
WIRES = str(REPOSITORY / "examples" / "wires.xlsx")
COMMANDS: dict[str, list[str | Path]] = {
    "model.json": ["model", WIRES],
    "packed.json": ["bundle", "5 A1 + 3 A2 + 11 A3", "--wire", WIRES],
    "asymmetric.json": ["bundle", "10 A1 + 9 A2", "--wire", WIRES, "--arrangement", "asymmetric"],
    "harness.json": ["harness", REPOSITORY / "examples" / "harness-chain.yaml"],
}
"""What is run beside the demo, by the name of what it prints."""
CALIBRATE: list[str | Path] = [
    *("calibrate", "processed/demo/one-of-each/A2-085-1"),
    *("--wire", "raw/demo/one-of-each/wires.csv"),
]
"""With what the demo has made."""
AS_JSON: list[str | Path] = ["--json", "--no-figures", "--out", "out"]
CHANCE = ("sha256", "run", "labpipe")


def main() -> int:
    with ThreadPoolExecutor(2) as pool:
        numbers = list(pool.map(_numbers, SETTINGS))
    worst = [_differences(numbers[0], numbers_of_setting) for numbers_of_setting in numbers[1:]]
    for setting, differences in zip(SETTINGS[1:], worst, strict=True):
        largest = max(differences.values(), default=0.0)
        print(f"{len(numbers[0])} numbers, largest difference {largest:.1e}: {setting}")
        for name, difference in sorted(differences.items(), key=lambda item: -item[1])[:10]:
            if difference > RELATIVE:
                print(f"  {name}: {difference:.1e}")
    return int(any(value > RELATIVE for differences in worst for value in differences.values()))


def _numbers(setting: dict[str, str]) -> dict[str, Any]:
    """Numbers of all that the commands print or write under a setting, by name."""
    chosen = {**setting}
    if "NPY_DISABLE_CPU_FEATURES" in chosen:
        chosen["NPY_DISABLE_CPU_FEATURES"] = " ".join(_chosen_by_processor())
    numbers: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        for name, command in COMMANDS.items():
            numbers |= _leaves(name, json.loads(_run([*command, *AS_JSON], here, chosen)))
        _run(["demo", here, "--no-figures"], here, chosen)
        for file in sorted(here.rglob("summary.json")):
            for result in json.loads(file.read_text(encoding="utf-8"))["results"]:
                numbers[f"{file.parent.name} {result['name']}"] = result
        calibrated = json.loads(_run([*CALIBRATE, *AS_JSON], here, chosen))
        numbers |= {parameter["name"]: parameter for parameter in calibrated["parameters"]}
    return numbers


def _chosen_by_processor() -> list[str]:
    loops = importlib.import_module("numpy._core._multiarray_umath")
    features: dict[str, bool] = loops.__cpu_features__
    return [name for name in loops.__cpu_dispatch__ if features.get(name)]


def _run(command: list[str | Path], folder: Path, setting: dict[str, str]) -> str:
    process = subprocess.run(
        labpipe(*command),
        cwd=folder,
        env=os.environ | setting,
        check=True,
        capture_output=True,
        text=True,
    )
    return process.stdout


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


def _differences(ours: dict[str, Any], theirs: dict[str, Any]) -> dict[str, float]:
    """Largest relative difference by name; infinite where a name or a status differs."""
    shared = ours.keys() & theirs.keys()
    return {
        name: _difference(ours[name], theirs[name]) if name in shared else np.inf
        for name in ours.keys() | theirs.keys()
    }


def _difference(ours: Any, theirs: Any) -> float:
    width = 0.0
    if isinstance(ours, dict):  # a result, or a parameter
        if any(ours.get(key) != theirs.get(key) for key in ("status", "code", "verdict")):
            return np.inf
        ours, theirs = ([x[key] for key in ("value", "lower", "upper")] for x in (ours, theirs))
        width = 0.0 if None in ours else ours[2] - ours[1]
    first, second = (np.asarray(values, dtype=np.float64) for values in (ours, theirs))
    if first.shape != second.shape or np.any(np.isnan(first) != np.isnan(second)):
        return np.inf
    scale = 0.5 * width or np.nanmax(np.abs(first), initial=np.finfo(float).tiny)
    return float(np.nanmax(np.abs(first - second), initial=0.0) / scale)


if __name__ == "__main__":
    sys.exit(main())
