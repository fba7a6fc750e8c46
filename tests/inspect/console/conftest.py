"""A console with a virtual rig, served to a client in the process or to a browser."""

import contextlib
import shutil
import threading
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

from anisoscope.console.access import Access
from anisoscope.console.application import Page, create_app, hosts_of, listen, server_of
from anisoscope.console.fleet import fleet_router
from anisoscope.console.live import Eyes
from anisoscope.console.routes import station_router
from anisoscope.console.station import Station
from anisoscope.console.trail import Trail
from anisoscope.inspection.work import WorkerHere, Workplace
from anisoscope.operations.findings import explained
from anisoscope.operations.remembering import lot_mates, remember
from anisoscope.rig.acquisition.opening import open_devices
from anisoscope.rig.hold import SharedCamera
from anisoscope.rig.rigfile import read_rig


@pytest.fixture(scope="session")
def served():
    """``served(app_of)``: serves ``app_of(hosts)`` at a free port of this computer for a while; gives the address."""

    @contextmanager
    def serve(app_of, tls=None):
        with listen("127.0.0.1", 0) as listener:
            port = listener.getsockname()[1]
            server = server_of(app_of(hosts_of("127.0.0.1", port)), tls)
            thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
            thread.start()
            try:
                yield f"http{'s' * (tls is not None)}://127.0.0.1:{port}"
            finally:
                server.should_exit = True
                thread.join()

    return serve


@pytest.fixture
def opened_page(chromium):
    """``opened_page(address, but=())``: a page of the console that asks nothing elsewhere and complains of nothing."""

    @contextmanager
    def opened(address, but=()):
        asked, said = [], []
        found = chromium.new_page(viewport={"width": 1024, "height": 768})
        found.set_default_timeout(60_000)
        found.on("request", lambda one: asked.append(one.url))
        found.on("console", lambda one: said.append(one.text))
        found.on("pageerror", lambda one: said.append(str(one)))
        found.goto(address)
        yield found
        found.close()
        assert [text for text in said if not any(one in text for one in but)] == []
        assert {url.startswith((address, f"blob:{address}", "data:")) for url in asked} == {True}

    return opened


@pytest.fixture(scope="session")
def tls(tmp_path_factory):
    """A certificate of this computer that it has signed itself, and its key."""
    folder, key = tmp_path_factory.mktemp("tls"), ec.generate_private_key(ec.SECP256R1())
    name, now = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "station")]), datetime.now(UTC)
    made = (
        x509.CertificateBuilder(
            name, name, key.public_key(), x509.random_serial_number(), now, now + timedelta(1)
        )
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, SHA256())
    )
    folder.joinpath("cert.pem").write_bytes(made.public_bytes(Encoding.PEM))
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    folder.joinpath("key.pem").write_bytes(key.private_bytes(*form))
    return folder / "cert.pem", folder / "key.pem"


@pytest.fixture(scope="session")
def small_app(tmp_path_factory):
    """``small_app(hosts)``: a console without a rig."""
    return lambda hosts: create_app(
        Access(None, Trail(None)),
        [fleet_router(tmp_path_factory.mktemp("fleet") / "history.sqlite")],
        hosts,
        pages=[Page("/fleet", "Fleet")],
    )


@pytest.fixture(scope="module")
def chromium(chromium_program):
    """Debian's Chromium, driven by Playwright, whose loop would be in the way of tests that run one."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium_program, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def station_at(virtual_rigs, plain):
    """``station_at(name, **changes)``: a station at a virtual rig, in this process, and what was asked to stop."""
    with contextlib.ExitStack() as stack:

        def make(name="part", **changes):
            rig = virtual_rigs(name, **changes)
            recipes = rig.recipe.parent / "recipes"
            recipes.mkdir(exist_ok=True)
            shutil.copy(rig.recipe, recipes / "plate.toml")
            file = read_rig(rig.rig)
            devices = stack.enter_context(open_devices({}, file.camera, file.light))
            eyes = Eyes(SharedCamera(devices.camera), devices.light)
            history = rig.out / "history.sqlite"
            place = Workplace(rig.rig, rig.out, history, remember, lot_mates, explained, plain)
            stops = []
            station = Station(
                place,
                recipes,
                WorkerHere(place),
                lambda: stops.append(1) or {},
                eyes,
                Trail(rig.rig.with_name("trail")),
                "S1",
                patience_s=1.0,
            )
            stack.callback(station.end)
            return station, stops

        yield make


@pytest.fixture(scope="session")
def app_of():
    """``app_of(station, access)``: what serves the application of a station, for hosts."""

    def make(station, access=None):
        who = access or Access(None, Trail(None))
        routers = [station_router(station), fleet_router(station.place.history)]
        pages = [Page("/station", "Station"), Page("/fleet", "Fleet")]
        return lambda hosts: create_app(who, routers, hosts, pages=pages)

    return make
