"""Lines of the light controller as in docs/interfaces.md; the sketch, built for this machine, answers the same."""

import shutil
import subprocess
from pathlib import Path

import pytest

from anisoscope.base.errors import UsageError
from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.light import LightFirmware

SKETCH = Path(__file__).resolve().parents[4] / "rig" / "firmware" / "light" / "light.ino"
TALK = [
    ("ID?", "ID ANISOLIGHT 1 L0001"),
    ("STATUS?", "STATUS OFF 100 0 10"),
    ("ON", "OK ON 100"),
    ("STATUS?", "STATUS ON 100 100 10"),
    ("LEVEL 40", "OK LEVEL 40"),
    ("STATUS?", "STATUS ON 40 40 10"),
    ("LEVEL 101", "ERR 2 number out of range"),
    ("LEVEL -1", "ERR 2 number out of range"),
    ("LEVEL ", "ERR 2 number out of range"),
    ("WATCHDOG 600", "OK WATCHDOG 600"),
    ("WATCHDOG 0", "ERR 2 number out of range"),
    ("STATUS?", "STATUS ON 40 40 600"),
    ("OFF", "OK OFF"),
    ("STATUS?", "STATUS OFF 40 0 600"),
    ("on", "ERR 1 unknown command"),
    ("LEVEL", "ERR 1 unknown command"),
    ("X" * 32, "ERR 3 line too long"),
    ("X" * 31, "ERR 1 unknown command"),
    ("ON", "OK ON 40"),
]

SHIM = """
#include <cstdint>
#include <cstring>
#include <cstdio>
#define OUTPUT 1
#define A0 14
#define F(text) text
static int pwm = 0;
static void pinMode(int, int) {}
static void analogWrite(int, int value) { pwm = value; }
static int analogRead(int) { return pwm * 1023 / 255; }
static unsigned long millis() { return 0; }
static int next_byte = -2;
struct {
  void begin(long) {}
  bool available() { if (next_byte == -2) next_byte = getchar(); return next_byte >= 0; }
  int read() { available(); int byte = next_byte; next_byte = -2; return byte; }
  void print(const char *text) { fputs(text, stdout); }
  void print(char one) { putchar(one); }
  void print(int value) { printf("%d", value); }
  void print(unsigned long value) { printf("%lu", value); }
  template <class T> void println(T value) { print(value); fputs("\\r\\n", stdout); }
} Serial;
"""


def ask(firmware, text):
    firmware.write(text.encode())
    return firmware.read().decode()


def test_the_talk_of_the_protocol():
    firmware = LightFirmware()
    for question, answer in TALK:
        assert ask(firmware, question + "\n") == answer + "\r\n", question


def test_the_sketch_talks_like_the_simulation(tmp_path):
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("apt install g++")
    source = tmp_path / "light.cpp"
    functions = [
        line.replace(" {", ";")
        for line in SKETCH.read_text(encoding="utf-8").splitlines()
        if line.startswith(("void ", "int ")) and line.endswith(") {")
    ]
    main = "int main() { setup(); loop(); return 0; }"
    parts = [SHIM, *functions, SKETCH.read_text(encoding="utf-8"), main]
    source.write_text("\n".join(parts), encoding="utf-8")
    program = tmp_path / "light"
    subprocess.run([compiler, "-Wall", "-Werror", "-o", program, source], check=True, timeout=120)
    questions = "".join(f"{question}\n" for question, _ in TALK)
    done = subprocess.run([program], input=questions.encode(), capture_output=True, check=True, timeout=20)
    assert done.stdout.decode().splitlines() == ["! READY", *(answer for _, answer in TALK)]


def test_lines_split_joined_and_with_carriage_returns():
    firmware = LightFirmware()
    assert ask(firmware, "I") == ""
    assert ask(firmware, "D?\r\n\r\n\nSTATUS?\n").splitlines() == [TALK[0][1], TALK[1][1]]


def test_it_is_off_when_a_host_opens_the_line():
    firmware = LightFirmware()
    ask(firmware, "LEVEL 7\nON\n")
    assert firmware.lamp.level == pytest.approx(0.07)
    firmware.connect()
    assert firmware.lamp.level == 0.0
    assert ask(firmware, "STATUS?\n") == "! READY\r\nSTATUS OFF 100 0 10\r\n"


def test_the_watchdog_hears_whole_lines_only():
    now = [0.0]
    firmware = LightFirmware(clock=lambda: now[0])
    ask(firmware, "WATCHDOG 2\nON\n")
    for _ in range(4):
        now[0] += 1.5
        assert ask(firmware, "STATUS?\n").startswith("STATUS ON")
    now[0] += 2.1
    assert ask(firmware, "STAT").startswith("! WATCHDOG")
    assert firmware.lamp.level == 0.0
    assert ask(firmware, "US?\n").startswith("STATUS OFF")


def test_the_catalogue_builds_it():
    assert isinstance(build("light", [Mount(RotaryAxis())], faults=["stall:30"]), LightFirmware)
    with pytest.raises(UsageError, match="no address"):
        build("light", [Mount(RotaryAxis(), "1")])
    with pytest.raises(UsageError, match="cannot have the fault 'busy'"):
        build("light", [], faults=["busy"])
    with pytest.raises(UsageError, match=r"there are: elliptec, .*, light"):
        build("laser", [])
