"""The page in a browser: it opens without an error and without a request, and what can be moved moves."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.demo import sample
from posecal.report.html import write_html
from tests.helpers.browser import CHROMIUM, DRIVER, browser, show
from tests.helpers.reports import report_of, unlabelled, world

pytest.importorskip("selenium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="needs chromium and chromedriver"),
]

ODD = "<script>document.title = 'taken'</script>&amp;\"'</script><!--"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_html(report_of(metrics="all", by=("action", "occlusion")), path, "hyps.npz")
    return path


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    with browser(1280, 900) as found:
        yield found


@pytest.fixture
def opened(driver: Any, page: Path) -> Any:
    show(driver, page)
    return driver


def run(driver: Any, script: str, *arguments: object) -> Any:
    return driver.execute_script(script, *arguments)


def pixels(driver: Any) -> str:
    drawn: str = run(driver, "return document.getElementById('pose-canvas').toDataURL()")
    return drawn


def column(driver: Any, section: str, number: int) -> list[str]:
    rows = f"document.querySelectorAll('#{section} tbody tr')"
    found: list[str] = run(driver, f"return [...{rows}].map((row) => row.cells[{number}].textContent)")
    return found


def change(driver: Any, name: str, value: object, kind: str = "change") -> None:
    script = "const e = document.getElementById(arguments[0]); e.value = arguments[1];"
    run(driver, f"{script} e.dispatchEvent(new Event('{kind}'))", name, value)


def requests(driver: Any) -> list[str]:
    messages = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    sent = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    return [url for url in sent if not url.startswith(("data:", "file:"))]


@pytest.mark.parametrize(("width", "height", "dark"), [(500, 900, False), (1280, 900, True), (3840, 2160, False)])
def test_it_opens_without_an_error_or_a_request_and_fits(page: Path, width: int, height: int, dark: bool) -> None:
    with browser(width, height, dark=dark) as driver:
        show(driver, page)
        assert run(driver, "return document.documentElement.scrollWidth") <= width
        assert len(pixels(driver)) > 5000  # an empty canvas is smaller
        background = run(driver, "return getComputedStyle(document.body).backgroundColor")
        assert (background == "rgb(255, 255, 255)") is not dark
        assert driver.get_log("browser") == []
        assert requests(driver) == []


def test_a_column_sorts_by_its_numbers_both_ways(opened: Any) -> None:
    button = "document.querySelectorAll('#joints th button')[3]"
    assert run(opened, f"return {button}.textContent") == "ECE"
    before = column(opened, "joints", 3)
    run(opened, f"{button}.click()")
    known = [float(text) for text in column(opened, "joints", 3) if text != "–"]
    assert known == sorted(known)
    assert column(opened, "joints", 3) != before
    run(opened, f"{button}.click()")
    assert [float(text) for text in column(opened, "joints", 3) if text != "–"] == known[::-1]
    assert column(opened, "joints", 3)[-1] == "–"  # what is not known stays last
    assert run(opened, f"return {button}.parentElement.getAttribute('aria-sort')") == "descending"


def test_the_slider_shows_another_pose_with_its_numbers(opened: Any) -> None:
    gallery = report_of(metrics="all", by=("action", "occlusion")).totals.gallery
    assert gallery is not None
    drawn, number = pixels(opened), run(opened, "return document.getElementById('pose-frame').max")
    assert int(number) == len(gallery.orders[0]) - 1
    change(opened, "pose-frame", 1, "input")
    assert pixels(opened) != drawn
    said = run(opened, "return document.getElementById('pose-numbers').textContent")
    second = gallery.orders[0][1]
    assert str(gallery.sequence[second]) in said
    assert f"{gallery.numbers[second, 2]:.1f} mm" in said


def test_the_orders_begin_with_the_worst_by_each(opened: Any) -> None:
    gallery = report_of(metrics="all", by=("action", "occlusion")).totals.gallery
    assert gallery is not None
    for name, rows in zip(("calibration", "error"), gallery.orders, strict=True):
        change(opened, "pose-order", name)
        said = run(opened, "return document.getElementById('pose-numbers').textContent")
        assert f"{gallery.numbers[rows[0], 2]:.1f} mm" in said


@pytest.mark.parametrize("key", ["ArrowLeft", "ArrowUp", "+"])
def test_keys_turn_and_zoom(opened: Any, key: str) -> None:
    before = pixels(opened)
    event = "new KeyboardEvent('keydown', {key: arguments[0]})"
    run(opened, f"document.getElementById('pose-canvas').dispatchEvent({event})", key)
    assert pixels(opened) != before
    run(opened, "document.getElementById('pose-reset').click()")
    assert pixels(opened) == before


def test_dragging_turns(opened: Any) -> None:
    from selenium.webdriver import ActionChains

    before, canvas = pixels(opened), opened.find_element("id", "pose-canvas")
    run(opened, "document.getElementById('pose-canvas').scrollIntoView({block: 'center'})")
    ActionChains(opened).click_and_hold(canvas).move_by_offset(60, 10).release().perform()
    assert pixels(opened) != before


@pytest.mark.parametrize("name", ["pose-balls", "pose-hypotheses"])
def test_parts_can_be_left_out(opened: Any, name: str) -> None:
    before = pixels(opened)
    run(opened, f"document.getElementById('{name}').click()")
    assert pixels(opened) != before


def test_another_joint_has_its_own_cloud_and_numbers(opened: Any) -> None:
    before = pixels(opened)
    change(opened, "pose-joint", 3)
    assert pixels(opened) != before
    assert "RFoot: truth" in run(opened, "return document.getElementById('pose-numbers').textContent")


def test_a_curve_names_its_joint_and_count(opened: Any) -> None:
    from selenium.webdriver import ActionChains

    svg = opened.find_element("css selector", ".diagram svg")
    run(opened, "document.querySelector('.diagram').scrollIntoView({block: 'center'})")
    ActionChains(opened).move_to_element_with_offset(svg, 40, -30).perform()
    caption = run(opened, "return document.querySelector('.diagram figcaption').textContent")
    name = caption.partition(":")[0]
    assert name in world_joints()
    assert "36 poses, signed area" in caption
    assert run(opened, "return document.getElementById('diagram-joint').value") == name


def test_the_diagram_of_a_group_can_be_chosen(opened: Any) -> None:
    run(opened, "document.getElementById('diagram-group').selectedIndex = 2")
    run(opened, "document.getElementById('diagram-group').dispatchEvent(new Event('change'))")
    shown = "[...document.querySelectorAll('.diagram')].map((figure) => figure.hidden)"
    hidden = run(opened, f"return {shown}")
    assert [number for number, flag in enumerate(hidden) if not flag] == [2]


def test_a_sequence_leads_to_its_pose(opened: Any) -> None:
    run(opened, "document.querySelector('#sequences td button').click()")
    name = run(opened, "return document.querySelector('#sequences td button').textContent")
    assert f"Sequence{name}" in run(opened, "return document.getElementById('pose-numbers').textContent")


def test_labels_of_files_are_text_and_nothing_more(driver: Any, tmp_path: Path) -> None:
    here = world()
    report = posecal.evaluate(
        sample(here, 4),
        here.truth,
        joints=[f"joint {ODD}", *(f"j{number}" for number in range(16))],
        root_joint="none",
        labels={"sequence": np.char.add(here.sequence, ODD), "action": np.char.add(here.action, ODD)},
        frame_id=[f"{number}{ODD}" for number in range(36)],
        by=["action"],
        axes="NMKD",
        unit="mm",
    )
    write_html(report, tmp_path / "page.html", f"hyps{ODD}")
    show(driver, tmp_path / "page.html")
    assert driver.title == f"hyps{ODD} · posecal"
    change(driver, "pose-joint", 0)
    said = run(driver, "return document.getElementById('pose-numbers').textContent")
    assert f"joint {ODD}: truth" in said
    assert said.count(ODD) == 4  # sequence, frame, and the joint twice
    assert driver.get_log("browser") == []


def test_a_page_without_poses_curves_or_sequences_opens_without_an_error(driver: Any, tmp_path: Path) -> None:
    write_html(unlabelled(n=1), tmp_path / "page.html", "hyps.npz", gallery=False)
    show(driver, tmp_path / "page.html")
    assert driver.get_log("browser") == []
    assert run(driver, "return document.getElementById('pose-canvas')") is None


def world_joints() -> tuple[str, ...]:
    return posecal.JOINT_SETS["h36m-17"]
