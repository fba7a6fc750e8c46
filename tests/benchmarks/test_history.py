"""A history of 100 000 inspections: how long filters and series take, and how much a row weighs.

The alternative of a series is to read whole rows.
"""

import threading
import time
from datetime import UTC, datetime, timedelta
from hashlib import sha256

import httpx
import numpy as np
import pytest
from sqlalchemy import func, select, text

from anisoscope.console.access import Access
from anisoscope.console.application import create_app, hosts_of, listen, server_of
from anisoscope.console.fleet import fleet_router
from anisoscope.console.trail import Trail
from anisoscope.history import schema
from anisoscope.history.filters import Filters
from anisoscope.history.rows import NewRow
from anisoscope.history.store import open_history

pytestmark = pytest.mark.benchmark
COUNT = 100_000
AT_ONCE = 5000
START = datetime(2024, 1, 1, tzinfo=UTC)
VERDICTS = ("PASS",) * 47 + ("FAIL", "INCONCLUSIVE", "INVALID")
PRODUCT = "ridged demo plate, pitch 100 µm, ridge angle 10°"
REASONS = (
    "ln ratio 0° / 90°, tilt 0° deviates by -0.023 (tolerance ±0.25, guard band 0.084)",
    "ln ratio 90° / 180°, tilt 0° deviates by -0.018 (tolerance ±0.25, guard band 0.036)",
    "0.1% of the area deviates in the contrast map (limit 3.0%)",
)


def new_row(number, draws):
    contrasts = {}
    for pair, value in (("0-90", 2.1), ("90-180", 0.1)):
        off = float(draws[number % len(draws)])
        contrasts |= {
            f"ln {pair}": value + off,
            f"u ln {pair}": 0.05,
            f"deviation ln {pair}": off,
            f"tolerance ln {pair}": 0.25,
        }
    return NewRow(
        created_at=START + timedelta(minutes=10 * number),
        serial=f"PART-{number:06d}",
        product=PRODUCT,
        recipe=f"{PRODUCT} {number % 3}123456789ab",
        lot=f"LOT-{number // 500}",
        cavity=str(number % 8),
        station=f"line {number % 4}",
        operator=("M. Meier", "A. Schulz")[number % 2],
        verdict=VERDICTS[number % 50],
        reasons=REASONS,
        folder=f"/data/inspections/PART-{number:06d}-20240101T000000Z",
        seal=sha256(str(number).encode()).hexdigest(),
        software="anisoscope 0.1.0",
        numbers=contrasts | {"d2": 1.2, "p": 0.55, "area share": 0.001, "conformance probability": 0.99},
    )


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("history") / "history.sqlite"


@pytest.fixture(scope="module")
def history(place):
    draws = np.random.default_rng(1).normal(0.0, 0.03, 997)
    begun = time.perf_counter()
    with open_history(place) as found:
        for start in range(0, COUNT, AT_ONCE):
            found.append_all([new_row(number, draws) for number in range(start, start + AT_ONCE)])
        print(f"\n{COUNT} inspections added in {time.perf_counter() - begun:.1f} s")
        yield found


QUESTIONS = {
    "the latest 50": Filters(limit=50),
    "one part": Filters(serial="PART-012345", limit=50),
    "one lot": Filters(lot="LOT-77", limit=1000),
    "a week": Filters(since=START + timedelta(days=300), until=START + timedelta(days=307), limit=2000),
    "the latest failures": Filters(verdict="FAIL", limit=50),
    "failures of one cavity": Filters(verdict="FAIL", cavity="1", limit=50),
    "one recipe, one station": Filters(recipe="1123", station="line 3", limit=50),
    "a station that is none": Filters(station="none", limit=50),
    "a product that is none": Filters(product="none", limit=50),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_filters(bench, history, question):
    found = bench.compare(
        f"{COUNT} inspections, {question}", {"rows": lambda: history.rows(QUESTIONS[question])}
    )
    bench.note(f"{len(found['rows'].result)} rows")
    assert min(found["rows"].wall_s) <= 0.3


def test_a_series_of_everything_against_its_rows(bench, history):
    found = bench.compare(
        f"a number of {COUNT} inspections",
        {
            "series": lambda: history.series(Filters(), "ln 0-90"),
            "from whole rows": lambda: [row.numbers["ln 0-90"] for row in history.rows()],
        },
        rounds=2,
    )
    assert len(found["series"].result) == COUNT
    assert found.ratio("from whole rows", "series") >= 1.0


FLEET = {
    "everything": "/fleet",
    "a week": "/fleet?since=2024-10-27&until=2024-11-02",
    "a product": f"/fleet?product={PRODUCT}",
    "a station": "/fleet?station=line 3",
    "a lot": "/fleet?lot=LOT-77",
    "a cavity": "/fleet?cavity=1",
    "a verdict": "/fleet?verdict=FAIL",
    "a cause": "/fleet?cause=ln ratio …° / …°, tilt …° deviates by …",
    "a part": "/fleet?serial=PART-012345",
    "the last page": f"/fleet?page={COUNT // 50}",
    "control charts by cavity": "/fleet/charts?by=cavity",
}


@pytest.fixture(scope="module")
def fleet(history, place):
    """A client of the fleet page of the history, which has been loaded once."""
    with listen("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        app = create_app(Access(None, Trail(None)), [fleet_router(place)], hosts_of("127.0.0.1", port))
        server = server_of(app)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0) as client:
            begun = time.perf_counter()
            client.get("/fleet")
            print(f"\nfirst page of {COUNT} inspections: {time.perf_counter() - begun:.1f} s")
            yield client
        server.should_exit = True
        thread.join()


@pytest.mark.parametrize("question", FLEET)
def test_the_fleet_page(bench, fleet, history, question):
    table = schema.inspections.c
    grouped = select(table.station, table.verdict, func.count()).group_by(table.station, table.verdict)

    def in_the_database():
        with history.reading() as connection:
            return connection.execute(grouped).all()

    found = bench.compare(
        f"{COUNT} inspections, fleet page: {question}",
        {"page": lambda: fleet.get(FLEET[question]), "one grouping of all rows": in_the_database},
    )
    assert found["page"].result.status_code == 200
    assert min(found["page"].wall_s) <= 0.3


def test_growth_is_linear_and_a_row_weighs_about_a_kilobyte(bench, history, place, tmp_path):
    draws = np.zeros(1)
    with open_history(tmp_path / "small.sqlite") as small:
        small.append_all([new_row(number, draws) for number in range(COUNT // 10)])
    weights = []
    for path, count in ((tmp_path / "small.sqlite", COUNT // 10), (place, COUNT)):
        with open_history(path) as found, found._database.engine.connect() as connection:
            connection.exec_driver_sql("COMMIT")
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        weights.append(path.stat().st_size / count)
    bench.note(f"bytes a row, indexes included: {weights[0]:.0f} of 10 000, {weights[1]:.0f} of 100 000")
    assert max(weights) <= 1250
    assert weights[1] <= 1.05 * weights[0]


def test_verifying(bench, history):
    bench.compare(f"every hash of {COUNT} again", {"verify": history.verify_chain}, rounds=1, warm=False)
    assert history.count() == COUNT


@pytest.fixture
def server(postgresql_programs, postgresql_server):
    """The URL of a database of our own on a server of PostgreSQL."""
    with postgresql_programs.database(postgresql_server) as url:
        yield url


def test_postgresql(bench, server):
    draws = np.random.default_rng(1).normal(0.0, 0.03, 997)
    with open_history(server) as found:
        begun = time.perf_counter()
        for start in range(0, COUNT, AT_ONCE):
            found.append_all([new_row(number, draws) for number in range(start, start + AT_ONCE)])
        added = time.perf_counter() - begun
        works = {
            question: (lambda filters=filters: found.rows(filters)) for question, filters in QUESTIONS.items()
        }
        took = bench.compare(f"PostgreSQL, {COUNT} inspections", works, rounds=3)
        series = bench.compare(
            f"PostgreSQL, a number of {COUNT} inspections",
            {
                "series": lambda: found.series(Filters(), "ln 0-90"),
                "from whole rows": lambda: [row.numbers["ln 0-90"] for row in found.rows()],
            },
            rounds=2,
        )
        with found._database.reading() as connection:
            size = connection.scalar(text("SELECT pg_total_relation_size('inspections')"))
        bench.note(f"PostgreSQL, {COUNT} inspections added in {added:.1f} s")
        bench.note(f"PostgreSQL, bytes a row, indexes included: {size / COUNT:.0f}")
    assert max(min(one.wall_s) for one in took.timings.values()) <= 0.3
    assert series.wall_ratio("from whole rows", "series") >= 1.0
    assert size / COUNT <= 1250
