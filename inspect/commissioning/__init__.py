"""Commissioning of a rig: geometry of its axes, camera and light, determined from pictures."""
