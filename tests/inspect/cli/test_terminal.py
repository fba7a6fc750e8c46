"""What is printed where the terminal, or the file behind it, knows fewer letters and no colours."""

import io
import sys

import pytest

from anisoscope import cli

COMMAND = ["predict", "--ridge-angle", "10", "--pitch", "100", "--verbose"]


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_letters_that_an_encoding_lacks_are_no_error(monkeypatch, encoding):
    """A command behind a pipe of Windows writes in the encoding of its locale."""
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    with pytest.raises(UnicodeEncodeError):
        print("σ → ∞ 中", file=stream, flush=True)
    cli.take_any_letter(stream)
    assert cli.run(COMMAND) == 0
    print("σ → ∞ 中", file=stream, flush=True)
    text = written.getvalue().decode(encoding)
    assert "ln" in text
    assert "?" in text
    assert "\x1b" not in text, "no colours in a pipe"
