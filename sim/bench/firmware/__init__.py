"""Firmware of simulated devices, byte by byte, and what moves behind it."""
