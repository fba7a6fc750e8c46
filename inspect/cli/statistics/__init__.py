"""``anisoscope spc``, ``msa``, ``camera``."""
