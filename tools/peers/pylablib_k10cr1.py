"""pylablib drives a simulated K10CR1: python pylablib_k10cr1.py PORT."""

import sys

import serial
from pylablib.devices import Thorlabs

serial.Serial._update_rts_state = lambda _: None  # noqa: SLF001 - a pseudo terminal has no such line
with Thorlabs.KinesisMotor(("serial", {"port": sys.argv[1]}), scale="K10CR1") as stage:
    print("stage", stage.get_stage())
    stage.home(force=True, timeout=60.0)  # without switching the channel on
    print("homed", stage.is_homed())
    stage.move_to(33.0)
    stage.wait_move(timeout=60.0)
    print("position", round(stage.get_position(), 3))
    print("limit switches", stage.get_limit_switch_parameters())
    print("status", sorted(stage.get_status()))
