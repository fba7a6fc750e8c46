"""``anisoscope bsdf``."""
