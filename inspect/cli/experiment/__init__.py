"""``anisoscope research experiment`` and ``findings``."""
