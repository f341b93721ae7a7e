"""Figures of a report's page in a real browser: values, zoom, curves on and off."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest

from tests.builders.browsers import Shown, launched, shown
from tests.builders.campaigns import bilinear
from tests.builders.report_pages import campaign_of, page_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, FloatRect, Locator

NAMES = [f"T-{number}" for number in range(1, 7)]
MM = 1e-3


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    yield from launched()


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return page_of(tmp_path_factory.mktemp("six"), campaign_of(NAMES))


class Drawn(NamedTuple):
    """The first figure of curves, and where its axes lie on the screen."""

    seen: Shown
    figure: Locator
    box: FloatRect

    def at(self, across: float, up: float) -> tuple[float, float]:
        """A place of the figure, as shares of its axes, on the screen."""
        return self.box["x"] + across * self.box["width"], self.box["y"] + up * self.box["height"]

    def reads(self) -> tuple[str, float, float]:
        """Who is pointed at, mm and N."""
        words = self.figure.locator(".readout").text_content() or ""
        found = re.fullmatch(r"(.+) · ([-\u2212\d.]+) mm · ([-\u2212\d.]+) N", words)
        assert found, words
        across, up = (float(each.replace("\u2212", "-")) for each in found.groups()[1:])
        return found[1], across, up

    def ticks(self, axis: str) -> list[float]:
        """Numbers at an axis, as they stand there."""
        texts = self.figure.locator(f".{axis}-axis .tick text").all_text_contents()
        return [float(each.replace("\u2212", "-")) for each in texts]

    def view(self) -> list[float]:
        found = self.figure.locator("svg.area").get_attribute("viewBox") or ""
        return [float(each) for each in found.split()]


def drawn(seen: Shown) -> Drawn:
    figure = seen.page.locator("figure.plot[data-kind=curves]").first
    figure.scroll_into_view_if_needed()
    script = "(area) => { const r = area.farthestViewportElement.getBoundingClientRect(),"
    script += " s = r.width / area.farthestViewportElement.viewBox.baseVal.width,"
    script += " v = (name) => Number(area.getAttribute(name)) * s; return {x: r.x + v('x'),"
    script += " y: r.y + v('y'), width: v('width'), height: v('height')}; }"
    return Drawn(seen, figure, figure.locator("svg.area").evaluate(script))


WHOLE = [0.0, 0.0, 65535.0, 65535.0]


@pytest.mark.slow
def test_a_curve_says_its_values_under_the_mouse(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        plot = drawn(seen)
        for across in (0.3, 0.5, 0.7):
            for up in np.linspace(0.05, 0.95, 19):
                seen.page.mouse.move(*plot.at(across, float(up)))
                if plot.figure.locator(".readout").text_content():
                    break
            who, x, force = plot.reads()
            true = float(bilinear(np.array([x * MM]))[0])
            assert force == pytest.approx(true, abs=0.25 * true)  # its group scatters so much
            assert who in {*NAMES, "mean"}
        seen.page.mouse.move(*plot.at(0.02, 0.02))
        assert plot.figure.locator(".tip").is_hidden()


@pytest.mark.slow
def test_a_value_is_that_of_the_curve_pointed_at(browser: Browser, six: Path) -> None:
    """Along the curve of one sample, by keyboard, against the samples it was drawn of."""
    (sample,) = (each for each in campaign_of(NAMES).groups[0].samples if each.test == "T-3")
    curve = sample.loading[0]
    with shown(browser, six) as seen:
        plot = drawn(seen)
        plot.figure.locator(".legend").get_by_role("button", name="none", exact=True).click()
        plot.figure.locator(".legend li[data-t='2'] button").click()
        plot.figure.locator("svg.frame").focus()
        read = []
        for _ in range(25):
            seen.press("ArrowRight")
            read.append(plot.reads())
    assert {who for who, _, _ in read} == {"T-3"}
    x, force = (np.array(each) for each in zip(*[row[1:] for row in read], strict=True))
    assert (np.diff(x) > 0).all()
    # The curve was drawn to 1/65535 of its axes, and its values are read to four figures.
    gap = np.abs(np.interp(x * MM, curve.displacement, curve.force) - force)
    assert gap.max() < 0.003 * float(np.ptp(curve.force))


def test_zoom_by_mouse_and_back(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        plot = drawn(seen)
        before = {axis: plot.ticks(axis) for axis in "xy"}
        seen.page.mouse.move(*plot.at(0.25, 0.25))
        seen.page.mouse.down()
        seen.page.mouse.move(*plot.at(0.5, 0.75), steps=3)
        seen.page.mouse.up()
        x, y, width, height = plot.view()
        assert [x, y, width, height] == pytest.approx(
            [0.25 * 65535, 0.25 * 65535, 0.25 * 65535, 0.5 * 65535], abs=200
        )
        span = {axis: plot.ticks(axis) for axis in "xy"}
        for axis in "xy":
            assert len(span[axis]) >= 3
            assert min(before[axis]) <= min(span[axis]) < max(span[axis]) <= max(before[axis])
        inside = seen.page.evaluate(
            """(box) => [...document.querySelectorAll("figure.plot[data-kind=curves]")][0]
            && [...document.querySelectorAll("figure.plot[data-kind=curves]")[0]
            .querySelectorAll(".x-axis .tick path")].every((tick) => {
              const x = tick.getBoundingClientRect().x;
              return x > box.x - 2 && x < box.x + box.width + 2; })""",
            dict(plot.box),
        )
        assert inside
        seen.page.mouse.dblclick(*plot.at(0.5, 0.5))
        assert plot.view() == WHOLE
        assert {axis: plot.ticks(axis) for axis in "xy"} == before


def test_the_wheel_scrolls_the_page_and_with_ctrl_zooms(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        plot = drawn(seen)
        seen.page.mouse.move(*plot.at(0.5, 0.5))
        seen.page.mouse.wheel(0, -100)
        assert plot.view() == WHOLE
        seen.page.keyboard.down("Control")
        seen.page.mouse.wheel(0, -100)
        seen.page.keyboard.up("Control")
        seen.page.wait_for_function(
            "() => !document.querySelector('figure.plot[data-kind=curves] svg.area')"
            ".getAttribute('viewBox').startsWith('0 0 65535')"
        )
        assert plot.view()[2] == pytest.approx(0.8 * 65535)


@pytest.mark.slow
def test_zoom_by_keyboard_and_what_it_cannot_show(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        plot = drawn(seen)
        note = plot.figure.locator(".zoom-note")
        plot.figure.locator("svg.frame").focus()
        seen.press("ArrowRight", "ArrowRight")
        assert note.is_hidden()
        seen.press(*"++++")
        assert plot.view()[2] == pytest.approx(65535 / 16)
        assert "at most 150 points of each curve" in (note.text_content() or "")
        assert note.is_visible()
        before = plot.view()[0]
        seen.press("Shift+ArrowRight")
        assert plot.view()[0] == pytest.approx(before + 0.2 * 65535 / 16)
        seen.press(*"++++++++")
        assert plot.view()[2] == pytest.approx(65535 / 100)  # beyond, steps would be seen
        seen.press("-")
        assert plot.view()[2] == pytest.approx(65535 / 50)
        seen.press("ArrowDown", "ArrowLeft", "ArrowLeft")  # another curve: the view goes with it
        x, y, width, height = plot.view()
        _, across, up = plot.reads()
        here = seen.page.evaluate("(a) => [a.dataset.x0, a.dataset.x1, a.dataset.y0, a.dataset.y1]",
                                  plot.figure.locator("svg.area").element_handle())  # fmt: skip
        x0, x1, y0, y1 = map(float, here)
        assert x - 50 <= (across - x0) / (x1 - x0) * 65535 <= x + width + 50
        assert y - 50 <= (y1 - up) / (y1 - y0) * 65535 <= y + height + 50
        seen.press("0")
        assert plot.view() == WHOLE
        assert note.is_hidden()


def test_curves_on_and_off(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        figure = drawn(seen).figure
        own = figure.locator("svg.area path.curve[data-t='1']")
        button = figure.locator(".legend li[data-t='1'] button")
        assert own.is_visible()
        button.click()
        assert own.is_hidden()
        assert button.get_attribute("aria-pressed") == "false"
        button.press("Enter")
        assert own.is_visible()
        button.click(modifiers=["Shift"])  # that curve alone
        assert figure.locator("svg.area path.curve:visible").count() == 1
        figure.get_by_role("button", name="all", exact=True).last.click()
        assert figure.locator("svg.area path.curve:visible").count() == 5  # one test has none


def test_a_legend_is_one_stop_of_the_keyboard(browser: Browser, six: Path) -> None:
    with shown(browser, six) as seen:
        buttons = drawn(seen).figure.locator(".legend button")
        buttons.first.focus()
        seen.press("ArrowRight", "ArrowRight", "ArrowLeft")
        assert seen.focused() == buttons.nth(1).text_content()
        seen.press("Tab")
        assert not buttons.evaluate_all("(all) => all.includes(document.activeElement)")
