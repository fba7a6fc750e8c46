"""``anisoscope rig`` and ``calibrate``."""
