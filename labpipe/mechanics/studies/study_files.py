"""Write the files of a study (texts, workbooks, decks, figures) together or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from labpipe.report.figure_page import list_pngs, save_pages
from labpipe.report.plot_records import Page
from labpipe.store.replace import locked, replacing_together, storing

FIGURES_FOLDER = "figures"


def write_study(
    folder: Path,
    texts: Mapping[str, str],
    pages: Sequence[Page] = (),
    *,
    owned: Iterable[str] = (),
    write_others: Callable[[Path], Iterable[Path]] = lambda _: (),
    say: Callable[[str], None] = lambda _: None,
    png: bool = False,
) -> tuple[Path, ...]:
    """Write all files of a study together; on an error earlier files are unchanged.

    Parameters
    ----------
    folder : of the results, created if it does not exist
    texts : contents of text files, by name
    pages : figures
    owned : files of an earlier run that are removed if there is no new one, besides the PNG files
        of the figures
    write_others : writes further files into a folder, and returns their paths
    say : called with the name of each stage
    png : figures as PNG, too

    Returns
    -------
    The files: texts, others, figures.
    """
    owned = [*owned, *list_pngs(pages, FIGURES_FOLDER)]
    with locked(folder), replacing_together(folder, owned=owned) as stage:
        with storing(folder):
            for name, text in texts.items():
                (stage / name).write_text(text, encoding="utf-8", newline="\n")
            files = [*(stage / name for name in texts), *write_others(stage)]
        if pages:
            files += save_pages(pages, stage / FIGURES_FOLDER, say=say, png=png)
        return tuple(folder / path.relative_to(stage) for path in files)
