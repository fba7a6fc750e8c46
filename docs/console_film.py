"""A film of the operator's day at the console: `anisoscope serve` on the demo's virtual rig, in Debian's chromium.

    python docs/console_film.py docs/pictures/console.gif

Check, a good part, a part with burrs, disposition, where parts deviate: a picture for each step. It takes chromium and
a minute or two.
"""

import io
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from anisoscope.operations.demo.ridges import SCENE

SIZE, SHOWN, COLOURS = {"width": 1024, "height": 768}, (768, 576), 128
PATIENCE_MS = 180_000


@contextmanager
def served(folder: Path, part: str) -> Iterator[str]:
    """Address of a console whose stage carries a part."""
    command = [sys.executable, "-Im", "anisoscope", "serve", "--port", "0", "--station", "line 1"]
    places = {
        "--rig": folder / "bench" / part / "rig.toml",
        "--recipes": folder,
        "--out": folder / "inspections",
    }
    command += [str(one) for pair in places.items() for one in pair]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            yield server.stdout.readline().split()[-1]
        finally:
            server.terminate()


class Film:
    """Pictures of a page, each shown for some time."""

    def __init__(self, page: Page) -> None:
        self.page, self.pictures, self.spans_ms = page, list[Image.Image](), list[int]()

    def take(self, span_ms: int = 1500) -> None:
        """Take a picture."""
        with Image.open(io.BytesIO(self.page.screenshot())) as found:
            self.pictures.append(found.convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS))
        self.spans_ms.append(span_ms)

    def write(self, path: Path) -> None:
        """Write them as GIF with one palette."""
        together = Image.new("RGB", (SHOWN[0], SHOWN[1] * len(self.pictures)))
        for number, one in enumerate(self.pictures):
            together.paste(one, (0, number * SHOWN[1]))
        palette = together.quantize(COLOURS, dither=Image.Dither.NONE)
        first, *others = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in self.pictures)
        first.save(path, save_all=True, append_images=others, duration=self.spans_ms, loop=0, optimize=True)


def inspect(film: Film, serial: str, word: str) -> None:
    """Inspect the part on the stage."""
    page = film.page
    page.get_by_label("Serial number").fill(serial)
    page.get_by_label("Lot").fill("L7")
    film.take()
    page.get_by_role("button", name="Start", exact=True).click()
    page.locator("#frames img").nth(3).wait_for()
    film.take(900)
    page.locator("#frames img").nth(12).wait_for()
    film.take(900)
    page.locator("#word").get_by_text(word, exact=True).wait_for()
    film.take(2500)
    page.get_by_role("button", name="Next part").click()


def first_part(film: Film, address: str) -> None:
    """Start of the shift, and a good part."""
    page = film.page
    page.goto(address)
    page.locator("#focus-text").get_by_text("%").wait_for()
    film.take(2000)
    page.get_by_role("button", name="Check the rig").click()
    page.locator("#checks .lamp").nth(5).wait_for()
    film.take()
    inspect(film, "PLATE-0001", "PASS")


def second_part(film: Film, address: str) -> None:
    """A part with burrs, and what the quality engineer does about it."""
    page = film.page
    page.goto(address)
    page.locator("#focus-text").get_by_text("%").wait_for()
    inspect(film, "PLATE-0002", "FAIL")
    page.get_by_role("link", name="Fleet").click()
    page.locator("table.list").get_by_text("PLATE-0002").wait_for()
    film.take(2500)
    page.get_by_role("link", name="inspection 2").click()
    while not page.get_by_role("link", name="Report").is_visible():  # it is drawn after the verdict
        page.wait_for_timeout(500)
        page.reload()
    page.get_by_label("Decision").select_option("reject")
    page.get_by_label("Reason").fill("burrs on a tenth of the area")
    film.take(2000)
    page.get_by_role("button", name="Record").click()
    page.get_by_text("by this computer").wait_for()
    film.take()
    page.goto(f"{address}fleet/maps")
    page.locator("svg.map").first.scroll_into_view_if_needed()
    film.take(3000)


def main(target: Path) -> None:
    """Make the film."""
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as driver:
        folder = SCENE.lay_out(Path(temporary) / "day", 1, lambda *_: None)
        (folder / "recipe.toml").rename(folder / "ridged plate.toml")
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        film = Film(browser.new_page(viewport=SIZE))
        film.page.set_default_timeout(PATIENCE_MS)
        for part, act in (("good", first_part), ("burrs", second_part)):
            with served(folder, part) as address:
                act(film, address)
        film.write(target)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
