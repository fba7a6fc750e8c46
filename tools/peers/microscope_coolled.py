"""python-microscope's client of CoolLED controllers: lamp B at 40 %."""

import sys

from microscope.controllers.coolled import CoolLED

controller = CoolLED(sys.argv[1])
lamps = controller.devices
print("lamps", sorted(lamps))
for name, lamp in lamps.items():
    print(name, "on" if lamp.get_is_on() else "off", "power", lamp.power)
lamps["B"].power = 0.4
lamps["B"].enable()
print("B", "on" if lamps["B"].get_is_on() else "off", "power", lamps["B"].power)
