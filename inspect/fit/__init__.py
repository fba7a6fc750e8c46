"""Fits of ridges and plastic to measured brightness, with identifiability."""
