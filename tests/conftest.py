"""What could not be run is said at the end; with ANISOSCOPE_REQUIRE_ALL=1 it fails."""

import os
import shutil
import signal
import tempfile

import pytest

REQUIRE_ALL = os.environ.get("ANISOSCOPE_REQUIRE_ALL") == "1"


CACHE = "ANISOSCOPE_CACHE"
OWN_CACHE = pytest.StashKey[str]()


def pytest_configure(config):
    """All workers of one run share what is computed once, and no run finds what another one left."""
    # a shell ignores Ctrl-C for what runs in the background, and all that the tests start and interrupt would, too
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, "workerinput") and CACHE not in os.environ:
        config.stash[OWN_CACHE] = os.environ[CACHE] = tempfile.mkdtemp(prefix="anisoscope-cache-")


def pytest_unconfigure(config):
    if OWN_CACHE in config.stash:
        os.environ.pop(CACHE, None)
        shutil.rmtree(config.stash[OWN_CACHE], ignore_errors=True)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        # the folder of real height maps is not part of the project: nobody can be asked to install it
        if REQUIRE_ALL and item.get_closest_marker("realdata") is None:
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
