"""The documentation as a site, built by `make docs` and read from a disk: nothing comes from a net.

The pages are those that a person reads in the repository, links and all. What a site needs besides,
the navigation, follows from the links of the overview pages; examples run as it is built.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_origin

from matplotlib.figure import Figure
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT)]

from labpipe import __version__  # noqa: E402

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

project = "labpipe"
author = "the labpipe authors"
project_copyright = f"2026, {author}"
release = version = __version__
root_doc = "README"
include_patterns = ["*.md", "docs/**"]
exclude_patterns = ["docs/gallery/*", "docs/site/_made/gallery/*.ipynb"]
extensions = [
    *("myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.autosummary"),
    *("sphinx_gallery.gen_gallery", "sphinx_copybutton"),
]
suppress_warnings = ["config.cache"]  # functions below cannot be pickled; all is built afresh
nitpicky = False

myst_heading_anchors = 4
myst_links_external_new_tab = False
nb_execution_mode = "off"  # the notebook is kept with its output, and runs in the tests

autosummary_generate = False
toc_object_entries = False
autodoc_typehints = "none"  # docstrings say shapes and units, which is more
add_module_names = False
autodoc_member_order = "bysource"
numpydoc_class_members_toctree = False
numpydoc_show_class_members = False
default_role = "autolink"

html_theme = "furo"
html_title = f"labpipe {__version__}"
html_show_sourcelink = False
html_show_sphinx = False
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
copybutton_here_doc_delimiter = "EOF"

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+\.(?:md|ipynb))\)")
PARAGRAPH = re.compile(r"^\*\*([\w-]+)\*\*:.*?(?=\n\n|\Z)", flags=re.MULTILINE | re.DOTALL)
SITE_ONLY = {
    "Examples and code": ("docs/site/_made/gallery/index", "docs/site/_made/index"),
    "The project": ("docs/README", "CONTRIBUTING", "CHANGELOG"),
}


CODE = """\
The code
========

In Python, ``import labpipe`` is the API: :doc:`/docs/reference/python` says what its names give.
Here stands the code behind it, a page for each package: who writes a reader, a step or a result
meets it. A package imports from those below it and never from those above.

.. toctree::
   :maxdepth: 1

"""


def write_code_pages(folder: Path) -> None:
    """Write a page for each package, in the order of the layers, with its modules one by one."""
    layers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (order,) = (each for each in layers["tool"]["importlinter"]["contracts"] if "layers" in each)
    packages = [name.strip() for layer in order["layers"] for name in layer.split("|")]
    folder.mkdir(exist_ok=True)
    for package in packages:
        path = ROOT / "labpipe" / package.replace(".", "/")
        parts = [path, *path.rglob("*.py")] if path.is_dir() else [path.with_suffix(".py")]
        names = {".".join(part.relative_to(ROOT).with_suffix("").parts) for part in parts}
        first, *others = sorted(name for name in names if not name.endswith("__init__"))
        text = _code_of(first, "=") + "".join(_code_of(name, "-") for name in others)
        (folder / f"{package}.rst").write_text(text, encoding="utf-8")
    index = CODE + "".join(f"   {package}\n" for package in packages)
    (folder / "index.rst").write_text(index, encoding="utf-8")


def _code_of(module: str, underline: str) -> str:
    return f"{module}\n{underline * len(module)}\n\n.. automodule:: {module}\n   :members:\n\n"


def toctree(pages: list[str], caption: str = "") -> str:
    """A navigation that is seen at the side and not on the page."""
    head = f":caption: {caption}\n" if caption else ""
    return f"\n```{{toctree}}\n:hidden:\n{head}\n" + "\n".join(pages) + "\n```\n"


def linked(text: str, folder: Path) -> Iterator[str]:
    """Pages that a text links to, from the root."""
    for _, target in LINK.findall(text):
        page = (folder / target).resolve().relative_to(ROOT)
        yield f"/{page.with_suffix('').as_posix()}"


def navigate(_app: Sphinx, docname: str, content: list[str]) -> None:
    """Turn the links of the overview pages into the navigation."""
    if docname == root_doc:
        overview = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
        for part in PARAGRAPH.finditer(overview):
            content[0] += toctree(list(linked(part[0], ROOT / "docs")), part[1])
        for caption, pages in SITE_ONLY.items():
            content[0] += toctree([f"/{page}" for page in pages], caption)


def figures_of(_block: Any, names: dict[str, Any], gallery: dict[str, Any]) -> str:
    """Save the figures that a block of an example has made; they are in no list of pyplot."""
    paths = []
    for value in list(names["example_globals"].values()):
        if isinstance(value, Figure) and not hasattr(value, "is_shown"):
            value.is_shown = True  # type: ignore[attr-defined]
            path = Path(next(names["image_path_iterator"]))
            value.savefig(path, dpi=120)
            paths.append(str(path))
    return str(figure_rst(paths, gallery["src_dir"]))


def skip_others(*asked: Any) -> bool | None:
    """Leave out classes of others, type variables and generic types, which numpydoc cannot read."""
    found = asked[3]
    is_ours = getattr(found, "__module__", "labpipe").startswith("labpipe")
    is_generic = isinstance(found, TypeVar) or get_origin(found) is not None
    return True if is_generic or not is_ours else None


def keep_formulas(*asked: Any) -> None:
    """Show formulas, which are indented, as they are written; a bar in a line is a bar."""
    what, lines = asked[1], asked[5]
    for number, line in reversed(list(enumerate(lines))):
        starts = line.startswith("    ") and not lines[number - 1].strip()
        is_formula = what == "module" and line.startswith("    ")
        if is_formula and starts and not lines[number - 2].startswith("    "):
            lines[number:number] = ["::", ""]
        elif not is_formula and "``" not in line:
            lines[number] = re.sub(r"\||(?<=[\s(])\*(?=\w)", r"\\\g<0>", line)


def add_front_page(app: Sphinx, error: Exception | None) -> None:
    """Let a browser that is given the folder find the first page."""
    if error is None:
        shutil.copyfile(Path(app.outdir) / "README.html", Path(app.outdir) / "index.html")


sphinx_gallery_conf = {
    "examples_dirs": "docs/gallery",
    "gallery_dirs": "docs/site/_made/gallery",
    "filename_pattern": r"\.py$",
    "image_scrapers": (figures_of,),
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "reset_modules": (),
    "abort_on_example_error": True,
    "min_reported_time": 1_000_000,
    "write_computation_times": False,
}


def setup(app: Sphinx) -> None:
    """What no setting says."""
    write_code_pages(HERE / "_made")
    app.connect("source-read", navigate)
    app.connect("autodoc-process-docstring", keep_formulas)
    app.connect("autodoc-skip-member", skip_others)
    app.connect("build-finished", add_front_page)
