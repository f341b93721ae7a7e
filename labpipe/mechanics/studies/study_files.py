"""Write the files of a study (texts, workbooks, solver decks, figures) together or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from labpipe.report.figure_page import save_pages
from labpipe.report.plot_records import Page
from labpipe.store.replace import lock, map_errors, replace_files

FIGURES_FOLDER = "figures"
"""Name of the folder of the figures in the folder of the results."""


def write_study(
    folder: Path,
    texts: Mapping[str, str],
    pages: Sequence[Page] = (),
    *,
    earlier_files: Iterable[str] = (),
    write_others: Callable[[Path], Iterable[Path]] = lambda _: (),
    say: Callable[[str], None] = lambda _: None,
    png: bool = False,
) -> tuple[Path, ...]:
    """Write all files of a study together; an error leaves the files of an earlier run unchanged.

    Parameters
    ----------
    folder : folder of the results, which is made if it does not exist
    texts : contents of text files, keyed by file name
    pages : figures to draw
    earlier_files : names of files of an earlier run that are removed unless they are written again;
        the PNG files of `pages` are always among them
    write_others : function that writes other files into a given folder and returns their paths
    say : function that is called with the name of each figure before it is drawn
    png : whether each figure is written as PNG in addition to SVG

    Returns
    -------
    Paths of the files: texts, other files, figures.
    """
    earlier_files = [*earlier_files, *(f"{FIGURES_FOLDER}/{page.name}.png" for page in pages)]
    with lock(folder), replace_files(folder, earlier_files=earlier_files) as temporary_folder:
        with map_errors(folder):
            for name, text in texts.items():
                (temporary_folder / name).write_text(text, encoding="utf-8", newline="\n")
            paths = [*(temporary_folder / name for name in texts), *write_others(temporary_folder)]
        if pages:
            paths += save_pages(pages, temporary_folder / FIGURES_FOLDER, say=say, png=png)
        return tuple(folder / path.relative_to(temporary_folder) for path in paths)
