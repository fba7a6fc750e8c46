"""The console in a real browser."""

import pytest

pytestmark = pytest.mark.browser


def test_a_page_loads_only_from_here_and_complains_of_nothing(served, small_app, chromium):
    asked, said = [], []
    with served(small_app) as address:
        page = chromium.new_page()
        page.on("request", lambda one: asked.append(one.url))
        page.on("console", lambda one: said.append(one.text))
        page.on("pageerror", lambda one: said.append(str(one)))
        page.goto(address)
        page.get_by_role("link", name="Fleet").click()
        assert "0 inspections" in page.inner_text("main")
        page.close()
    assert said == []
    assert {url.startswith(address) for url in asked} == {True}
