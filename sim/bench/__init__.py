"""A virtual rig: stage firmware that speaks the real bytes, a camera with a real sensor's noise."""
