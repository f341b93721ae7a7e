"""Compare the models with other people's measurements.

``python -m tests.judges.outside`` prints the table, ``--publish`` puts it and its picture into
docs/explanations/outside.md.
"""

from __future__ import annotations

import argparse
import sys

from tests.judges.outside.cards import read_cards
from tests.judges.outside.page import counted, publish


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.judges.outside", description=__doc__)
    parser.add_argument("--publish", action="store_true", help="put the table into the docs")
    options = parser.parse_args()
    cards = read_cards()
    print(counted(cards))
    if options.publish:
        publish(cards)
    return 0


if __name__ == "__main__":
    sys.exit(main())
