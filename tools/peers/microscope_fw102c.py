"""python-microscope's client of the FW102C: to its fourth place, which it counts as 3."""

import sys

from microscope.filterwheels.thorlabs import ThorlabsFW102C

wheel = ThorlabsFW102C(sys.argv[1])
print("places", wheel.n_positions)
print("position", wheel.position)
wheel.position = 3
print("position", wheel.position)
