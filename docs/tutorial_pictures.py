"""Photograph the parts of the demo's reports that README.md and docs/tutorial.md show; needs Debian's chromium.

make demo
python docs/tutorial_pictures.py demo-output docs/pictures
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageChops

WIDTH, TALL = 1000, 2600
COLOURS = 128
SHOTS = {
    "tutorial-verdict": ("DEMO-angle", "", "Measured"),
    "tutorial-contrasts": ("DEMO-angle", "Contrasts", "Contrasts"),
    "tutorial-map": ("DEMO-burrs", "Measured", "Deviation"),
    "angle-map": ("DEMO-burrs", "Angle", "Angle"),
}
"""Picture -> the part whose report is photographed, and how the headings of its first and last section begin; "" is
the top."""
POLICY = re.compile(r"<meta[^>]*Content-Security-Policy[^>]*>")
KEEP = """<script>
let heading = "", on = false, over = false;
const flat = one => one.querySelectorAll("h2").length > 1 ? [...one.children].flatMap(flat) : [one];
for (const child of [...document.querySelector("main").children].flatMap(flat)) {
  const title = child.matches("h2") ? child : child.querySelector("h2");
  if (title) { if (on && heading.startsWith(%(last)r)) over = true; heading = title.textContent.trim(); }
  if (heading.startsWith(%(first)r)) on = true;
  if (!on || over) child.style.display = "none";
}
</script>"""


def photograph(report: Path, first: str, last: str, picture: Path) -> None:
    """Sections of a report as a PNG with a palette, without the empty margin below.

    Raises:
        subprocess.CalledProcessError: chromium failed.
    """
    page = POLICY.sub("", report.read_text(encoding="utf-8")) + KEEP % {"first": first, "last": last}
    with tempfile.TemporaryDirectory() as folder:
        copy, shot = Path(folder, "page.html"), Path(folder, "page.png")
        copy.write_text(page, encoding="utf-8")
        size = f"--window-size={WIDTH},{TALL}"
        options = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--screenshot={shot}", size]
        browser = shutil.which("chromium-headless-shell") or "chromium"
        subprocess.run([browser, *options, copy.as_uri()], check=True, capture_output=True)
        whole = Image.open(shot).convert("RGB")
    empty = Image.new("RGB", whole.size, whole.getpixel((0, whole.height - 1)))
    box = ImageChops.difference(whole, empty).getbbox() or (0, 0, *whole.size)
    end = min(box[3] + 12, whole.height)
    whole.crop((0, 0, WIDTH, end)).quantize(COLOURS).save(picture, optimize=True)


def main() -> None:
    """Photograph all of them."""
    demo, pictures = Path(sys.argv[1]), Path(sys.argv[2])
    for name, (part, first, last) in SHOTS.items():
        folder = max((demo / "inspections").glob(f"{part}-*"))
        photograph(folder / "report.html", first, last, pictures / f"{name}.png")
        sys.stdout.write(f"{name}.png\n")


if __name__ == "__main__":
    main()
