"""thorlabs-apt-device drives a simulated KDC101: python apt_device_kdc101.py PORT."""

import sys
import time

from thorlabs_apt_device import KDC101

stage = KDC101(serial_port=sys.argv[1], serial_number=None, home=True)
until = time.monotonic() + 60.0
while not stage.status["homed"] and time.monotonic() < until:
    time.sleep(0.05)
print("homed", stage.status["homed"])
counts = round(33.0 * 1919.6418578623391)
stage.move_absolute(counts)
while abs(stage.status["position"] - counts) > 1 and time.monotonic() < until:
    time.sleep(0.05)
print("position", round(stage.status["position"] / 1919.6418578623391, 3))
print("channel enabled", stage.status["channel_enabled"])
stage.close()
