"""hvl_ccb configures and drives a simulated SMC100PP: python hvl_ccb_smc100.py PORT."""

import sys

from hvl_ccb.dev.newport import NewportSMC100PP

settings = {
    "negative_software_limit": 0.0,
    "positive_software_limit": 360.0,
    "user_position_offset": 0.0,
    "move_wait_sec": 3.0,
    "exit_configuration_wait_sec": 0.5,
    "velocity": 20.0,
    "acceleration": 80.0,
    "home_search_velocity": 10.0,
    "home_search_polling_interval": 0.1,
    "hysteresis_compensation": 0.0,
}
stage = NewportSMC100PP({"port": sys.argv[1]}, settings)
stage.start()  # reads ZT, writes what differs, and searches the reference
print("configuration", stage.get_motor_configuration())
stage.move_to_absolute_position(33.0)
print("position", stage.get_position())
print("version", stage.get_controller_information())
stage.stop()
