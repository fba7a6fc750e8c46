"""Drawings in the background: whoever ends meanwhile ends in order."""

import subprocess
import sys
import textwrap


def test_a_program_that_ends_while_drawings_are_made_ends_with_its_own_code():
    """A thread that Python's end cuts off within native code, here that which lays out text, takes the program down."""
    script = textwrap.dedent("""
        import os, sys, time
        from matplotlib import font_manager, ft2font
        from anisoscope.report import surface_view
        from anisoscope.profiles.ideal import RidgeDesign, ridges

        class NoProcess:
            def __init__(self, *_arguments, **_options): pass
            def discard(self): pass

        def write_text():
            end = time.monotonic() + 0.8
            while time.monotonic() < end:
                ft2font.FT2Font(font).set_text("height map")

        font = font_manager.findfont("DejaVu Sans")
        surface_view.Renderer = NoProcess
        surface_view.flat_drawings = lambda _surface: ("", "")
        surface = ridges(RidgeDesign(100.0, 10.0), (4, 100), (4.0, 4.0))
        children = []
        for number in range(6):
            child = os.fork()
            if child == 0:
                view = surface_view.SurfaceView(surface, write_text)
                time.sleep(0.05 * number)
                view.discard()
                sys.exit(69)
            children.append(child)
        print([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children])
    """)
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    assert done.stdout.splitlines()[-1:] == [str([69] * 6)], (done.stdout, done.stderr)
