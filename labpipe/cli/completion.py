"""``labpipe completion``: print a script for Tab completion in a shell."""

from __future__ import annotations

import argparse


def run(options: argparse.Namespace) -> int:
    """Print the script with which a shell completes commands, options and files."""
    from argcomplete.shell_integration import shellcode

    print(shellcode(["labpipe"], shell=options.shell), end="")
    return 0
