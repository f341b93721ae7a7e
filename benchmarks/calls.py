"""Run one labpipe command and write down which of its code runs, in all threads, from the start.

As a process of its own: ``python -P calls.py TREE OUT.json COMMAND ...``, with `TREE`, the folder
that holds the package, on PYTHONPATH. The hook is set before anything of labpipe is imported.
"""

import sys
import threading
from types import CodeType, FrameType

codes: set[CodeType] = set()


def hook(frame: FrameType, event: str, _: object) -> None:
    if event == "call":
        codes.add(frame.f_code)


threading.setprofile(hook)
sys.setprofile(hook)

tree, out = sys.argv[1:3]
sys.argv[:3] = ["labpipe"]
from labpipe.cli import main  # noqa: E402

status = main()
sys.setprofile(None)
threading.setprofile(None)

import inspect  # noqa: E402
import json  # noqa: E402
from pathlib import Path  # noqa: E402

package = Path(tree).resolve() / "labpipe"
ran = [
    {
        "file": Path(code.co_filename).relative_to(package).as_posix(),
        "name": code.co_qualname,
        "line": code.co_firstlineno,
        "is_function": bool(
            code.co_flags & inspect.CO_NEWLOCALS and code.co_flags & inspect.CO_OPTIMIZED
        ),
    }
    for code in codes
    if Path(code.co_filename).is_relative_to(package)
]
Path(out).write_text(json.dumps({"status": status, "ran": ran}), encoding="utf-8")
