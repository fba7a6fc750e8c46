"""A console with a virtual rig, served to a client in the process or to a browser."""

import shutil
import threading
from contextlib import contextmanager

import pytest

from anisoscope.console.access import Access, Trail
from anisoscope.console.application import Page, create_app, hosts_of, listen, server_of
from anisoscope.console.fleet import fleet_router


@pytest.fixture(scope="session")
def served():
    """``served(app_of)``: serves ``app_of(hosts)`` at a free port of this computer for a while; gives the address."""

    @contextmanager
    def serve(app_of):
        with listen("127.0.0.1", 0) as listener:
            port = listener.getsockname()[1]
            server = server_of(app_of(hosts_of("127.0.0.1", port)))
            thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
            thread.start()
            try:
                yield f"http://127.0.0.1:{port}"
            finally:
                server.should_exit = True
                thread.join()

    return serve


@pytest.fixture(scope="session")
def small_app(tmp_path_factory):
    """``small_app(hosts)``: a console without a rig."""
    return lambda hosts: create_app(
        Access(None, Trail(None)),
        [fleet_router(tmp_path_factory.mktemp("fleet") / "history.sqlite")],
        hosts,
        pages=[Page("/fleet", "Fleet")],
    )


@pytest.fixture(scope="session")
def chromium():
    """Debian's chromium, driven by Playwright; one for the session."""
    playwright = pytest.importorskip("playwright.sync_api")
    executable = shutil.which("chromium")
    if executable is None:
        pytest.skip("no chromium found (apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield browser
        browser.close()
