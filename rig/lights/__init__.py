"""Lights that the rig can switch."""
