"""python-microscope drives a simulated X-RSW60A: python microscope_zaber.py PORT."""

import sys

from microscope.controllers.zaber import ZaberDaisyChain, ZaberDeviceType

chain = ZaberDaisyChain(port=sys.argv[1], address2type={1: ZaberDeviceType.STAGE})
stage = chain.devices["1"]
stage.enable()  # searches the reference unless limit.home.triggered says that it is known
axis = stage.axes["1"]
stage._dev_conn.wait_until_idle()  # noqa: SLF001 - its enable() does not wait
axis.move_to(35_200)
print("position", axis.position / 384_000 * 360.0)
print("limits", axis.limits)
print("homed", stage._dev_conn.been_homed())  # noqa: SLF001 - nothing public tells it
chain.shutdown()
