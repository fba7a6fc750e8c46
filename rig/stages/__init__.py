"""Rotation and tilt stages: one driver a protocol, and the rules of motion that all of them keep."""
