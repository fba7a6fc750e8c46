"""Commissioning a rig: how its axes, its camera and its light truly stand, found from pictures."""
