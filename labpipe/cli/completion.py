"""``labpipe completion``."""

from __future__ import annotations

import argparse


def run(options: argparse.Namespace) -> int:
    """Print what a shell is to be told, so that Tab completes commands, options and files."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["labpipe"], shell=options.shell), end="")
    return 0
