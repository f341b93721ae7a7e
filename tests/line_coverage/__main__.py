"""Put on docs/explanations/rod-bands.md what stands beside the study of lines.

``draws`` solves draws of six lines and writes how the bands stand beside them; ``second`` solves
some lines in space by a rod of its own and writes how far the study's truth is from that.
"""

from __future__ import annotations

import argparse
import sys

from tests.coverage.page import put
from tests.coverage.study import ROOT, kept_rows
from tests.line_coverage import drawn_bands, second_truths

PAGE = ROOT / "docs" / "explanations" / "rod-bands.md"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.line_coverage", description=__doc__)
    parser.add_argument("task", choices=["draws", "second"])
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    options = parser.parse_args()
    if options.task == "draws":
        text = drawn_bands.table(drawn_bands.all_cases(options.jobs))
    else:
        text = second_truths.table(kept_rows(), second_truths.all_solved(options.jobs))
    put(text, options.task, PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
