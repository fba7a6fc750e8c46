"""What could not be run is said at the end; with ANISOSCOPE_REQUIRE_ALL=1 it fails."""

import contextlib
import gc
import importlib.util
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path

import pytest

REQUIRE_ALL = os.environ.get("ANISOSCOPE_REQUIRE_ALL") == "1"
SIDE_BY_SIDE = "PYTEST_XDIST_WORKER" in os.environ
# there are as many workers as cores: threads that wait for each other's shares would only take time from them
if SIDE_BY_SIDE:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        os.environ.setdefault(name, "1")


def beside(name):
    """A module in this folder, which is no package."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# Fixtures that take a minute to make and serve many tests, and that of the tests which interrupt real commands on a
# terminal and mostly wait. Each begins the share of another worker, with the tests that need it behind it: none waits
# for it while another one makes it, and no minute of waiting is left for the end of the run.
LONG = ("studied", "demo", "start")

CACHE = "ANISOSCOPE_CACHE"
RUN = "ANISOSCOPE_TEST_RUN"
OWN_CACHE = pytest.StashKey[str]()
OWN_RUN = pytest.StashKey[Path]()


def pytest_configure(config):
    """All workers of one run share what is computed once, and no run finds what another one left."""
    # a shell ignores Ctrl-C for what runs in the background, and all that the tests start and interrupt would, too
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ["LC_ALL"] = "C.UTF-8"  # messages are in English whatever the locale of the machine
    os.environ.setdefault("ANISOSCOPE_QUIET", "1")  # progress comes by the clock, and a machine may be slow
    gc.disable()  # until all tests are collected: what they import stays, and is looked through again and again
    if hasattr(config, "workerinput"):
        return
    config.stash[OWN_RUN] = Path(tempfile.mkdtemp(prefix="anisoscope-run-"))
    os.environ[RUN] = str(config.stash[OWN_RUN])
    trust_one_authority(config.stash[OWN_RUN])
    if CACHE not in os.environ:
        folder = tempfile.mkdtemp(prefix="anisoscope-cache-")
        take_over_sources(folder)
        config.stash[OWN_CACHE] = os.environ[CACHE] = folder


def take_over_sources(folder):
    """Copy what `anisoscope warm` found in the source files: parsing them takes every process seconds.

    An entry counts only for a file of the same size and times.
    """
    from anisoscope.base.cache import cache_folder

    with contextlib.suppress(OSError):
        shutil.copy(cache_folder() / "sources.json", folder)


def trust_one_authority(folder):
    """Nothing outside is asked; and each client of a server, with TLS or without, reads all authorities: 15 ms."""
    try:
        import certifi
    except ImportError:  # the fast tests run without clients of servers
        return
    file, end = folder / "authority.pem", "-----END CERTIFICATE-----"
    file.write_text(
        Path(certifi.where()).read_text(encoding="utf-8").partition(end)[0] + end + "\n", encoding="utf-8"
    )
    os.environ["SSL_CERT_FILE"] = str(file)
    os.environ["SSL_CERT_DIR"] = str(folder)


def pytest_unconfigure(config):
    if OWN_RUN in config.stash:
        beside("postgresql").stop_server_of(config.stash[OWN_RUN])
        for name in (RUN, "SSL_CERT_FILE", "SSL_CERT_DIR"):
            os.environ.pop(name, None)
        shutil.rmtree(config.stash[OWN_RUN], ignore_errors=True)
    if OWN_CACHE in config.stash:
        os.environ.pop(CACHE, None)
        shutil.rmtree(config.stash[OWN_CACHE], ignore_errors=True)


def pytest_ignore_collect(collection_path, config):
    """Benchmarks import what they compare with, seconds in every worker: they are collected for `-m benchmark` only."""
    return (
        True if collection_path.name == "benchmarks" and "not benchmark" in config.option.markexpr else None
    )


def pytest_itemcollected(item):
    """Tests that give a figure of the evidence are chosen by `-m figures`."""
    if "judged_figure" in item.fixturenames:
        item.add_marker("figures")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Put the tests with the longest preparations first in the shares that `--dist worksteal` deals out."""
    if not hasattr(config, "workerinput"):
        return
    workers = config.workerinput["workercount"]
    groups = [[item for item in items if name in item.fixturenames] for name in LONG]
    chosen = {id(item) for group in groups for item in group}
    others = [item for item in items if id(item) not in chosen]
    groups += [[]] * max(workers - len(groups), 0)
    dealt, left = [], len(items)
    for number, group in enumerate(groups):
        share = left // (workers - number) if number < workers else 0
        rest = max(share - len(group), 0)
        dealt += [*group, *others[:rest]]
        del others[:rest]
        left -= share
    items[:] = dealt + others


def pytest_collection_finish(session):
    """What the collected tests imported is set up for workers side by side."""
    gc.enable()
    gc.freeze()  # thousands of tests and all that they imported stay: looking through them takes a twentieth of the run
    from anisoscope.__main__ import COLLECTED_AFTER

    gc.set_threshold(
        COLLECTED_AFTER, 10, 10
    )  # as in commands; at Python's 700 it takes a twentieth of the run
    if SIDE_BY_SIDE and "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # tests of threads take more
        beside("sidebyside").share()


@pytest.fixture
def judged_figure():
    """``judged_figure(part, what, judge, found, goal)``: a row of docs/evidence/reflectance.md (`figures.figure`)."""
    return beside("figures").figure


@pytest.fixture(scope="session")
def postgresql_server():
    """Address of a PostgreSQL server: ANISOSCOPE_TEST_POSTGRESQL, or else one that this run starts for itself."""
    named = os.environ.get("ANISOSCOPE_TEST_POSTGRESQL")
    return named or beside("postgresql").address(Path(os.environ[RUN]))


@pytest.fixture(scope="session")
def postgresql_programs():
    """What starts and stops a PostgreSQL server with settings of a test's own."""
    return beside("postgresql")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        # real height maps are not part of the project, and a graphics card is no package: both cannot be installed
        missing = [name for name in ("realdata", "gpu") if item.get_closest_marker(name)]
        if REQUIRE_ALL and not missing:
            report.outcome = "failed"
            report.longrepr = f"not run, though everything must run here: {reason}"
    return report


def pytest_terminal_summary(terminalreporter, config):
    skipped = terminalreporter.stats.get("skipped", [])
    not_run = [report.longrepr[2] for report in skipped if isinstance(report.longrepr, tuple)]
    if not_run:
        terminalreporter.section("could not be run here")
        for reason in sorted(set(not_run)):
            count = not_run.count(reason)
            terminalreporter.write_line(f"{count} tests: {reason.removeprefix('Skipped: ')}")


@pytest.fixture
def install(tmp_path, monkeypatch):
    """``install(group, name, value, text)``: a package of a third party with one plug-in, as pip leaves it."""

    def done(group, name, value, text):
        module = value.partition(":")[0]
        about = tmp_path / "packages" / f"{module}-1.0.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")
        (about.parent / f"{module}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, module, raising=False)
        monkeypatch.syspath_prepend(about.parent)

    return done
