"""The page of a soft proof in a browser: pixels as those of the core, controls that work, nothing from outside."""

import json
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.report.proof_page import Proof, ProofLight, ProofMesh, write_proof_page
from anisoscope.sim.light.colour.illuminant import standard
from anisoscope.sim.light.colour.observer import white_point
from anisoscope.sim.light.colour.spaces import linear_srgb
from anisoscope.sim.light.ink.shading import Light
from anisoscope.sim.materials.inks import PACKAGED, synthetic_ink
from anisoscope.sim.proof.imagefile import picture_png
from anisoscope.sim.proof.mesh import read_obj
from anisoscope.sim.proof.render import Extras, adaptation, direction, proof_picture, to_screen
from anisoscope.sim.proof.scene import Scene, printed, surface

SECOND = (-15.0, 35.0)
SMALL = (360, 420)  # a window with a tenth of the pixels to be drawn, here by the processor
EXPOSURE = 2.0
START = {
    "shape": "sphere", "print": "halftone", "dots": "eye", "zoom": 1, "yaw": 0, "pitch": 0, "illuminant": 0,
    "azimuth": 135, "elevation": 45, "drag": "print", "second": True, "exposure": 0, "adapt": False,
    "model": "goniochromatic", "beside": "none", "roughness": "file", "alpha": 0.19, "match": False, "phong": 0.05,
    "shininess": 4, "scattering": 0.1, "behind": 0.1, "photo": True,
}  # fmt: skip
PIXEL = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJ"
    "AAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
OCTAHEDRON = """
v 1 0 0\nv -1 0 0\nv 0 1.2 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1
vt 0.1 0.1\nvt 0.9 0.2\nvt 0.5 0.9
f 1/1 3/2 5/3\nf 3/1 2/2 5/3\nf 2/1 4/2 5/3\nf 4/1 1/2 5/3\nf 3/1 1/2 6/3\nf 2/1 3/2 6/3\nf 4/1 2/2 6/3\nf 1/1 4/2 6/3
"""


def layers(codes):
    """Four inks in two pictures of three."""
    wide = np.concatenate([codes, np.zeros((*codes.shape[:2], 2), dtype=np.uint8)], axis=-1)
    return tuple(picture_png(np.ascontiguousarray(one)) for one in np.split(wide, 2, axis=-1))


@pytest.fixture(scope="module")
def proof(tmp_path_factory):
    folder = tmp_path_factory.mktemp("proof")
    (folder / "mesh.obj").write_text(OCTAHEDRON)
    mesh = read_obj(folder / "mesh.obj")
    rng = np.random.default_rng(5)
    dots = np.eye(5, dtype=np.uint8)[rng.integers(0, 5, (9, 12))][..., 1:] * 255
    tones = np.linspace(0, 60, 9 * 12 * 4).reshape(9, 12, 4).astype(np.uint8)
    inks = tuple(synthetic_ink(name) for name in PACKAGED)
    inks = (inks[0], replace(inks[1], alpha=0.25, alpha_y=0.15, brush_deg=30.0), *inks[2:])
    lights = tuple(
        ProofLight(lamp, linear_srgb(white_point(lamp)), adaptation(lamp))
        for lamp in (standard("d65"), standard("a"))
    )
    vertices = np.hstack([mesh.position, mesh.normal, mesh.tangent, mesh.uv]).astype(np.float32)
    content = Proof(
        title="Soft proof of <test>", subtitle="for a test", inks=inks, lights=lights, halftone_pngs=layers(dots),
        tones_pngs=layers(tones), aspect=12 / 9, exposure=EXPOSURE, fill=0.96, second_light_deg=SECOND, start=START,
        roughness=(("file", "as in the files", None), ("brushed", "brushed", 0.19), ("own", "own", None)),
        mesh=ProofMesh(vertices, mesh.triangles.astype(np.uint32)), photo=PIXEL, still=layers(dots)[0], substrate=0.2,
    )  # fmt: skip
    path = folder / "proof.html"
    write_proof_page(content, path)
    return path, content, mesh, {"halftone": dots / 255.0, "tones": tones / 255.0}


def ready(page, url, width=1300, height=1000):
    page.open(url, width, height)
    wait(page, "document.body.dataset.ready === 'yes'")


def wait(page, condition, seconds=180.0):
    deadline = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < deadline, condition
        time.sleep(0.02)


def core(case, content, mesh, prints, size):
    """What the core shows of one case, and which pixels lie clear of edges of dots and of the shape."""
    inks = content.inks
    if case["roughness"] != "file":
        inks = [replace(ink, alpha=case["alpha"], alpha_y=None) for ink in inks]
    lamp = content.lights[case["illuminant"]].illuminant
    lights = [
        Light(direction(case["azimuth"], case["elevation"]), np.pi, lamp),
        Light(direction(*SECOND), np.pi / 2, lamp),
    ]
    scene = Scene(case["shape"], case["yaw"], case["pitch"], content.aspect, mesh=mesh)
    where = surface(scene, size, size)
    if case["print"].startswith("solid"):
        whole = np.isfinite(where.uv[..., :1])
        cover = np.where(whole, np.eye(len(inks))[int(case["print"][-1]) - 1], 0.0)
        clear = np.ones((size, size), dtype=bool)
    else:
        dots = prints[case["print"]]
        cover = printed(where, dots)
        place = where.uv * np.array([dots.shape[1], dots.shape[0]])
        clear = np.all(np.isnan(place) | (np.abs(place - np.rint(place)) > 1e-3), axis=-1)
    extras = (
        Extras(case["phong"], case["shininess"], case["scattering"], case["behind"])
        if case["match"]
        else None
    )
    linear = proof_picture(
        where, inks, lights, cover, model=case["model"], extras=extras, substrate=content.substrate
    )
    adapt = adaptation(lamp) if case["adapt"] else None
    shown = np.any(where.normal != 0.0, axis=-1)
    around = np.pad(shown, 1)
    inside = np.all(
        [around[1 + dr : size + 1 + dr, 1 + dc : size + 1 + dc] for dr in (-1, 0, 1) for dc in (-1, 0, 1)],
        axis=0,
    )
    return to_screen(linear, content.exposure * 2.0 ** case["exposure"], adapt), clear & inside, shown


@pytest.mark.browser
def test_every_pixel_of_the_page_is_that_of_the_core_within_one_code(page, proof):
    path, content, mesh, prints = proof
    ready(page, path.as_uri() + "#selftest")
    told = json.loads(page.evaluate("document.getElementById('selftest').textContent"))
    size, worst, brightest = told["size"], [], []
    combinations = set()
    for asked in told["cases"]:
        case = START | asked
        got = np.frombuffer(bytes.fromhex(case.pop("pixels")), dtype=np.uint8).reshape(size, size, 4)
        expected, sure, shown = core(case, content, mesh, prints, size)
        assert sure.sum() > 100, case
        assert np.mean((got[..., 3] == 255) == shown) > 0.97, case
        off = np.abs(got[..., :3].astype(int) - expected)[sure]
        # where edges of facets cross a pixel's middle, the two rasterisers may choose different facets
        worst.append(np.sort(off.max(axis=-1))[-1 - (20 if case["shape"] == "mesh" else 0)])
        brightest.append(int(expected.max()))
        combinations.add((case["illuminant"], case["model"], case["print"]))
    assert max(worst) <= 1, [(w, c) for w, c in zip(worst, told["cases"], strict=True) if w > 1][:2]
    assert min(brightest) > 20
    assert len(combinations) >= 2 * 3 * 6


def canvas_pixels(page):
    """The drawing as the window shows it."""
    import io

    import PIL.Image

    return np.array(PIL.Image.open(io.BytesIO(page.screenshot("#stage"))).convert("RGB")).astype(int)


def drawn(page):
    """A number that changes with what is drawn, once it rests."""
    page.evaluate(
        "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))"
    )
    return canvas_pixels(page)


def set_control(page, key, value):
    page.evaluate(
        f"(e => {{ if (e.type === 'checkbox') e.checked = {json.dumps(value)}; else e.value = {json.dumps(value)}; "
        f"e.dispatchEvent(new Event('input')); }})(document.getElementById('{key}'))"
    )


def value_of(page, key):
    return page.evaluate(
        f"(e => e.type === 'checkbox' ? e.checked : e.value)(document.getElementById('{key}'))"
    )


# key, value, what must be set first so that it shows
CHANGES = [
    ("shape", "cylinder", {}), ("shape", "plane", {"yaw": 20}), ("shape", "mesh", {}), ("print", "tones", {}),
    ("print", "solid2", {}), ("dots", "each", {}), ("zoom", "3", {}), ("yaw", "40", {}), ("pitch", "-30", {}),
    ("illuminant", "1", {}), ("azimuth", "20", {}), ("elevation", "70", {}), ("second", False, {}),
    ("exposure", "1", {}),
    ("adapt", True, {"illuminant": "1"}), ("model", "schlick", {}), ("model", "tio2", {}), ("beside", "schlick", {}),
    ("roughness", "brushed", {}), ("alpha", "0.4", {"roughness": "own"}), ("match", True, {}),
    ("phong", "0.2", {"match": True}), ("shininess", "30", {"match": True}), ("scattering", "0.4", {"match": True}),
    ("behind", "0.4", {"match": True, "second": False, "elevation": "5"}),
]  # fmt: skip


@pytest.mark.browser
def test_every_control_changes_what_is_seen(page, proof):
    ready(page, proof[0].as_uri(), *SMALL)
    for key, value, first in CHANGES:
        page.evaluate("document.getElementById('reset').click()")
        for name, given in first.items():
            set_control(page, name, given)
        before = drawn(page)
        set_control(page, key, value)
        after = drawn(page)
        # two models beside each other stand in a wider stage
        assert after.shape != before.shape or np.abs(after - before).max() > 8, (key, value)
    keys = set(page.evaluate("[...document.querySelectorAll('[data-key]')].map(e => e.dataset.key)"))
    assert keys == {key for key, *_ in CHANGES} | {"drag", "photo"}
    set_control(page, "photo", False)
    assert page.evaluate("document.getElementById('photograph').hidden")
    page.evaluate("document.getElementById('time').click()")
    assert "a frame of 512 × 512 pixels" in page.evaluate("document.getElementById('timed').textContent")


@pytest.mark.browser
def test_mouse_touch_and_keys_turn_the_print_and_move_the_light(page, proof):
    ready(page, proof[0].as_uri(), *SMALL)
    x, y = page.evaluate(
        "(r => [r.x + r.width / 2, r.y + r.height / 2])(document.getElementById('proof').getBoundingClientRect())"
    )
    page.drag((x, y), [(20, 0), (30, 25)])
    assert float(value_of(page, "yaw")) == pytest.approx(20.0)
    assert float(value_of(page, "pitch")) == pytest.approx(10.0)
    set_control(page, "drag", "light")
    page.drag((x, y), [(40, 0), (40, 0)])
    assert float(value_of(page, "azimuth")) != 135.0
    assert float(value_of(page, "yaw")) == pytest.approx(20.0)
    for key, name in (("0", "Digit0"), ("ArrowRight", "ArrowRight"), ("ArrowUp", "ArrowUp"), ("+", "Equal")):
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key=key, code=name)
    assert (value_of(page, "yaw"), value_of(page, "pitch"), value_of(page, "zoom")) == ("5", "-5", "1.2")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft", modifiers=8)
    page.call("Input.dispatchKeyEvent", type="keyUp", key="ArrowLeft", code="ArrowLeft")
    assert value_of(page, "azimuth") != "135"
    page.evaluate("document.getElementById('reset').click()")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-200)
    wait(page, "document.getElementById('zoom').value > 1.2")
    page.evaluate("document.getElementById('reset').click()")
    page.call("Emulation.setTouchEmulationEnabled", enabled=True)
    try:
        touch(page, [[(x, y)], [(x + 25, y)], []])
        assert float(value_of(page, "yaw")) == pytest.approx(10.0)
        touch(page, [[(x, y), (x + 50, y)], [(x, y), (x + 100, y)], [(x, y), (x + 150, y)], []])
        assert float(value_of(page, "zoom")) > 1.3
    finally:
        page.call("Emulation.setTouchEmulationEnabled", enabled=False)


def touch(page, steps):
    for number, fingers in enumerate(steps):
        kind = "touchStart" if number == 0 else "touchMove" if fingers else "touchEnd"
        points = [{"x": fx, "y": fy, "id": k} for k, (fx, fy) in enumerate(fingers)]
        page.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)


@pytest.mark.browser
def test_nothing_comes_from_outside_and_nobody_complains(page, proof):
    path = proof[0]
    ready(page, path.as_uri())
    assert page.requests() == [path.as_uri()]
    assert [one for one in page.complaints() if "ReadPixels" not in str(one)] == []
    names = page.evaluate("[...document.querySelectorAll('[id]')].map(e => e.id)")
    assert len(names) == len(set(names)) > 30
    labels = page.evaluate(
        "[...document.querySelectorAll('[data-key]')].map(e => e.labels[0]?.innerText.trim() || '')"
    )
    assert len(labels) > 20
    assert "" not in labels
    for width in (1300, 420):
        ready(page, path.as_uri(), width)
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


@pytest.mark.browser
def test_a_print_too_large_for_the_driver_is_told(page, proof, tmp_path):
    long = np.zeros((40_000, 1, 3), dtype=np.uint8)
    path = tmp_path / "long.html"
    write_proof_page(replace(proof[1], halftone_pngs=(picture_png(long),) * 2), path)
    page.open(path.as_uri(), 800, 600)
    wait(page, "!document.getElementById('missing').hidden")
    assert "1 × 40000 dots" in page.evaluate("document.getElementById('missing-why').textContent")


@pytest.mark.browser
def test_without_webgl_the_page_says_so(chromium_program, proof, tmp_path):
    command = [chromium_program, "--headless", "--no-sandbox", "--disable-gpu", "--disable-3d-apis", "--no-first-run",
               "--disable-background-networking", "--disable-dev-shm-usage", f"--user-data-dir={tmp_path}",
               "--dump-dom", proof[0].as_uri()]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert 'data-webgl="missing"' in done.stdout
    message = done.stdout.split('id="missing"')[1].split(">")[0]
    assert "hidden" not in message
    assert "no WebGL 2" in done.stdout
    assert (
        'alt="Still picture: the print as the page begins"'
        in done.stdout.split('id="missing"')[1].split("</div>")[0]
    )


def test_the_page_is_strict_escaped_and_refuses_what_it_cannot_draw(proof, tmp_path):
    path, content, *_ = proof
    text = path.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert "script-src 'sha256-" in text
    assert "http://" not in text
    assert "https://" not in text
    assert "Soft proof of &lt;test&gt;" in text
    rough = replace(content.inks[0], distribution="beckmann")
    with pytest.raises(UsageError, match="ggx"):
        write_proof_page(replace(content, inks=(rough, *content.inks[1:])), tmp_path / "x.html")
    with pytest.raises(UsageError, match="a picture for every three of them"):
        write_proof_page(replace(content, tones_pngs=content.tones_pngs[:1]), tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()
