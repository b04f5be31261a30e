"""The page in a real browser, at the width of a desk and of a phone: what a person sees and presses."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from protocols import OperatorAnswered, RunEnded
from tests.orchestrator.shelf.example_runs import a_run
from tests.pictures.report import browser
from tests.plugins.commands.serve.served import serving
from tests.plugins.commands.serve.test_floods import LONG
from tests.plugins.commands.serve.test_serving import ASKING, ended_safely, until_energised
from tests.support.chromium import Chromium, Tab, with_chromium
from tests.support.processes import wait_until
from tests.support.tiny import messages_of, tiny_document

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser() is None, reason="needs Chromium"),
]


@pytest.fixture
def chromium() -> Iterator[Chromium]:
    with with_chromium() as chromium:
        yield chromium
        assert chromium.complaints == []


def press(tab: Tab, name: str) -> None:
    """A button that can be seen, and that nothing lies over."""
    covered = (
        f"(() => {{ const b = document.getElementById('{name}'); b.scrollIntoView({{block: 'center'}});"
        " const r = b.getBoundingClientRect();"
        " const top = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2);"
        " if (top !== b || b.disabled) return 'covered'; b.click(); return 'pressed'; })()"
    )
    assert tab.value(covered) == "pressed", name


def is_seen(name: str) -> str:
    return f"document.getElementById('{name}').checkVisibility()"


def fits_its_width(tab: Tab) -> bool:
    return bool(tab.value("document.documentElement.scrollWidth <= document.documentElement.clientWidth"))


def test_a_person_starts_answers_on_the_phone_watches_and_stops(tmp_path: Path, chromium: Chromium) -> None:
    document = tiny_document(stages=ASKING, drive={"realtime_factor": 1.0, "watchdog_s": 60.0})
    (tmp_path / "asking.yaml").write_text(yaml.safe_dump(document))
    with serving(tmp_path) as served:
        desk, phone = chromium.open(served.address), chromium.open(served.address)
        desk.resize(1200, 900)
        phone.resize(360, 740, phone=True)
        desk.until("document.querySelectorAll('[name=procedure] option').length > 1")
        assert served.token not in desk.value("location.href")
        assert served.token not in desk.value("document.cookie + document.documentElement.outerHTML")
        assert fits_its_width(phone)

        desk.value("document.querySelector('[name=serial]').value = 'SN-7'")
        press(desk, "check")
        desk.until("document.querySelector('#plan table') !== null")
        press(desk, "start")
        desk.until("document.getElementById('title').textContent === 'Starting'")
        subject, progress = (
            desk.value(f"document.getElementById('{name}').textContent") for name in ("subject", "progress")
        )
        assert (subject, progress) == ("asking.yaml · the procedure's motor", "importing, planning")
        assert desk.value(is_seen("progress"))
        phone.until(is_seen("question"))
        assert phone.value("document.getElementById('prompt').textContent") == "Is the brake engaged?"
        assert fits_its_width(phone)
        press(phone, "yes")

        desk.until("document.getElementById('state').textContent.includes('energised')")
        desk.until("document.querySelectorAll('#plane .dot').length > 2 && document.querySelector('#wave .d') !== null")
        assert fits_its_width(phone)
        assert not desk.value(is_seen("question"))
        press(phone, "stop")
        desk.until(
            "document.getElementById('stopbar').hidden && document.getElementById('state').textContent === 'aborted'"
        )
        desk.until(is_seen("report"))
        assert "stopped by a person at the page" in desk.value("document.getElementById('outcome').textContent")

        run = tmp_path / "runs" / desk.value("document.querySelector('#rows td div').textContent")
        messages = messages_of(run)
        assert isinstance(messages[-1], RunEnded)
        assert [m.through for m in messages if isinstance(m, OperatorAnswered)] == ["page"]
        desk.call("Page.navigate", url=f"{served.origin}/report/{run.name}")
        desk.until("document.title.length > 0 && document.body.textContent.includes('SN-7')")


def test_a_page_of_another_origin_can_neither_read_nor_start(tmp_path: Path, chromium: Chromium) -> None:
    with serving(tmp_path) as served:
        own = chromium.open(served.address)
        own.until("document.querySelectorAll('[name=procedure] option').length > 1")
        foreign = chromium.open("data:text/html,<title>elsewhere</title>")
        foreign.until("document.title === 'elsewhere'")
        for method in ("GET", "POST"):
            address = f"{served.origin}/{'choices' if method == 'GET' else 'start'}"
            script = f"fetch('{address}', {{method: '{method}', credentials: 'include'}})"
            assert foreign.value(f"{script}.then(() => 'read', () => 'refused')") == "refused"
        assert own.value("fetch('/choices').then((answer) => answer.status)") == 200
        chromium.complaints.clear()  # of the foreign page's


def test_the_page_says_when_its_server_is_gone(tmp_path: Path, chromium: Chromium) -> None:
    with serving(tmp_path) as served:
        tab = chromium.open(served.address)
        tab.until("document.getElementById('state')?.textContent === 'no run is active'")
        served.process.kill()
        tab.until(is_seen("gone"))
        assert "disarmed" in tab.value("document.getElementById('gone').textContent")
        chromium.complaints.clear()  # it looks for the server again and again


def test_a_page_without_events_says_how_old_it_is(tmp_path: Path, chromium: Chromium) -> None:
    with serving(tmp_path) as served:
        tab = chromium.open(served.address)
        tab.until("document.getElementById('state')?.textContent === 'no run is active'")
        assert not tab.value(is_seen("age"))
        served.process.send_signal(signal.SIGSTOP)
        try:
            tab.until(is_seen("age"), 10.0)
            assert tab.value("document.getElementById('age').textContent").startswith("No event for ")
        finally:
            served.process.send_signal(signal.SIGCONT)
        tab.until("document.getElementById('age').hidden", 10.0)


def test_a_stop_arrives_although_streams_hold_all_connections_of_the_browser(
    tmp_path: Path, chromium: Chromium
) -> None:
    document = tiny_document(stages=LONG, drive={"realtime_factor": 1.0, "watchdog_s": 60.0})
    (tmp_path / "asking.yaml").write_text(yaml.safe_dump(document))
    with serving(tmp_path) as served:
        run = until_energised(served)
        first = chromium.open(served.address)
        first.until(f"document.getElementById('stop') !== null && {is_seen('stop')}")
        for _ in range(5):  # each is seen and holds a stream: six, as many as a browser opens to a server
            chromium.open(served.address)
        press(first, "stop")
        wait_until(lambda: isinstance(messages_of(run)[-1], RunEnded), 15.0)
        assert ended_safely(run).reason == "stopped by a person at the page"
        chromium.complaints.clear()  # of tabs that were closed while they loaded


def test_runs_are_found_compared_followed_and_labelled_on_their_page(tmp_path: Path, chromium: Chromium) -> None:
    for k in range(3):
        a_run(tmp_path / "runs" / f"line-{k}", r_s=4.2 + 0.1 * k, about={"serial": "PM-7", "notes": ["<b>a; b</b>"]})
    rows = "[...document.querySelectorAll('#rows tr')]"
    with serving(tmp_path) as served:
        desk, phone = chromium.open(served.address), chromium.open(served.address)
        phone.resize(360, 740, phone=True)
        for tab in (desk, phone):
            tab.until("document.querySelector('a[href=\"/shelf\"]') !== null")
            tab.call("Page.navigate", url=f"{served.origin}/shelf")
            tab.until(f"{rows}.length === 3")
        assert fits_its_width(phone)
        assert desk.value("document.querySelector('#rows b') === null")

        desk.value("[...document.querySelectorAll('.heading')].find((one) => one.textContent === 'R_s').click()")
        desk.until(f"{rows}[0].textContent.includes('line-0')")
        desk.value("document.querySelector('[name=words]').value = 'LINE-2'")
        desk.value("document.querySelector('[name=words]').dispatchEvent(new Event('input'))")
        desk.until(f"{rows}.length === 1")
        desk.value("document.querySelector('[name=words]').value = ''; search.requestSubmit()")
        desk.until(f"{rows}.length === 3")

        desk.value("[...document.querySelectorAll('#rows input')].slice(0, 2).forEach((box) => box.click())")
        press(desk, "compare")
        desk.until(is_seen("comparison"))
        assert "changed beyond noise: R_s" in desk.value("document.getElementById('remarks').textContent")
        assert desk.value("document.querySelectorAll('#curve_d path.series').length") == 2
        press(desk, "closecomparison")

        desk.value(f"[...{rows}[0].querySelectorAll('button')].find((one) => one.textContent === 'Trend').click()")
        desk.until(is_seen("trend"))
        assert desk.value("document.querySelectorAll('#trend_r circle').length") == 3

        desk.value(f"[...{rows}[0].querySelectorAll('button')].find((one) => one.textContent === 'Notes').click()")
        desk.until(is_seen("labels"))
        assert desk.value("labels.notes.value") == "<b>a; b</b>"
        desk.value("labels.tags.value = 'returned, cold'; labels.requestSubmit()")
        desk.until(f"{rows}[0].textContent.includes('returned, cold')")
        assert fits_its_width(desk)
